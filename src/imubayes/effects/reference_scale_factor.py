"""Scale factor of the reference gyro."""

from dataclasses import replace

from imubayes.effects.base import MotionEffect, Stage
from imubayes.parameters.parameter import parameter
from imubayes.stimulus import Ambient, Motion
from imubayes.types import Scalar, vector3


class ReferenceScaleFactor(MotionEffect):
    """Reading of each axis of the reference = (1 + s) · true rate."""

    name = "reference_scale_factor"
    stage = Stage.TABLE
    per = ()
    needs = ("reference",)
    confused_with = "a scale factor of the gyro along the same axis: exactly, but for the priors"
    reference = "IEEE Std 952, scale factor error; of the reference, its certificate"

    x: Scalar = parameter("ppm", "normal(0, 10 ppm)", (1, 100), "the relative error of the reference about body x")
    y: Scalar = parameter("ppm", "normal(0, 10 ppm)", (1, 100), "the relative error of the reference about body y")
    z: Scalar = parameter("ppm", "normal(0, 10 ppm)", (1, 100), "the relative error of the reference about body z")

    def apply(self, motion: Motion, ambient: Ambient) -> Motion:
        factor = 1 + vector3(self.x, self.y, self.z)
        return replace(
            motion,
            reference_rate=motion.reference_rate / factor,
            reference_acceleration=motion.reference_acceleration / factor,
        )
