"""Accelerometer cross-axis nonlinearity K_oo, K_pp: squares of accelerations across the input."""

from imubayes.effects.base import Order, SignalEffect, Stage
from imubayes.parameters.parameter import parameter
from imubayes.stimulus import Sample
from imubayes.types import Scalar


class AccelCrossAxisQuadratic(SignalEffect):
    """Output quadratic in the cross axes: signal + K_oo a_o² + K_pp a_p².

    In a 1 g field a_i² + a_o² + a_p² = g²: the three squares are a bias and two independent terms.
    """

    name = "accel_cross_axis_quadratic"
    stage, order = Stage.SENSOR, Order.SENSITIVITY
    kinds = ("accelerometer",)
    confused_with = "bias and K2, in a 1 g field; a second harmonic of the dividing head"
    reference = "IEEE Std 1293, K_oo and K_pp"

    k_oo: Scalar = parameter("ug/g^2", "normal(0, 50 ug/g^2)", (1, 50), "the coefficient K_oo")
    k_pp: Scalar = parameter("ug/g^2", "normal(0, 50 ug/g^2)", (1, 50), "the coefficient K_pp")

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        return signal + self.k_oo * sample.force[1] ** 2 + self.k_pp * sample.force[2] ** 2
