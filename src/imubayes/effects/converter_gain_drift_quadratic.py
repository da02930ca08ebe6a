"""Converter gain quadratic in the converter's temperature."""

from imubayes.effects.base import Order, SignalEffect, Stage
from imubayes.parameters.parameter import option, parameter
from imubayes.stimulus import Sample
from imubayes.types import Scalar


class ConverterGainDriftQuadratic(SignalEffect):
    """Gain quadratic in converter temperature: signal · (1 + γ2·(T_c − T_ref)²)."""

    name = "converter_gain_drift_quadratic"
    stage, order = Stage.CONVERTER, Order.GAIN
    kinds = ("gyro", "accelerometer")
    needs = ("converter_temperature",)
    confused_with = "converter offset drift, with one input; the sensor's quadratic scale temperature coefficient"
    reference = "second-order thermal gain model of ADC, I/F and V/F converters"

    curvature: Scalar = parameter(
        "ppm/degC^2", "normal(0, 2 ppm/degC^2)", (0.01, 5), "the relative change of gain per degree squared"
    )
    reference_degC: float = option(25.0, "reference temperature T_ref, °C")

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        return signal * (1 + self.curvature * (sample.ambient.converter_temperature - self.reference_degC) ** 2)
