"""Time skew: the table's record and the unit's readings are not of the same instant."""

from dataclasses import replace

from imubayes.effects.base import MotionEffect, Order, Stage
from imubayes.parameters.parameter import parameter
from imubayes.stimulus import Ambient, Motion
from imubayes.types import Scalar


class TimeSkew(MotionEffect):
    """True angle = φ + Ω·δ + ½ Ω̇·δ², true rate = Ω + Ω̇·δ: the unit reads what the table does δ after its record.

    At a constant rate over whole turns it changes nothing: rows of known angle that turn show it, or a rate that
    changes.
    """

    name = "time_skew"
    stage, order = Stage.TABLE, Order.TIME
    per = ("table",)
    needs = ("turning",)
    confused_with = "an error of the table's angle, where all runs turn at one rate in one direction"
    reference = "first-order clock offset between table and unit; 0.01 … 50 ms"

    skew: Scalar = parameter("ms", "normal(0, 5 ms)", (0.01, 100), "the delay of the readings' instant")

    def apply(self, motion: Motion, ambient: Ambient) -> Motion:
        rate, acceleration = motion.table_rate, motion.table_acceleration
        return replace(
            motion,
            table_angle=motion.table_angle + rate * self.skew + 0.5 * acceleration * self.skew**2,
            table_rate=rate + acceleration * self.skew,
            reference_rate=motion.reference_rate + motion.reference_acceleration * self.skew,
        )
