"""Converter offset quadratic in the converter's temperature."""

from imubayes.effects.base import Order, SignalEffect, Stage
from imubayes.parameters.parameter import option, parameter
from imubayes.stimulus import Sample
from imubayes.types import Scalar


class ConverterOffsetDriftQuadratic(SignalEffect):
    """Offset quadratic in converter temperature: signal + o2·(T_c − T_ref)²."""

    name = "converter_offset_drift_quadratic"
    stage, order = Stage.CONVERTER, Order.OFFSET
    kinds = ("gyro", "accelerometer")
    needs = ("converter_temperature",)
    confused_with = "converter_leakage; converter gain drift, with one input"
    reference = "second-order thermal offset model of ADC, I/F and V/F converters"

    curvature: Scalar = parameter(
        "output/degC^2", "normal(0, 1e-5 scale/degC^2)", (1e-08, 0.001), "the change of offset per degree squared"
    )
    reference_degC: float = option(25.0, "reference temperature T_ref, °C")

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        return signal + self.curvature * (sample.ambient.converter_temperature - self.reference_degC) ** 2
