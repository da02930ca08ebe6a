"""Accelerometer bias that drifts with time."""

from imubayes.effects.base import Order, SignalEffect, Stage
from imubayes.parameters.parameter import parameter
from imubayes.stimulus import Sample
from imubayes.types import Scalar


class AccelBiasDrift(SignalEffect):
    """Bias linear in time: signal + c·t.

    t counts from the beginning of the campaign's first run where the runs have a `start`, so that one drift goes
    through all of them; where none has, from the beginning of each run.
    """

    name = "accel_bias_drift"
    stage, order = Stage.SENSOR, Order.BIAS
    kinds = ("accelerometer",)
    needs = ("campaign_time",)
    confused_with = "run offsets; accel_bias_temperature_rate and accel_thermal_lag in a single monotonic ramp"
    reference = "IEEE Std 1293, bias trend"

    slope: Scalar = parameter("ug/h", "normal(0, 10 ug/h)", (0.01, 50), "the change of bias per hour")

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        return signal + self.slope * sample.ambient.campaign_time
