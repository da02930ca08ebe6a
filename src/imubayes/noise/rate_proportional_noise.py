"""Rate-proportional noise: scatter that grows with the rate."""

from imubayes.noise.base import Entry, EntryNoise
from imubayes.parameters.parameter import parameter
from imubayes.types import Scalar


class RateProportionalNoise(EntryNoise):
    """Variance (k·|Ω|)² of a row, Ω the nominal table rate along the input axis.

    What makes a row at high rate less repeatable (a table that does not hold its rate, a scale factor that flickers)
    lasts as long as the row: more samples in it do not average it away.
    """

    name = "rate_proportional_noise"
    kinds = ("gyro",)
    needs = ("turning",)
    confused_with = "white_noise, where all rows turn equally fast; a nonlinearity that the model lacks"
    reference = "IEEE Std 952, scale factor repeatability; rate table stability of 1 … 100 ppm"

    k: Scalar = parameter("ppm", "lognormal(10 ppm, 1.5)", (0.1, 300), "the standard deviation per rate")

    def variance(self, entry: Entry) -> Scalar:
        return (self.k * entry.rate) ** 2
