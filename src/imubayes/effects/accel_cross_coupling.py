"""Accelerometer cross-coupling K_ip, K_io: products of the input with accelerations across it."""

from imubayes.effects.base import Order, SignalEffect, Stage
from imubayes.parameters.parameter import parameter
from imubayes.stimulus import Sample
from imubayes.types import Scalar


class AccelCrossCoupling(SignalEffect):
    """Output with products: signal + K_ip a_i a_p + K_io a_i a_o."""

    name = "accel_cross_coupling"
    stage, order = Stage.SENSOR, Order.SENSITIVITY
    kinds = ("accelerometer",)
    confused_with = "a second harmonic of the dividing head; the angle of mounting to second order"
    reference = "IEEE Std 1293, K_ip and K_io"

    k_ip: Scalar = parameter("ug/g^2", "normal(0, 50 ug/g^2)", (1, 50), "the coefficient K_ip")
    k_io: Scalar = parameter("ug/g^2", "normal(0, 50 ug/g^2)", (1, 50), "the coefficient K_io")

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        a_i, a_o, a_p = sample.force[0], sample.force[1], sample.force[2]
        return signal + self.k_ip * a_i * a_p + self.k_io * a_i * a_o
