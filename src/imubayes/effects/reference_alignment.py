"""Alignment of the reference gyro to the unit."""

from dataclasses import replace

from imubayes.effects.base import MotionEffect, Order, Stage
from imubayes.frames import exponential, rotate
from imubayes.parameters.parameter import parameter
from imubayes.stimulus import Ambient, Motion
from imubayes.types import Scalar, vector3


class ReferenceAlignment(MotionEffect):
    """Rate in body axes = exp([δ]×) · rate in the axes of the reference."""

    name = "reference_alignment"
    stage, order = Stage.TABLE, Order.AXIS
    per = ()
    needs = ("reference",)
    confused_with = "misalignments of all gyros together, unless runs without the reference determine them"
    reference = "physics of a rigid fixture; Titterton and Weston § 3.6"

    x: Scalar = parameter("arcsec", "normal(0, 5 arcmin)", (10, 1000), "the turn of the reference about body x")
    y: Scalar = parameter("arcsec", "normal(0, 5 arcmin)", (10, 1000), "the turn of the reference about body y")
    z: Scalar = parameter("arcsec", "normal(0, 5 arcmin)", (10, 1000), "the turn of the reference about body z")

    def apply(self, motion: Motion, ambient: Ambient) -> Motion:
        turn = exponential(vector3(self.x, self.y, self.z))
        return replace(
            motion,
            reference_rate=rotate(turn, motion.reference_rate),
            reference_acceleration=rotate(turn, motion.reference_acceleration),
        )
