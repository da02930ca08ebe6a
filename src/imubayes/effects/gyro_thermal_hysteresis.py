"""Gyro bias that differs between warming and cooling."""

from imubayes.effects.base import Order, Play, RecordEffect, Stage
from imubayes.parameters.parameter import parameter
from imubayes.stimulus import Ambient, Sample
from imubayes.types import Scalar


class GyroThermalHysteresis(RecordEffect):
    """Bias that is dragged behind temperature: signal + h·m/w, where m follows T with play ±w: m ← clip(m + ΔT, −w, w).

    After more than 2w of warming the bias is h above the middle of the loop, after as much cooling h below it, however
    fast either was; each run begins in the middle.
    """

    name = "gyro_thermal_hysteresis"
    stage, order = Stage.SENSOR, Order.BIAS
    kinds = ("gyro",)
    needs = ("temperature", "temperature_rate")
    confused_with = "gyro_thermal_lag, at one ramp rate; gyro_bias_temperature, where no run turns back"
    reference = "play operator, Visintin, Differential Models of Hysteresis, ch. III; IEEE Std 952, thermal hysteresis"

    half_width: Scalar = parameter("deg/h", "normal(0, 10 deg/h)", (0.01, 50), "half the height of the loop")
    play: Scalar = parameter(
        "degC",
        "lognormal(3 degC, 0.7)",
        (0.5, 20),
        "the play w, half the width of the loop",
        null=3.0,
        shape=(0.5, 1.5, 3.0, 6.0, 12.0),
    )

    def carry(self, before: Ambient, now: Ambient, seconds: Scalar) -> Play:
        return Play(now.temperature - before.temperature, -self.play, self.play)

    def apply(self, signal: Scalar, sample: Sample, memory: Scalar) -> Scalar:
        return signal + self.half_width * memory / self.play
