"""Linear temperature coefficient of the accelerometer bias."""

from imubayes.effects.base import Order, SignalEffect, Stage
from imubayes.parameters.parameter import option, parameter
from imubayes.stimulus import Sample
from imubayes.types import Scalar


class AccelBiasTemperature(SignalEffect):
    """Bias linear in sensor temperature: signal + c·(T − T_ref)."""

    name = "accel_bias_temperature"
    stage, order = Stage.SENSOR, Order.BIAS
    kinds = ("accelerometer",)
    needs = ("temperature",)
    confused_with = "run offsets, when each run has one temperature"
    reference = "IEEE Std 1293, bias temperature sensitivity"

    slope: Scalar = parameter("ug/degC", "normal(0, 100 ug/degC)", (1, 100), "the change of bias per degree")
    reference_degC: float = option(25.0, "reference temperature T_ref, °C")

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        return signal + self.slope * (sample.ambient.temperature - self.reference_degC)
