"""Mounting error: the unit does not sit in its fixture as drawn."""

from dataclasses import replace

from imubayes.effects.base import MotionEffect, Stage
from imubayes.frames import compose, exponential
from imubayes.parameters.parameter import parameter
from imubayes.stimulus import Ambient, Motion
from imubayes.types import Scalar, vector3


class MountingError(MotionEffect):
    """Small rotation of the body in its seat: C_tb = C_tb,nominal · exp([δ]×), δ in body axes.

    At the trihedral angle 1 arcsec of it changes cos θ, and with it the apparent scale factor, by tan θ = √2 per
    radian, which is 6.86 ppm.
    """

    name = "mounting_error"
    stage = Stage.STAND
    per = ("mounting",)
    confused_with = "scale factor and table rate error, where only one mounting is tested"
    reference = "first-order attitude error, body axes; IEEE Std 952, mounting misalignment"

    x: Scalar = parameter("arcsec", "normal(0, 5 arcmin)", (1, 600), "the turn about body x", "seat")
    y: Scalar = parameter("arcsec", "normal(0, 5 arcmin)", (1, 600), "the turn about body y", "seat")
    z: Scalar = parameter("arcsec", "normal(0, 5 arcmin)", (1, 600), "the turn about body z", "seat")

    def apply(self, motion: Motion, ambient: Ambient) -> Motion:
        turn = exponential(vector3(self.x, self.y, self.z))
        return replace(motion, mounting=compose(motion.mounting, turn))
