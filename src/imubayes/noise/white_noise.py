"""White noise: independent from sample to sample."""

from imubayes.noise.base import Entry, EntryNoise
from imubayes.parameters.parameter import parameter
from imubayes.types import Scalar


class WhiteNoise(EntryNoise):
    """Variance σ²/n of a mean of n samples.

    σ is judged by the scatter of the rows about the model, not by the scatter within a row: what is slower than a row
    would otherwise be missed.
    """

    name = "white_noise"
    reference = "IEEE Std 952, angle random walk; GUM § 4.2.3"

    sigma: Scalar = parameter(
        "output", "lognormal(1 noise, 0.5)", (1e-6, 1e3), "the standard deviation of one raw sample"
    )

    def variance(self, entry: Entry) -> Scalar:
        return self.sigma**2 / entry.samples
