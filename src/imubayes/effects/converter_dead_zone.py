"""Converter dead zone: currents too small to be converted."""

import jax.numpy as jnp

from imubayes.effects.base import Order, SignalEffect, Stage
from imubayes.parameters.parameter import parameter
from imubayes.stimulus import Sample
from imubayes.types import Scalar


class ConverterDeadZone(SignalEffect):
    """Dead zone of half width b: signal − clip(signal, −b, b).

    Inside the zone nothing is read; outside, the output is short of b, as of a play that is taken up first.
    """

    name = "converter_dead_zone"
    stage, order = Stage.CONVERTER, Order.LIMIT
    kinds = ("gyro", "accelerometer")
    confused_with = "the sensor's own dead zone, without injected current"
    reference = "dead zone of bipolar I/F and V/F converters about zero"

    half_width: Scalar = parameter("output", "halfnormal(1e-4 scale)", (1e-06, 0.01), "half the width of the zone")

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        stuck = jnp.where(jnp.abs(signal) < self.half_width, signal, jnp.sign(signal) * self.half_width)
        return signal - stuck
