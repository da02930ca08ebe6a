"""Table axis tilt: the rotation axis does not stand where it should."""

from dataclasses import replace

import jax.numpy as jnp

from imubayes.effects.base import MotionEffect, Stage
from imubayes.frames import compose, exponential
from imubayes.parameters.parameter import parameter
from imubayes.stimulus import Ambient, Motion
from imubayes.types import Scalar, vector3


class TableAxisTilt(MotionEffect):
    """Small rotation of the whole table about its own x and y: C_nt0 = C_nt0,nominal · exp([x, y, 0]×)."""

    name = "table_axis_tilt"
    stage = Stage.STAND
    per = ("table",)
    confused_with = "g-sensitivity of gyros; accelerometer misalignment where few mountings are tested"
    reference = "IEEE Std 1293, axis of rotation levelling error"

    x: Scalar = parameter("arcsec", "normal(0, 60 arcsec)", (1, 120), "the tilt about table x", "axis")
    y: Scalar = parameter("arcsec", "normal(0, 60 arcsec)", (1, 120), "the tilt about table y", "axis")

    def apply(self, motion: Motion, ambient: Ambient) -> Motion:
        tilt = exponential(vector3(self.x, self.y, jnp.zeros_like(self.x)))
        return replace(motion, base=compose(motion.base, tilt))
