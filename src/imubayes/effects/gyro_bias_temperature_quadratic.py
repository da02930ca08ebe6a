"""Quadratic temperature coefficient of the gyro bias."""

from imubayes.effects.base import Order, SignalEffect, Stage
from imubayes.parameters.parameter import option, parameter
from imubayes.stimulus import Sample
from imubayes.types import Scalar


class GyroBiasTemperatureQuadratic(SignalEffect):
    """Bias quadratic in sensor temperature: signal + c·(T − T_ref)²."""

    name = "gyro_bias_temperature_quadratic"
    stage, order = Stage.SENSOR, Order.BIAS
    kinds = ("gyro",)
    needs = ("temperature",)
    confused_with = "run offsets, when each run has one temperature; the linear coefficient, on one side of T_ref"
    reference = "IEEE Std 952, bias temperature sensitivity"

    curvature: Scalar = parameter(
        "deg/h/degC^2", "normal(0, 0.5 deg/h/degC^2)", (0.0001, 2), "the change of bias per degree squared"
    )
    reference_degC: float = option(25.0, "reference temperature T_ref, °C")

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        return signal + self.curvature * (sample.ambient.temperature - self.reference_degC) ** 2
