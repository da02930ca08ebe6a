"""Gyro bias that follows a temperature behind the thermometer's."""

from imubayes.effects.base import Decay, Order, RecordEffect, Stage
from imubayes.parameters.parameter import parameter, time_constant
from imubayes.stimulus import Ambient, Sample
from imubayes.types import Scalar


class GyroThermalLag(RecordEffect):
    """Bias linear in the lag: signal + c·(T_τ − T) with dT_τ/dt = (T − T_τ)/τ, and T_τ = T where a run begins.

    A sensor whose bias follows the temperature inside alone has c equal to its coefficient in `gyro_bias_temperature`.
    Between two instants T is taken as straight, which makes the lag exact.
    """

    name = "gyro_thermal_lag"
    stage, order = Stage.SENSOR, Order.BIAS
    kinds = ("gyro",)
    needs = ("temperature", "temperature_rate")
    confused_with = (
        "gyro_bias_temperature_rate, where changes are slow against τ; gyro_bias_drift in a single monotonic ramp"
    )
    reference = "first-order lag, IEEE Std 952 thermal model; time constants of minutes"

    coefficient: Scalar = parameter("deg/h/degC", "normal(0, 20 deg/h/degC)", (0.001, 60), "the bias per degree of lag")
    tau: Scalar = time_constant("the time constant of the lag")

    def carry(self, before: Ambient, now: Ambient, seconds: Scalar) -> Decay:
        return Decay.behind(now.temperature - before.temperature, seconds / self.tau)

    def apply(self, signal: Scalar, sample: Sample, memory: Scalar) -> Scalar:
        return signal - self.coefficient * memory
