"""The components of the noise: their bases, and one class each, registered in the order of their definitions.

A component is a variance, per entry or per run and channel, a correlation, slow noise or a heavy tail.  The covariance
of the data is Σ = D^½ R D^½ + S + Σ_g T_g 1 1ᵀ: D is diagonal, the sum of the components' variances, R is the
correlation along the rows of each run and channel g (I without autocorrelation), S is the covariance of slow noise, and
T_g is the variance that all entries of g share.  With heavy tails the independent part of an entry follows Student's t
of scale D^½ instead of a normal law.  The parameters of noise are hyperparameters: they change the width of the
posterior, not the predicted output.

Slow noise is that of IEEE Std 952 in continuous time: flicker, random walk, Gauss–Markov and quantisation noise.  Its
parameters are those of `imubayes noise`, shared by all runs of a channel, so that a static record determines them for
short runs too.  Rows are means over time: covariances are integrals of the autocovariance over the rows.  What is
slower than the longest run is part of the bias: no run distinguishes them.
"""

import math
from abc import abstractmethod
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp

from imubayes.foundations.arrays import Array, Float, Scalar, Scalars
from imubayes.parameters.declarations import parameter


class Entry(eqx.Module):
    """Facts about one measured value that its variance depends on.

    Attributes
    ----------
    samples : number of raw samples in the mean.
    rate : magnitude of the nominal table rate along a gyro's input axis in output units, 0 for all else.
    reference : magnitude of a gyro's nominal scale in a run beside a reference gyro, output units per rad/s, 0 for all
        else.
    encoder : output of a gyro per rad of each of the two angles from which the mean rate of a row follows, output
        units per rad; 0 for all but rows in which the table accelerates.

    Examples
    --------
    >>> import jax.numpy as jnp
    >>> import imubayes
    >>> nothing = jnp.array(0.0)
    >>> imubayes.Entry(samples=jnp.array(600.0), rate=nothing, reference=nothing, encoder=nothing).samples.item()
    600.0
    """

    samples: Scalars
    rate: Scalars
    reference: Scalars
    encoder: Scalars


class Noise(eqx.Module):
    """Base of all noise components; `kinds` says what it applies to (gyro, accelerometer, angle, closure).

    Examples
    --------
    >>> import imubayes
    >>> imubayes.Noise.kinds
    ('gyro', 'accelerometer', 'angle')
    """

    name: ClassVar[str]
    per: ClassVar[tuple[str, ...]] = ("channel",)
    kinds: ClassVar[tuple[str, ...]] = ("gyro", "accelerometer", "angle")
    needs: ClassVar[tuple[str, ...]] = ()
    excludes: ClassVar[tuple[str, ...]] = ()
    confused_with: ClassVar[str] = ""
    reference: ClassVar[str] = ""
    nuisance: ClassVar[bool] = False
    of_motion: ClassVar[bool] = False  # who moves the unit makes it: nothing determines its size before the fit


class EntryNoise(Noise):
    """Independent from entry to entry.

    Examples
    --------
    >>> import jax.numpy as jnp
    >>> import imubayes
    >>> class Rounding(imubayes.EntryNoise):
    ...     name = "my_rounding"
    ...     step: imubayes.Scalar = imubayes.parameter("output", "lognormal(0.3 noise, 1)", (1e-9, 0.1), "the step")
    ...
    ...     def variance(self, entry: imubayes.Entry) -> imubayes.Scalar:
    ...         return self.step**2 / 12
    >>> entry = imubayes.Entry(jnp.array(600.0), jnp.array(0.0), jnp.array(0.0), jnp.array(0.0))
    >>> Rounding(jnp.array(6.0)).variance(entry).item()
    3.0
    """

    @abstractmethod
    def variance(self, entry: Entry) -> Scalars:
        """Return the variance of one entry, output units squared."""


class SharedNoise(Noise):
    """Common to all entries of one run and channel.

    Examples
    --------
    >>> import jax.numpy as jnp
    >>> import imubayes
    >>> class Offset(imubayes.SharedNoise):
    ...     name = "my_run_offset"
    ...     width: imubayes.Scalar = imubayes.parameter("output", "halfnormal(0.5 noise)", (1e-9, 0.1), "the spread")
    ...
    ...     def shared_variance(self) -> imubayes.Scalar:
    ...         return self.width**2
    >>> Offset(jnp.array(0.5)).shared_variance().item()
    0.25
    """

    @abstractmethod
    def shared_variance(self) -> Scalars:
        """Return the variance of the common offset, output units squared."""


class SeriesNoise(Noise):
    """Autocorrelated within one run and channel: the independent noise becomes AR(1).

    Examples
    --------
    >>> import jax.numpy as jnp
    >>> import imubayes
    >>> class Memory(imubayes.SeriesNoise):
    ...     name = "my_memory"
    ...     correlation: imubayes.Scalar = imubayes.parameter("1", "uniform(0, 0.9)", (0.05, 0.9), "the correlation")
    ...
    ...     def lag_one_correlation(self) -> imubayes.Scalar:
    ...         return self.correlation
    >>> Memory(jnp.array(0.25)).lag_one_correlation().item()
    0.25
    """

    @abstractmethod
    def lag_one_correlation(self) -> Scalars:
        """Return the correlation of an entry with that of the row before, in (−1, 1)."""


class RowSpan(eqx.Module):
    """The time that a row averages over.

    Attributes
    ----------
    start : of the row, since the start of its run, s.
    length : of the row, s.
    gap : between the end of the row before in the same run and channel and the start, s; ∞ for the first row.
    times : shape (J,), equally spaced logarithms from half the shortest row to the longest run, s; the same for all.
    """

    start: Scalars
    length: Scalars
    gap: Scalars
    times: Float[Array, " J"]


class StateCovariance(eqx.Module):
    """Covariance of a row, or of many, with the rows of its run and channel, through J independently decaying states.

    With m the mean of a row, c its covariance with the states at its end, and a, k the decay of the states over the
    gap before a row and over the row, rows i < j have the covariance Σ c_i a_(i+1) k_(i+1) a_(i+2) … a_j m_j.

    Attributes
    ----------
    variance : of the mean over the row, output units squared.
    mean : shape (…, J), mean over the row per unit of the states at its start.
    end : shape (…, J), covariance of the mean over the row with the states at its end, output units squared.
    over_gap, over_row : shape (…, J), decay of the states over the gap before the row, and over the row.
    """

    variance: Scalars
    mean: Float[Array, "*rows J"]
    end: Float[Array, "*rows J"]
    over_gap: Float[Array, "*rows J"]
    over_row: Float[Array, "*rows J"]


class SlowNoise(Noise):
    """Noise in continuous time, correlated between the rows of one run and channel; runs are independent."""

    @abstractmethod
    def states(self, row: RowSpan) -> StateCovariance:
        """Return the covariance of one row with those of its run and channel."""


class TailNoise(Noise):
    """Heavy tails: the independent noise of a run and channel follows Student's t instead of a normal law.

    The variances of the other components are then the square of its scale.

    Examples
    --------
    >>> import jax.numpy as jnp
    >>> import imubayes
    >>> class Tails(imubayes.TailNoise):
    ...     name = "my_tails"
    ...     nu: imubayes.Scalar = imubayes.parameter("1", "lognormal(8, 0.8)", (3, 30), "the degrees of freedom")
    ...
    ...     def degrees(self) -> imubayes.Scalar:
    ...         return self.nu
    >>> Tails(jnp.array(4.0)).degrees().item()
    4.0
    """

    @abstractmethod
    def degrees(self) -> Scalars:
        """Return the degrees of freedom, above 0; a normal law has infinitely many."""


class WhiteNoise(EntryNoise):
    """Independent noise: variance σ²/n of a mean of n samples.

    σ is judged by the scatter of the rows about the model, not by the scatter within a row, which would miss noise
    slower than a row.
    """

    name = "white_noise"
    reference = "IEEE Std 952, angle random walk; GUM § 4.2.3"

    sigma: Scalar = parameter(
        "output", "lognormal(1 noise, 0.5)", (1e-9, 0.1), "the standard deviation of one raw sample"
    )

    def variance(self, entry: Entry) -> Scalars:
        return self.sigma**2 / entry.samples


class RateProportionalNoise(EntryNoise):
    """Variance (k·|Ω|)² of a row, Ω the nominal table rate along the input axis.

    The causes that make a row at high rate less repeatable (instability of the table rate or the scale factor) last as
    long as the row: they do not average over its samples.
    """

    name = "rate_proportional_noise"
    kinds = ("gyro",)
    confused_with = "white_noise if all rows have the same rate; a nonlinearity missing from the model"
    reference = "IEEE Std 952, scale factor repeatability; rate table stability of 1 … 100 ppm"

    k: Scalar = parameter("ppm", "lognormal(10 ppm, 1.5)", (0.1, 300), "the standard deviation per rate")

    def variance(self, entry: Entry) -> Scalars:
        return (self.k * entry.rate) ** 2


class ReferenceNoise(EntryNoise):
    """Noise of a reference gyro: variance (k σ)²/n of a mean of n samples, k being the scale of the gyro under test.

    The true rate of every row is unknown.  Integrated out under a flat prior (errors in variables), it is replaced by
    the observation of the reference, and K Kᵀ σ²/n is added to the covariance of the row's channels.  That is diagonal
    for perpendicular input axes; the covariances between other axes, at most the ratio of the two variances, are
    neglected.
    """

    name = "reference_noise"
    kinds = ("gyro",)
    per = ()
    needs = ("reference",)
    confused_with = "the noise of the gyros themselves, unless runs without the reference determine it"
    reference = "Fuller, Measurement Error Models (1987)"

    sigma: Scalar = parameter(
        "deg/s", "lognormal(2e-4 deg/s, 1)", (1e-6, 1e-2), "the reference's standard deviation of one raw sample"
    )

    def variance(self, entry: Entry) -> Scalars:
        return (entry.reference * self.sigma) ** 2 / entry.samples


class EncoderNoise(EntryNoise):
    """Noise of the angles that bound a row between levels: variance 2 (k σ/T)², k the scale along the table axis.

    The mean rate of such a row of length T is the difference of two angles over T (errors in variables), of an encoder
    or, for a turn from rest to rest, of marks. A row between levels shares an angle with each of its neighbours; the
    correlations of −1/2 are neglected, so that slow noise is overstated.
    """

    name = "encoder_noise"
    kinds = ("gyro",)
    per = ()
    needs = ("turning",)
    confused_with = "white_noise if no row is at a constant rate"
    reference = "Fuller, Measurement Error Models (1987); encoders of 0.05 … 5 arcsec"

    sigma: Scalar = parameter(
        "arcsec", "lognormal(0.5 arcsec, 1)", (0.01, 20), "the standard deviation of one reading of the angle"
    )

    def variance(self, entry: Entry) -> Scalars:
        return 2 * (entry.encoder * self.sigma) ** 2


class Quantisation(EntryNoise):
    """Variance q²/12 of a row, whatever the number of its samples: rounding is uniform over a step q.

    q is the step of the row's value: a pulse count over a row errs by less than one pulse, and its mean rate by less
    than one pulse over the row's length.  Averaged rounding of single samples, if noise exceeds the step, is white
    noise.
    """

    name = "quantisation"
    confused_with = "white_noise if all rows have equally many samples"
    reference = "IEEE Std 952, quantization noise; GUM § F.2.2.1"

    q: Scalar = parameter("output", "lognormal(0.3 noise, 1.0)", (1e-9, 0.1), "the step of a row's value")

    def variance(self, entry: Entry) -> Scalars:
        return self.q**2 / 12


class CorrelatedNoise(SeriesNoise):
    """Autocorrelation φ^k between rows k apart in one run and channel, AR(1): r_k = φ·r_(k−1) + √(1 − φ²)·ε_k.

    The variances are those of the other components (white_noise, quantisation, rate_proportional_noise), whose sum is
    correlated as a whole.  Rows are in the order of time; a row without a value counts as a gap.
    """

    name = "correlated_noise"
    confused_with = "run_scatter if runs are short; a drift or a lag missing from the model"
    reference = "IEEE Std 952, exponentially correlated (Markov) noise; Box and Jenkins, AR(1)"

    correlation: Scalar = parameter("1", "uniform(0, 0.99)", (0.05, 0.95), "the correlation of neighbouring rows")

    def lag_one_correlation(self) -> Scalars:
        return self.correlation


class Outliers(TailNoise):
    """Student's t of ν degrees of freedom: p(x) ∝ (1 + x²/ν)^(−(ν + 1)/2), x the residual over white_noise.sigma.

    The influence of an outlier is bounded: its weight falls as (ν + 1)/(ν + x²).  The scale is that of the regular
    observations; ν of 3 to 8 is usual with outliers, above 30 the law is practically normal.
    """

    name = "outliers"
    excludes = ("correlated_noise",)
    confused_with = "rate_proportional_noise; an effect that shows in a few rows only"
    reference = "Lange, Little and Taylor (1989), t distribution; GUM § G.3"

    degrees_of_freedom: Scalar = parameter("1", "lognormal(8, 0.8)", (3, 30), "the degrees of freedom ν")

    def degrees(self) -> Scalars:
        return self.degrees_of_freedom


class RunScatter(SharedNoise):
    """One offset per run and channel, b ~ normal(0, τ), integrated out: any two entries of it have covariance τ².

    Few runs contain little information on τ, and the prior of τ then determines the distribution of the offset of a
    run.  A half-normal prior (Gelman 2006, for few groups) includes τ = 0 and gives it a kurtosis of 9: one
    offset in 1350 is beyond 6 of its standard deviations.  Under lognormal(·, 1) the kurtosis is 164, and it is one
    in 280.
    """

    name = "run_scatter"
    kinds = ("gyro", "accelerometer")
    excludes = ("gyro_run_bias", "accel_run_bias")
    confused_with = "temperature terms, when each run has one temperature"
    reference = "IEEE Std 952 and 1293, run-to-run repeatability; Gelman, Bayesian Analysis 1 (2006), 515"

    tau: Scalar = parameter(
        "output", "halfnormal(0.5 noise)", (1e-9, 0.1), "the standard deviation of the offset of a run"
    )

    def shared_variance(self) -> Scalars:
        return self.tau**2


_HOUR = 3600.0
# Below this x a series replaces (x − 1 + exp(−x))/x², which cancels there; the first neglected term is x³/120.
_SMALL = 1e-3
# Rows are without a gap if the time between them is below this share of a row: rounding of recorded times.
_TOUCHING = 1e-6


class FlickerNoise(SlowNoise):
    """Spectrum B²/(2πf): a sum of Gauss–Markov processes of variance B² ln(r)/π, correlation times r apart.

    Their times reach from half the shortest row to the longest run, with r of at most 5, if the spectrum deviates
    from 1/f by less than 1 %.  Faster processes are white noise of the row.
    """

    name = "flicker_noise"
    kinds = ("gyro", "accelerometer")
    excludes = ("correlated_noise", "outliers")
    confused_with = "random_walk_noise if all runs are short; run_scatter if runs have few rows"
    reference = "IEEE Std 952, annex C, bias instability; Keshner, 1/f noise, Proc. IEEE 70 (1982), 212"

    b: Scalar = parameter(
        "output", "lognormal(0.1 noise, 2.0)", (1e-9, 0.1), "the coefficient B; the Allan deviation is flat at 0.664 B"
    )

    def states(self, row: RowSpan) -> StateCovariance:
        ratio = row.times[1] / row.times[0]
        each = self.b**2 * jnp.log(ratio) / math.pi
        found = _decaying(jnp.full_like(row.times, each), row.times, row)
        faster = 2 * each * row.times[0] / ((ratio - 1) * row.length)
        return StateCovariance(found.variance + faster, found.mean, found.end, found.over_gap, found.over_row)


class RandomWalkNoise(SlowNoise):
    """Spectrum K²/(2πf)²: the output moves from its value at the start of a run with variance K² t."""

    name = "random_walk_noise"
    kinds = ("gyro", "accelerometer")
    excludes = ("correlated_noise", "outliers")
    confused_with = "flicker_noise if all runs are short; a drift in time"
    reference = "IEEE Std 952, annex C, rate random walk"

    k: Scalar = parameter(
        "output",
        "lognormal(0.1 noise, 2.0)",
        (1e-9, 0.1),
        "the standard deviation of a change over 1 h, K·√(1 h)",
    )

    def states(self, row: RowSpan) -> StateCovariance:
        squared = self.k**2 / _HOUR
        still = jnp.ones(1)
        end = squared * (row.start + row.length / 2) * still
        over_gap = jnp.where(jnp.isfinite(row.gap), 1.0, 0.0) * still
        return StateCovariance(squared * (row.start + row.length / 3), still, end, over_gap, still)


class GaussMarkovNoise(SlowNoise):
    """Gauss–Markov noise: autocovariance σ² exp(−t/T)."""

    name = "gauss_markov_noise"
    kinds = ("gyro", "accelerometer")
    excludes = ("correlated_noise", "outliers")
    confused_with = "flicker_noise and random_walk_noise if T is not well within the length of a run"
    reference = "IEEE Std 952, annex C, exponentially correlated (Markov) noise"

    sigma: Scalar = parameter("output", "lognormal(0.1 noise, 2.0)", (1e-9, 0.1), "the standard deviation σ")
    time: Scalar = parameter("s", "lognormal(600 s, 1.5)", (10, 1e4), "the correlation time T")

    def states(self, row: RowSpan) -> StateCovariance:
        return _decaying(jnp.reshape(self.sigma**2, (1,)), jnp.reshape(self.time, (1,)), row)


class PulseQuantisation(SlowNoise):
    """Variance 2Q²/T² of a row of T s, covariance −Q²/(T₁T₂) of rows that follow one another without a gap.

    The output counts pulses: their sum, an angle or a velocity, errs by white noise of standard deviation Q at the ends
    of a row (a twelfth of the squared weight of a pulse is Q²), and errors of successive rows are opposite.
    """

    name = "pulse_quantisation"
    kinds = ("gyro", "accelerometer")
    excludes = ("correlated_noise", "outliers", "quantisation")
    confused_with = "white_noise if all rows are equally long and apart"
    reference = "IEEE Std 952, annex C, quantization noise"

    q: Scalar = parameter(
        "output", "lognormal(0.01 noise, 2.0)", (1e-9, 0.1), "the coefficient Q, in output units times 1 s"
    )

    def states(self, row: RowSpan) -> StateCovariance:
        return of_shared_ends(self.q, row)


def of_shared_ends(size: Scalar, row: RowSpan) -> StateCovariance:
    """Return the covariance of a row whose integral errs by white noise at both ends, shared by rows that follow."""
    follows = row.gap < _TOUCHING * row.length
    one = jnp.ones(1)
    return StateCovariance(
        2 * (size / row.length) ** 2,
        -one / row.length,
        size**2 / row.length * one,
        jnp.where(follows, 1.0, 0.0) * one,
        0.0 * one,
    )


def _decaying(variance: Float[Array, " J"], times: Float[Array, " J"], row: RowSpan) -> StateCovariance:
    """Return the covariance of a row under independent processes of autocovariance variance · exp(−t/time)."""
    x = row.length / times
    series = 0.5 - x / 6 + x**2 / 24
    safe = jnp.where(x < _SMALL, 1.0, x)
    of_mean = 2 * jnp.where(x < _SMALL, series, (safe + jnp.expm1(-safe)) / safe**2)
    mean = jnp.where(x < _SMALL, 1 - x / 2 + x**2 / 6, -jnp.expm1(-safe) / safe)
    follows = jnp.isfinite(row.gap)
    over_gap = jnp.where(follows, jnp.exp(-jnp.where(follows, row.gap, 0.0) / times), 0.0)
    return StateCovariance(jnp.sum(variance * of_mean), mean, variance * mean, over_gap, jnp.exp(-x))
