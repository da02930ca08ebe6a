"""Accelerometer dead zone: accelerations too small to be seen."""

import jax.numpy as jnp

from imubayes.effects.base import Order, SignalEffect, Stage
from imubayes.parameters.parameter import parameter
from imubayes.stimulus import Sample
from imubayes.types import Scalar


class AccelDeadZone(SignalEffect):
    """Dead zone of half width b: signal − clip(signal, −b, b).

    Inside the zone nothing is read; outside, the output is short of b, as of a play that is taken up first.
    """

    name = "accel_dead_zone"
    stage, order = Stage.SENSOR, Order.LIMIT
    kinds = ("accelerometer",)
    confused_with = "the bias, where the input axis always points up"
    reference = "IEEE Std 1293, dead band and threshold"

    half_width: Scalar = parameter("ug", "halfnormal(20 ug)", (0.1, 100), "half the width of the zone")

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        stuck = jnp.where(jnp.abs(signal) < self.half_width, signal, jnp.sign(signal) * self.half_width)
        return signal - stuck
