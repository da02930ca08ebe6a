"""Gyro bias that follows the rate of temperature."""

from imubayes.effects.base import Order, SignalEffect, Stage
from imubayes.parameters.parameter import parameter
from imubayes.stimulus import Sample
from imubayes.types import Scalar


class GyroBiasTemperatureRate(SignalEffect):
    """Bias linear in the rate of sensor temperature: signal + c·dT/dt, the Shupe term of a fibre-optic gyro."""

    name = "gyro_bias_temperature_rate"
    stage, order = Stage.SENSOR, Order.BIAS
    kinds = ("gyro",)
    needs = ("temperature_rate",)
    confused_with = (
        "gyro_thermal_lag and gyro_bias_drift, in a single monotonic ramp: two ramp rates or a cycle tell them apart"
    )
    reference = "Shupe, Applied Optics 1980; IEEE Std 952, bias temperature gradient; 10 deg/h at 1 degC/min"

    slope: Scalar = parameter(
        "deg/h/(degC/min)", "normal(0, 20 deg/h/(degC/min))", (0.1, 60), "the bias per rate of temperature"
    )

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        return signal + self.slope * sample.ambient.temperature_rate
