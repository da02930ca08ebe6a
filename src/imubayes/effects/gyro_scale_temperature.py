"""Linear temperature coefficient of the gyro scale factor."""

from imubayes.effects.base import Order, SignalEffect, Stage
from imubayes.parameters.parameter import option, parameter
from imubayes.stimulus import Sample
from imubayes.types import Scalar


class GyroScaleTemperature(SignalEffect):
    """Scale factor linear in sensor temperature: signal · (1 + c·(T − T_ref))."""

    name = "gyro_scale_temperature"
    stage, order = Stage.SENSOR, Order.SCALE
    kinds = ("gyro",)
    needs = ("temperature", "turning")
    confused_with = "the converter's gain drift, without injected current"
    reference = "IEEE Std 952, scale factor temperature sensitivity"

    slope: Scalar = parameter(
        "ppm/degC", "normal(0, 100 ppm/degC)", (10, 100), "the relative change of scale per degree"
    )
    reference_degC: float = option(25.0, "reference temperature T_ref, °C")

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        return signal * (1 + self.slope * (sample.ambient.temperature - self.reference_degC))
