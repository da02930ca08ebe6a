"""Accelerometer bias under vibration."""

from imubayes.effects.base import Order, SignalEffect, Stage
from imubayes.parameters.parameter import parameter
from imubayes.stimulus import Sample
from imubayes.types import Scalar


class AccelVibrationRectification(SignalEffect):
    """Vibration rectification: signal + K_v·a_rms², a_rms the rms of vibration (column `vibration_g_rms`)."""

    name = "accel_vibration_rectification"
    stage, order = Stage.SENSOR, Order.BIAS
    kinds = ("accelerometer",)
    needs = ("vibration",)
    confused_with = "a bias, where all runs vibrate alike"
    reference = "IEEE Std 1293, vibration rectification coefficient; 1 … 100 µg/g²"

    rectification: Scalar = parameter(
        "ug/g^2", "normal(0, 50 ug/g^2)", (1, 500), "the bias per mean square of vibration"
    )

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        return signal + self.rectification * sample.ambient.vibration**2
