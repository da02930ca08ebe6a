"""Bias of the reference gyro."""

from dataclasses import replace

from imubayes.effects.base import MotionEffect, Stage
from imubayes.parameters.parameter import parameter
from imubayes.stimulus import Ambient, Motion
from imubayes.types import Scalar, vector3


class ReferenceBias(MotionEffect):
    """Reading of each axis of the reference = true rate + b.

    It acts where a reference rides along; elsewhere there is nothing that it could be part of.
    """

    name = "reference_bias"
    stage, order = Stage.TABLE, -5
    per = ()
    needs = ("reference",)
    confused_with = "the bias of the gyro along the same axis: exactly, unless other runs determine that"
    reference = "IEEE Std 952, bias; of the reference, its certificate"

    x: Scalar = parameter("deg/h", "normal(0, 0.1 deg/h)", (0.001, 10), "the bias of the reference about body x")
    y: Scalar = parameter("deg/h", "normal(0, 0.1 deg/h)", (0.001, 10), "the bias of the reference about body y")
    z: Scalar = parameter("deg/h", "normal(0, 0.1 deg/h)", (0.001, 10), "the bias of the reference about body z")

    def apply(self, motion: Motion, ambient: Ambient) -> Motion:
        return replace(motion, reference_rate=motion.reference_rate - vector3(self.x, self.y, self.z))
