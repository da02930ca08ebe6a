"""Quadratic temperature coefficient of the gyro scale factor."""

from imubayes.effects.base import Order, SignalEffect, Stage
from imubayes.parameters.parameter import option, parameter
from imubayes.stimulus import Sample
from imubayes.types import Scalar


class GyroScaleTemperatureQuadratic(SignalEffect):
    """Scale factor quadratic in sensor temperature: signal · (1 + c·(T − T_ref)²)."""

    name = "gyro_scale_temperature_quadratic"
    stage, order = Stage.SENSOR, Order.SCALE
    kinds = ("gyro",)
    needs = ("temperature", "turning")
    confused_with = "the converter's quadratic gain drift, without injected current"
    reference = "IEEE Std 952, scale factor temperature sensitivity"

    curvature: Scalar = parameter(
        "ppm/degC^2", "normal(0, 1 ppm/degC^2)", (0.01, 2), "the relative change of scale per degree squared"
    )
    reference_degC: float = option(25.0, "reference temperature T_ref, °C")

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        return signal * (1 + self.curvature * (sample.ambient.temperature - self.reference_degC) ** 2)
