"""Accelerometer second-order nonlinearity K2."""

from imubayes.effects.base import Order, SignalEffect, Stage
from imubayes.parameters.parameter import parameter
from imubayes.stimulus import Sample
from imubayes.types import Scalar


class AccelQuadratic(SignalEffect):
    """Output quadratic in the input: signal + K2 a_i²."""

    name = "accel_quadratic"
    stage, order = Stage.SENSOR, Order.SENSITIVITY
    kinds = ("accelerometer",)
    confused_with = "K_oo and K_pp, and a second harmonic of the dividing head"
    reference = "IEEE Std 1293, K2"

    quadratic: Scalar = parameter("ug/g^2", "normal(0, 50 ug/g^2)", (1, 50), "the second-order coefficient K2")

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        return signal + self.quadratic * sample.force[0] ** 2
