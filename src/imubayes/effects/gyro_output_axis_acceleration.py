"""Gyro that answers to angular acceleration about its output axis."""

from imubayes.effects.base import Order, SignalEffect, Stage
from imubayes.parameters.parameter import parameter
from imubayes.stimulus import Sample
from imubayes.types import Scalar


class GyroOutputAxisAcceleration(SignalEffect):
    """Drift linear in angular acceleration: signal + k·dω_O/dt.

    For a single-degree-of-freedom gyro k is the float's moment of inertia over the wheel's angular momentum.
    """

    name = "gyro_output_axis_acceleration"
    stage, order = Stage.SENSOR, Order.SENSITIVITY
    kinds = ("gyro",)
    needs = ("acceleration",)
    confused_with = "a time skew between table and readings"
    reference = "IEEE Std 517, output-axis angular acceleration; 0.1 … 10 ms"

    coefficient: Scalar = parameter("ms", "normal(0, 5 ms)", (0.01, 50), "the rate per angular acceleration")

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        return signal + self.coefficient * sample.acceleration[1]
