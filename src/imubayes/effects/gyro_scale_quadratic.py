"""Gyro scale factor linear in rate: an output quadratic in it."""

from imubayes.effects.base import Order, SignalEffect, Stage
from imubayes.parameters.parameter import parameter
from imubayes.stimulus import Sample
from imubayes.types import Scalar


class GyroScaleQuadratic(SignalEffect):
    """Second-order nonlinearity: signal + K2·Ω².

    Both directions err to the same side; 25 … 50 ppm at 200 … 400 °/s is 0.1 ppm/(°/s).
    """

    name = "gyro_scale_quadratic"
    stage, order = Stage.SENSOR, Order.SENSITIVITY
    kinds = ("gyro",)
    needs = ("turning",)
    confused_with = (
        "gyro_scale_asymmetry, where few rates are tested; the centripetal g-sensitivity of a unit off the axis"
    )
    reference = "IEEE Std 952, scale factor nonlinearity; 25 … 50 ppm at 200 … 400 °/s"

    quadratic: Scalar = parameter(
        "ppm/(deg/s)", "normal(0, 1 ppm/(deg/s))", (0.01, 1), "the second-order coefficient K2"
    )

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        return signal + self.quadratic * sample.rate[0] ** 2
