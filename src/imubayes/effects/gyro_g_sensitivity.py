"""Linear g-sensitivity: a gyro that answers to acceleration."""

from imubayes.effects.base import Order, SignalEffect, Stage
from imubayes.parameters.parameter import parameter
from imubayes.stimulus import Sample
from imubayes.types import Scalar


class GyroGSensitivity(SignalEffect):
    """Drift proportional to specific force: signal + D_I f_I + D_O f_O + D_S f_S."""

    name = "gyro_g_sensitivity"
    stage, order = Stage.SENSOR, Order.SENSITIVITY
    kinds = ("gyro",)
    confused_with = "levelling error and Earth rate components"
    reference = "IEEE Std 517, D_I, D_O, D_S"

    d_i: Scalar = parameter("deg/h/g", "normal(0, 100 deg/h/g)", (1, 576), "the drift per g along the input axis")
    d_o: Scalar = parameter("deg/h/g", "normal(0, 100 deg/h/g)", (1, 576), "the drift per g along the output axis")
    d_s: Scalar = parameter("deg/h/g", "normal(0, 100 deg/h/g)", (1, 576), "the drift per g along the spin axis")

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        force = sample.force
        return signal + self.d_i * force[0] + self.d_o * force[1] + self.d_s * force[2]
