"""Noise of IEEE Std 952 in continuous time: flicker, random walk, Gauss–Markov and quantisation noise.

The parameters are those of `imubayes noise`, shared by all runs of a channel, so that a static record determines them
for short runs too.  Rows are means over time: covariances are integrals of the autocovariance over the rows.  What is
slower than the longest run is part of the bias: no run tells them apart.
"""

import math

import jax.numpy as jnp

from imubayes.array_shapes import Array, Float, Scalar
from imubayes.noise.base import RowSpan, SlowNoise, StateCovariance
from imubayes.parameters.parameter_declarations import parameter

_HOUR = 3600.0
# Below this x a series replaces (x − 1 + exp(−x))/x², which cancels there; the first neglected term is x³/120.
_SMALL = 1e-3
# Rows are without a gap where the time between them is below this share of a row: rounding of recorded times.
_TOUCHING = 1e-6


class FlickerNoise(SlowNoise):
    """Spectrum B²/(2πf): a sum of Gauss–Markov processes of variance B² ln(r)/π, correlation times r apart.

    Their times reach from half the shortest row to the longest run, with r of at most 5, where the spectrum deviates
    from 1/f by less than 1 %.  Faster processes are white noise of the row.
    """

    name = "flicker_noise"
    kinds = ("gyro", "accelerometer")
    excludes = ("correlated_noise", "outliers")
    confused_with = "random_walk_noise, where all runs are short; run_scatter, where runs have few rows"
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
    confused_with = "flicker_noise, where all runs are short; a drift in time"
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
    confused_with = "flicker_noise and random_walk_noise, where T is not well within the length of a run"
    reference = "IEEE Std 952, annex C, exponentially correlated (Markov) noise"

    sigma: Scalar = parameter("output", "lognormal(0.1 noise, 2.0)", (1e-9, 0.1), "the standard deviation σ")
    time: Scalar = parameter("s", "lognormal(600 s, 1.5)", (10, 1e4), "the correlation time T")

    def states(self, row: RowSpan) -> StateCovariance:
        return _decaying(jnp.reshape(self.sigma**2, (1,)), jnp.reshape(self.time, (1,)), row)


class PulseQuantisation(SlowNoise):
    """Variance 2Q²/T² of a row of T s, covariance −Q²/(T₁T₂) of rows that follow one another without a gap.

    The output counts pulses: their sum, an angle or a velocity, errs by white noise of standard deviation Q at the ends
    of a row (a twelfth of the squared weight of a pulse is Q²), and what one row lacks the next one has.
    """

    name = "pulse_quantisation"
    kinds = ("gyro", "accelerometer")
    excludes = ("correlated_noise", "outliers", "quantisation")
    confused_with = "white_noise, where all rows are equally long and apart"
    reference = "IEEE Std 952, annex C, quantization noise"

    q: Scalar = parameter(
        "output", "lognormal(0.01 noise, 2.0)", (1e-9, 0.1), "the coefficient Q, in output units times 1 s"
    )

    def states(self, row: RowSpan) -> StateCovariance:
        follows = row.gap < _TOUCHING * row.length
        one = jnp.ones(1)
        return StateCovariance(
            2 * (self.q / row.length) ** 2,
            -one / row.length,
            self.q**2 / row.length * one,
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
