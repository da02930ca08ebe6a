"""Gravity anomaly: gravity at the test place is not what the campaign says."""

from dataclasses import replace

import jax.numpy as jnp

from imubayes.effects.base import MotionEffect, Stage
from imubayes.parameters.parameter import parameter
from imubayes.stimulus import Ambient, Motion
from imubayes.types import Scalar, vector3


class GravityAnomaly(MotionEffect):
    """True gravity = stated gravity + δg, along the vertical.

    Normal gravity of WGS 84 is off by some 10 µg as a rule and by 300 µg in mountains; a measured value leaves nothing.
    """

    name = "gravity_anomaly"
    stage = Stage.STAND
    per = ()
    confused_with = "a scale factor common to all accelerometers: exactly, where nothing but gravity is the input"
    reference = "Hofmann-Wellenhof and Moritz, Physical Geodesy, gravity anomalies; 1 … 300 µg"

    anomaly: Scalar = parameter("ug", "normal(0, 50 ug)", (1, 300), "the excess of true over stated gravity")

    def apply(self, motion: Motion, ambient: Ambient) -> Motion:
        zero = jnp.zeros_like(self.anomaly)
        return replace(motion, gravity=motion.gravity + vector3(zero, zero, self.anomaly))
