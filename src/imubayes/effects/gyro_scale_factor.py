"""Gyro scale factor error."""

from imubayes.effects.base import Order, SignalEffect, Stage
from imubayes.parameters.parameter import parameter
from imubayes.stimulus import Sample
from imubayes.types import Scalar


class GyroScaleFactor(SignalEffect):
    """Relative deviation of the scale factor from nominal: signal · (1 + s)."""

    name = "gyro_scale_factor"
    stage, order = Stage.SENSOR, Order.SCALE
    kinds = ("gyro",)
    needs = ("turning",)
    confused_with = "mounting angle and table rate error, in one mounting"
    reference = "IEEE Std 952, scale factor S"

    scale: Scalar = parameter("ppm", "normal(0, 2000 ppm)", (10, 500), "the relative scale factor error")

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        return signal * (1 + self.scale)
