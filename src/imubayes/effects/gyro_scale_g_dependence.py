"""Gyro scale factor that changes with acceleration along the input axis."""

from imubayes.effects.base import Order, SignalEffect, Stage
from imubayes.parameters.parameter import parameter
from imubayes.stimulus import Sample
from imubayes.types import Scalar


class GyroScaleGDependence(SignalEffect):
    """Scale factor linear in specific force: signal + S_g·f_I·Ω."""

    name = "gyro_scale_g_dependence"
    stage, order = Stage.SENSOR, Order.SENSITIVITY
    kinds = ("gyro",)
    needs = ("turning",)
    confused_with = "the scale factor, where the input axis keeps its angle to gravity while it turns"
    reference = "IEEE Std 952, scale factor acceleration sensitivity; 1 … 100 ppm/g"

    dependence: Scalar = parameter("ppm/g", "normal(0, 50 ppm/g)", (1, 100), "the relative change of scale per g")

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        return signal + self.dependence * sample.force[0] * sample.rate[0]
