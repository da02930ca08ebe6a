"""Start of a servo-table record: the table's angle when its first reading was taken."""

from dataclasses import replace

from imubayes.effects.base import MotionEffect, Stage
from imubayes.parameters.parameter import parameter
from imubayes.stimulus import Ambient, Motion
from imubayes.types import Scalar


class ServoStart(MotionEffect):
    """True angle at the first row = its reading + δ; every servo-table run has one, listed or not."""

    name = "servo_start"
    stage = Stage.STAND
    per = ("run",)
    needs = ("driven",)
    nuisance = True
    reference = "initial condition of the differential equation"

    angle: Scalar = parameter("arcsec", "normal(0, 5 arcmin)", (0.1, 60), "the error of the first reading")

    def apply(self, motion: Motion, ambient: Ambient) -> Motion:
        return replace(motion, table_angle=motion.table_angle + self.angle)
