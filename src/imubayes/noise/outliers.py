"""Outliers: a few readings are far off, for reasons of their own."""

from imubayes.noise.base import TailNoise
from imubayes.parameters.parameter import parameter
from imubayes.types import Scalar


class Outliers(TailNoise):
    """Student's t of ν degrees of freedom: p(x) ∝ (1 + x²/ν)^(−(ν + 1)/2), x being the residual over white_noise.sigma.

    A reading that is far off pulls on nothing: its weight falls as (ν + 1)/(ν + x²).  The scale is that of the good
    readings; ν of 3 to 8 is usual where some are not, above 30 the law is normal for all purposes.
    """

    name = "outliers"
    excludes = ("correlated_noise",)
    confused_with = "rate_proportional_noise; an effect that shows in a few rows only"
    reference = "Lange, Little and Taylor (1989), t distribution; GUM § G.3"

    degrees_of_freedom: Scalar = parameter("1", "lognormal(8, 0.8)", (3, 30), "the ν of the law of one reading")

    def degrees(self) -> Scalar:
        return self.degrees_of_freedom
