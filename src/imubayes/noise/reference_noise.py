"""Noise of a reference gyro: the rate that it measured is not the true one."""

from imubayes.noise.base import Entry, EntryNoise
from imubayes.parameters.parameter import parameter
from imubayes.types import Scalar


class ReferenceNoise(EntryNoise):
    """Variance (k σ)²/n of a mean of n samples, k being the gyro's scale.

    The true rate of every row is unknown.  Integrated out under a flat prior (errors in variables), it leaves the
    reading of the reference in its place and adds K Kᵀ σ²/n to the covariance of the row's channels.  That is diagonal
    where the input axes are perpendicular to each other; what they share otherwise, at most the ratio of the two
    variances, is left out.
    """

    name = "reference_noise"
    kinds = ("gyro",)
    per = ()
    needs = ("reference",)
    confused_with = "the noise of the gyros themselves, unless runs without the reference determine that"
    reference = "Fuller, Measurement Error Models (1987)"

    sigma: Scalar = parameter(
        "deg/s", "lognormal(2e-4 deg/s, 1)", (1e-6, 1e-2), "the standard deviation of one raw sample of the reference"
    )

    def variance(self, entry: Entry) -> Scalar:
        return (entry.reference * self.sigma) ** 2 / entry.samples
