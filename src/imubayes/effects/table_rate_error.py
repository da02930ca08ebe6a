"""Table rate error: the table does not turn as fast as it says."""

from dataclasses import replace

from imubayes.effects.base import MotionEffect, Stage
from imubayes.parameters.parameter import parameter
from imubayes.stimulus import Ambient, Motion
from imubayes.types import Scalar


class TableRateError(MotionEffect):
    """Actual rate = indicated rate · (1 + e)."""

    name = "table_rate_error"
    stage = Stage.TABLE
    per = ("table",)
    needs = ("commanded",)
    confused_with = "a scale factor common to all gyros: exactly, unless a reference gyro rides along"
    reference = "IEEE Std 952, rate table accuracy"

    rate_error: Scalar = parameter(
        "ppm", "normal(0, 10 ppm)", (1, 50), "the relative error of the table's rate", "rate"
    )

    def apply(self, motion: Motion, ambient: Ambient) -> Motion:
        factor = 1 + self.rate_error
        return replace(
            motion,
            table_rate=motion.table_rate * factor,
            table_acceleration=motion.table_acceleration * factor,
        )
