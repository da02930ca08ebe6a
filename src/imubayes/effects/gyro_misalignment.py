"""Gyro misalignment: the sensitive axis leans away from its nominal direction."""

import jax.numpy as jnp

from imubayes.effects.base import Order, SignalEffect, Stage
from imubayes.parameters.parameter import parameter
from imubayes.stimulus import Sample
from imubayes.types import Scalar


class GyroMisalignment(SignalEffect):
    """The true input axis is the unit vector along I + a·O + b·S: a leans toward O, b toward S."""

    name = "gyro_misalignment"
    stage, order = Stage.SENSOR, Order.AXIS
    kinds = ("gyro",)
    confused_with = "mounting error common to all axes"
    reference = "IEEE Std 952, input axis misalignment"

    toward_o: Scalar = parameter("arcsec", "normal(0, 200 arcsec)", (10, 200), "the lean toward O")
    toward_s: Scalar = parameter("arcsec", "normal(0, 200 arcsec)", (10, 200), "the lean toward S")

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        norm = jnp.sqrt(1 + self.toward_o**2 + self.toward_s**2)
        along, toward_o, toward_s = sample.rate[0], sample.rate[1], sample.rate[2]
        seen = (along + self.toward_o * toward_o + self.toward_s * toward_s) / norm
        # What acted before this effect stays: only the projection changes.
        return signal + (seen - along)
