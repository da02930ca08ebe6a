"""The components of the noise, one class each, registered in the order of their definitions."""

from imubayes.array_shapes import Scalar
from imubayes.noise.base import Entry, EntryNoise, SeriesNoise, SharedNoise, TailNoise
from imubayes.parameters.parameter_declarations import parameter


class WhiteNoise(EntryNoise):
    """Independent noise: variance σ²/n of a mean of n samples.

    σ is judged by the scatter of the rows about the model, not by the scatter within a row, which would miss what is
    slower than a row.
    """

    name = "white_noise"
    reference = "IEEE Std 952, angle random walk; GUM § 4.2.3"

    sigma: Scalar = parameter(
        "output", "lognormal(1 noise, 0.5)", (1e-9, 0.1), "the standard deviation of one raw sample"
    )

    def variance(self, entry: Entry) -> Scalar:
        return self.sigma**2 / entry.samples


class RateProportionalNoise(EntryNoise):
    """Variance (k·|Ω|)² of a row, Ω the nominal table rate along the input axis.

    What makes a row at high rate less repeatable (table rate instability, scale factor instability) lasts as long as
    the row: it does not average over the row's samples.
    """

    name = "rate_proportional_noise"
    kinds = ("gyro",)
    confused_with = "white_noise, where all rows have the same rate; a nonlinearity missing from the model"
    reference = "IEEE Std 952, scale factor repeatability; rate table stability of 1 … 100 ppm"

    k: Scalar = parameter("ppm", "lognormal(10 ppm, 1.5)", (0.1, 300), "the standard deviation per rate")

    def variance(self, entry: Entry) -> Scalar:
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

    def variance(self, entry: Entry) -> Scalar:
        return (entry.reference * self.sigma) ** 2 / entry.samples


class Quantisation(EntryNoise):
    """Variance q²/12 of a row, whatever the number of its samples: rounding is uniform over a step q.

    q is the step of the row's value: a pulse count over a row errs by less than one pulse, and its mean rate by less
    than one pulse over the row's length.  Averaged rounding of single samples, where noise exceeds the step, is white
    noise.
    """

    name = "quantisation"
    confused_with = "white_noise, where all rows have equally many samples"
    reference = "IEEE Std 952, quantization noise; GUM § F.2.2.1"

    q: Scalar = parameter("output", "lognormal(0.3 noise, 1.0)", (1e-9, 0.1), "the step of a row's value")

    def variance(self, entry: Entry) -> Scalar:
        return self.q**2 / 12


class CorrelatedNoise(SeriesNoise):
    """Autocorrelation φ^k between rows k apart in one run and channel, AR(1): r_k = φ·r_(k−1) + √(1 − φ²)·ε_k.

    The variances are those of the other components (white_noise, quantisation, rate_proportional_noise), whose sum is
    correlated as a whole.  Rows are in the order of time; a row without a value counts as a gap.
    """

    name = "correlated_noise"
    confused_with = "run_scatter, where runs are short; a drift or a lag missing from the model"
    reference = "IEEE Std 952, exponentially correlated (Markov) noise; Box and Jenkins, AR(1)"

    correlation: Scalar = parameter("1", "uniform(0, 0.99)", (0.05, 0.95), "the correlation of neighbouring rows")

    def lag_one_correlation(self) -> Scalar:
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

    def degrees(self) -> Scalar:
        return self.degrees_of_freedom


class RunScatter(SharedNoise):
    """One offset per run and channel, b ~ normal(0, τ), integrated out: any two entries of it have covariance τ².

    Few runs say little of τ, and the offset of a run then has the law that the prior of τ gives it.  A half-normal
    prior (Gelman 2006, for few groups) holds τ = 0 and gives that law a kurtosis of 9: one offset in 1350 is beyond 6
    of its standard deviations.  Under lognormal(·, 1) the kurtosis is 164, and it is one in 280.
    """

    name = "run_scatter"
    kinds = ("gyro", "accelerometer")
    excludes = ("gyro_run_bias", "accel_run_bias")
    confused_with = "temperature terms, when each run has one temperature"
    reference = "IEEE Std 952 and 1293, run-to-run repeatability; Gelman, Bayesian Analysis 1 (2006), 515"

    tau: Scalar = parameter(
        "output", "halfnormal(0.5 noise)", (1e-9, 0.1), "the standard deviation of the offset of a run"
    )

    def shared_variance(self) -> Scalar:
        return self.tau**2


class RotationClosure(EntryNoise):
    """Variance σ² of each component of the closing rotation of a free tumble: angle random walk, bandwidth, timing.

    The closing rotation is what remains when the gyros propagate the attitude from one pose to the next.
    """

    name = "rotation_closure"
    per = ("run",)
    kinds = ("closure",)
    nuisance = True
    reference = "definition; Tedaldi et al., ICRA 2014, eq. (16) takes it as equal for all transitions"

    sigma: Scalar = parameter(
        "arcsec", "lognormal(0.05 deg, 1.5)", (1, 3600), "the standard deviation of the closing rotation"
    )

    def variance(self, entry: Entry) -> Scalar:
        return self.sigma**2
