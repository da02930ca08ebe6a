"""Linear temperature coefficient of the gyro bias."""

from imubayes.effects.base import Order, SignalEffect, Stage
from imubayes.parameters.parameter import option, parameter
from imubayes.stimulus import Sample
from imubayes.types import Scalar


class GyroBiasTemperature(SignalEffect):
    """Bias linear in sensor temperature: signal + c·(T − T_ref)."""

    name = "gyro_bias_temperature"
    stage, order = Stage.SENSOR, Order.BIAS
    kinds = ("gyro",)
    needs = ("temperature",)
    confused_with = "run offsets, when each run has one temperature"
    reference = "IEEE Std 952, bias temperature sensitivity"

    slope: Scalar = parameter("deg/h/degC", "normal(0, 20 deg/h/degC)", (0.001, 60), "the change of bias per degree")
    reference_degC: float = option(25.0, "reference temperature T_ref, °C")

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        return signal + self.slope * (sample.ambient.temperature - self.reference_degC)
