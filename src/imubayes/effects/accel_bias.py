"""Accelerometer bias K0."""

from imubayes.effects.base import Order, SignalEffect, Stage
from imubayes.parameters.parameter import parameter
from imubayes.stimulus import Sample
from imubayes.types import Scalar


class AccelBias(SignalEffect):
    """Constant bias, referred to the input: signal + K0."""

    name = "accel_bias"
    stage, order = Stage.SENSOR, Order.BIAS
    kinds = ("accelerometer",)
    confused_with = "K2 and K_oo, K_pp in a 1 g tumble"
    reference = "IEEE Std 1293, K0"

    bias: Scalar = parameter("ug", "normal(0, 20 mg)", (50, 2000), "the constant offset K0")

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        return signal + self.bias
