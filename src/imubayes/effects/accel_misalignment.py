"""Accelerometer misalignment: the sensitive axis leans away from its nominal direction."""

import jax.numpy as jnp

from imubayes.effects.base import Order, SignalEffect, Stage
from imubayes.parameters.parameter import parameter
from imubayes.stimulus import Sample
from imubayes.types import Scalar


class AccelMisalignment(SignalEffect):
    """The true input axis is the unit vector along I + a·O + b·P: a leans toward O, b toward P."""

    name = "accel_misalignment"
    stage, order = Stage.SENSOR, Order.AXIS
    kinds = ("accelerometer",)
    confused_with = "mounting error common to all axes"
    reference = "IEEE Std 1293, δ_o and δ_p"

    toward_o: Scalar = parameter("arcsec", "normal(0, 200 arcsec)", (10, 200), "the lean toward O")
    toward_p: Scalar = parameter("arcsec", "normal(0, 200 arcsec)", (10, 200), "the lean toward P")

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        norm = jnp.sqrt(1 + self.toward_o**2 + self.toward_p**2)
        along, toward_o, toward_p = sample.force[0], sample.force[1], sample.force[2]
        seen = (along + self.toward_o * toward_o + self.toward_p * toward_p) / norm
        # What acted before this effect stays: only the projection changes.
        return signal + (seen - along)
