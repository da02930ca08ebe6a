"""Converter gain drift with the converter's temperature."""

from imubayes.effects.base import Order, SignalEffect, Stage
from imubayes.parameters.parameter import option, parameter
from imubayes.stimulus import Sample
from imubayes.types import Scalar


class ConverterGainDrift(SignalEffect):
    """Gain linear in converter temperature: signal · (1 + γ1·(T_c − T_ref))."""

    name = "converter_gain_drift"
    stage, order = Stage.CONVERTER, Order.GAIN
    kinds = ("gyro", "accelerometer")
    needs = ("converter_temperature",)
    confused_with = "converter offset drift, with one input; the sensor's scale temperature coefficient"
    reference = "first-order thermal gain model of ADC, I/F and V/F converters"

    slope: Scalar = parameter("ppm/degC", "normal(0, 100 ppm/degC)", (1, 100), "the relative change of gain per degree")
    reference_degC: float = option(25.0, "reference temperature T_ref, °C")

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        return signal * (1 + self.slope * (sample.ambient.converter_temperature - self.reference_degC))
