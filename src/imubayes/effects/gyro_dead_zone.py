"""Gyro dead zone: rates too small to be seen."""

import jax.numpy as jnp

from imubayes.effects.base import Order, SignalEffect, Stage
from imubayes.parameters.parameter import parameter
from imubayes.stimulus import Sample
from imubayes.types import Scalar


class GyroDeadZone(SignalEffect):
    """Dead zone of half width b: signal − clip(signal, −b, b).

    Inside the zone nothing is read; outside, the output is short of b, as of a play that is taken up first.  A gyro
    that locks in is another thing: it misses less and less above its threshold.
    """

    name = "gyro_dead_zone"
    stage, order = Stage.SENSOR, Order.LIMIT
    kinds = ("gyro",)
    confused_with = "gyro_scale_asymmetry and the bias, where every run turns one way"
    reference = "IEEE Std 952, dead zone"

    half_width: Scalar = parameter("deg/h", "halfnormal(5 deg/h)", (0.01, 50), "half the width of the zone")

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        stuck = jnp.where(jnp.abs(signal) < self.half_width, signal, jnp.sign(signal) * self.half_width)
        return signal - stuck
