"""Table wobble: the direction of the rotation axis changes as the table turns."""

from dataclasses import replace

import jax.numpy as jnp

from imubayes.effects.base import MotionEffect, Order, Stage
from imubayes.frames import compose, exponential
from imubayes.parameters.parameter import parameter
from imubayes.stimulus import Ambient, Motion
from imubayes.types import Scalar, vector3


class TableWobble(MotionEffect):
    """C_nt = C_nt0 · W(φ) · Rz(φ), W = exp([x, y, 0]×), x = Σ_n (x_cos_n cos nφ + x_sin_n sin nφ), y alike, n = 1, 2.

    x and y are about the table's axes at angle 0.  A wobble that goes round with the table (x_cos_1 = y_sin_1,
    x_sin_1 = −y_cos_1) is a mounting error and nothing else.  Its own rate of turn, 1 arcsec times the table's rate, is
    left out.
    """

    name = "table_wobble"
    stage, order = Stage.TABLE, Order.AXIS
    per = ("table",)
    needs = ("table_angle",)
    confused_with = (
        "mounting error, for the part that goes round with the table; table_axis_tilt where few angles are used"
    )
    reference = "IEEE Std 1293, axis wobble of rotary tables; 0.1 … 10 arcsec"

    x_cos_1: Scalar = parameter("arcsec", "normal(0, 5 arcsec)", (0.1, 30), "the tilt about x with cos φ")
    x_sin_1: Scalar = parameter("arcsec", "normal(0, 5 arcsec)", (0.1, 30), "the tilt about x with sin φ")
    y_cos_1: Scalar = parameter("arcsec", "normal(0, 5 arcsec)", (0.1, 30), "the tilt about y with cos φ")
    y_sin_1: Scalar = parameter("arcsec", "normal(0, 5 arcsec)", (0.1, 30), "the tilt about y with sin φ")
    x_cos_2: Scalar = parameter("arcsec", "normal(0, 5 arcsec)", (0.1, 30), "the tilt about x with cos 2φ")
    x_sin_2: Scalar = parameter("arcsec", "normal(0, 5 arcsec)", (0.1, 30), "the tilt about x with sin 2φ")
    y_cos_2: Scalar = parameter("arcsec", "normal(0, 5 arcsec)", (0.1, 30), "the tilt about y with cos 2φ")
    y_sin_2: Scalar = parameter("arcsec", "normal(0, 5 arcsec)", (0.1, 30), "the tilt about y with sin 2φ")

    def apply(self, motion: Motion, ambient: Ambient) -> Motion:
        one, two = motion.table_angle, 2 * motion.table_angle
        cos_1, sin_1, cos_2, sin_2 = jnp.cos(one), jnp.sin(one), jnp.cos(two), jnp.sin(two)
        x = self.x_cos_1 * cos_1 + self.x_sin_1 * sin_1 + self.x_cos_2 * cos_2 + self.x_sin_2 * sin_2
        y = self.y_cos_1 * cos_1 + self.y_sin_1 * sin_1 + self.y_cos_2 * cos_2 + self.y_sin_2 * sin_2
        return replace(motion, base=compose(motion.base, exponential(vector3(x, y, jnp.zeros_like(x)))))
