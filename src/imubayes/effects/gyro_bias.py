"""Gyro bias: the rate a gyro reports at rest, Earth rate taken out."""

from imubayes.effects.base import Order, SignalEffect, Stage
from imubayes.parameters.parameter import parameter
from imubayes.stimulus import Sample
from imubayes.types import Scalar


class GyroBias(SignalEffect):
    """Constant bias, referred to the input: signal + b."""

    name = "gyro_bias"
    stage, order = Stage.SENSOR, Order.BIAS
    kinds = ("gyro",)
    confused_with = "run offsets, where every run has its own"
    reference = "IEEE Std 952, bias (D_F)"

    bias: Scalar = parameter("deg/h", "normal(0, 3600 deg/h)", (0.01, 1800), "the constant rate offset")

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        return signal + self.bias
