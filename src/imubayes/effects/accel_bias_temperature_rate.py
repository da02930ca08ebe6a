"""Accelerometer bias that follows the rate of temperature."""

from imubayes.effects.base import Order, SignalEffect, Stage
from imubayes.parameters.parameter import parameter
from imubayes.stimulus import Sample
from imubayes.types import Scalar


class AccelBiasTemperatureRate(SignalEffect):
    """Bias linear in the rate of sensor temperature: signal + c·dT/dt, the sign of gradients inside the sensor."""

    name = "accel_bias_temperature_rate"
    stage, order = Stage.SENSOR, Order.BIAS
    kinds = ("accelerometer",)
    needs = ("temperature_rate",)
    confused_with = (
        "accel_thermal_lag and accel_bias_drift, in a single monotonic ramp: two ramp rates or a cycle tell them apart"
    )
    reference = "IEEE Std 1293, bias thermal-transient sensitivity"

    slope: Scalar = parameter(
        "ug/(degC/min)", "normal(0, 100 ug/(degC/min))", (1, 500), "the bias per rate of temperature"
    )

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        return signal + self.slope * sample.ambient.temperature_rate
