"""Second-order g-sensitivity: a gyro that answers to products of accelerations."""

from imubayes.effects.base import Order, SignalEffect, Stage
from imubayes.parameters.parameter import parameter
from imubayes.stimulus import Sample
from imubayes.types import Scalar


class GyroG2Sensitivity(SignalEffect):
    """signal + D_II f_I² + D_OO f_O² + D_SS f_S² + D_IO f_I f_O + D_OS f_O f_S + D_SI f_S f_I.

    In a 1 g field f_I² + f_O² + f_S² = g², so that the common part of the three squares is a bias.
    """

    name = "gyro_g2_sensitivity"
    stage, order = Stage.SENSOR, Order.SENSITIVITY
    kinds = ("gyro",)
    confused_with = "the bias: D_II, D_OO and D_SS together, in a 1 g field; a table axis that is tilted"
    reference = "IEEE Std 517, D_II … D_SI; 0.01 … 20 deg/h/g²"

    d_ii: Scalar = parameter("deg/h/g^2", "normal(0, 10 deg/h/g^2)", (0.01, 20), "the drift per g² along I")
    d_oo: Scalar = parameter("deg/h/g^2", "normal(0, 10 deg/h/g^2)", (0.01, 20), "the drift per g² along O")
    d_ss: Scalar = parameter("deg/h/g^2", "normal(0, 10 deg/h/g^2)", (0.01, 20), "the drift per g² along S")
    d_io: Scalar = parameter("deg/h/g^2", "normal(0, 10 deg/h/g^2)", (0.01, 20), "the drift per g² across I and O")
    d_os: Scalar = parameter("deg/h/g^2", "normal(0, 10 deg/h/g^2)", (0.01, 20), "the drift per g² across O and S")
    d_si: Scalar = parameter("deg/h/g^2", "normal(0, 10 deg/h/g^2)", (0.01, 20), "the drift per g² across S and I")

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        f_i, f_o, f_s = sample.force[0], sample.force[1], sample.force[2]
        squares = self.d_ii * f_i**2 + self.d_oo * f_o**2 + self.d_ss * f_s**2
        return signal + squares + self.d_io * f_i * f_o + self.d_os * f_o * f_s + self.d_si * f_s * f_i
