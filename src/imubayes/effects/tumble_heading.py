"""Tumble heading: which way North is, for a unit that is turned by hand."""

from dataclasses import replace

import jax.numpy as jnp

from imubayes.effects.base import MotionEffect, Stage
from imubayes.frames import compose, exponential
from imubayes.parameters.parameter import parameter
from imubayes.stimulus import Ambient, Motion
from imubayes.types import Scalar, vector3


class TumbleHeading(MotionEffect):
    """Heading ψ of the whole run, C_nb = Rz(ψ) · C_nb,estimated; only the Earth's rotation depends on it."""

    name = "tumble_heading"
    stage = Stage.STAND
    per = ("run",)
    nuisance = True
    confused_with = "gyro biases, unless the gyros resolve the Earth rate"
    reference = "Groves, Principles of GNSS, Inertial and Multisensor Navigation, § 5.6.2 (gyrocompassing)"

    heading: Scalar = parameter("deg", "uniform(-180, 180 deg)", (1, 180), "the heading of the first pose")

    def apply(self, motion: Motion, ambient: Ambient) -> Motion:
        zero = jnp.zeros_like(self.heading)
        return replace(motion, base=compose(exponential(vector3(zero, zero, self.heading)), motion.base))
