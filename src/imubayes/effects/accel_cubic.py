"""Accelerometer third-order nonlinearity K3."""

from imubayes.effects.base import Order, SignalEffect, Stage
from imubayes.parameters.parameter import parameter
from imubayes.stimulus import Sample
from imubayes.types import Scalar


class AccelCubic(SignalEffect):
    """Output cubic in the input: signal + K3 a_i³."""

    name = "accel_cubic"
    stage, order = Stage.SENSOR, Order.SENSITIVITY
    kinds = ("accelerometer",)
    confused_with = "K1, in a 1 g field of few positions; a third harmonic of the dividing head"
    reference = "IEEE Std 1293, K3"

    cubic: Scalar = parameter("ug/g^3", "normal(0, 20 ug/g^3)", (0.1, 20), "the third-order coefficient K3")

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        return signal + self.cubic * sample.force[0] ** 3
