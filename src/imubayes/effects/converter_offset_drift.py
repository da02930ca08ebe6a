"""Converter offset drift with the converter's temperature."""

from imubayes.effects.base import Order, SignalEffect, Stage
from imubayes.parameters.parameter import option, parameter
from imubayes.stimulus import Sample
from imubayes.types import Scalar


class ConverterOffsetDrift(SignalEffect):
    """Offset linear in converter temperature: signal + o1·(T_c − T_ref)."""

    name = "converter_offset_drift"
    stage, order = Stage.CONVERTER, Order.OFFSET
    kinds = ("gyro", "accelerometer")
    needs = ("converter_temperature",)
    confused_with = "converter gain drift, with one input; the sensor's bias temperature coefficient"
    reference = "first-order thermal offset model of ADC, I/F and V/F converters"

    slope: Scalar = parameter(
        "output/degC", "normal(0, 1e-4 scale/degC)", (1e-6, 1e-2), "the change of offset per degree"
    )
    reference_degC: float = option(25.0, "reference temperature T_ref, °C")

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        return signal + self.slope * (sample.ambient.converter_temperature - self.reference_degC)
