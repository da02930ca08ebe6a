"""Gyro scale factor quadratic in rate: an output cubic in it."""

from imubayes.effects.base import Order, SignalEffect, Stage
from imubayes.parameters.parameter import parameter
from imubayes.stimulus import Sample
from imubayes.types import Scalar


class GyroScaleCubic(SignalEffect):
    """Third-order nonlinearity: signal + K3·Ω³.

    50 ppm at 400 °/s is 3·10⁻⁴ ppm/(°/s)².
    """

    name = "gyro_scale_cubic"
    stage, order = Stage.SENSOR, Order.SENSITIVITY
    kinds = ("gyro",)
    needs = ("turning",)
    confused_with = "the scale factor, where the rates span little; saturation near full scale"
    reference = "IEEE Std 952, scale factor nonlinearity; 25 … 50 ppm at 200 … 400 °/s"

    cubic: Scalar = parameter(
        "ppm/(deg/s)^2", "normal(0, 0.005 ppm/(deg/s)^2)", (1e-05, 0.01), "the third-order coefficient K3"
    )

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        return signal + self.cubic * sample.rate[0] ** 3
