"""Accelerometer scale factor K1."""

from imubayes.effects.base import Order, SignalEffect, Stage
from imubayes.parameters.parameter import parameter
from imubayes.stimulus import Sample
from imubayes.types import Scalar


class AccelScaleFactor(SignalEffect):
    """Relative deviation of K1 from nominal: signal · (1 + s)."""

    name = "accel_scale_factor"
    stage, order = Stage.SENSOR, Order.SCALE
    kinds = ("accelerometer",)
    confused_with = "K3 in a 1 g field"
    reference = "IEEE Std 1293, K1"

    scale: Scalar = parameter("ppm", "normal(0, 2000 ppm)", (10, 300), "the relative scale factor error")

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        return signal * (1 + self.scale)
