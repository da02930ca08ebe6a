"""Rotation closure: what is left when the gyros carry one pose of a free tumble into the next."""

from imubayes.noise.base import Entry, EntryNoise
from imubayes.parameters.parameter import parameter
from imubayes.types import Scalar


class RotationClosure(EntryNoise):
    """Variance σ² of each component of the closing rotation: angle random walk, bandwidth, timing."""

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
