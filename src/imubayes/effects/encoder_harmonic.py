"""Encoder harmonics: the table's angle is not what its encoder says."""

from dataclasses import replace

import jax.numpy as jnp

from imubayes.effects.base import MotionEffect, Order, Stage
from imubayes.parameters.parameter import parameter
from imubayes.stimulus import Ambient, Motion
from imubayes.types import Scalar


class EncoderHarmonic(MotionEffect):
    """True angle = φ + Σ_n (s_n sin nφ + c_n cos nφ), n = 1, 2: eccentricity and ellipticity of the graduation.

    The indicated rate comes from the same encoder and errs with the slope of this; over whole turns nothing is left.
    """

    name = "encoder_harmonic"
    stage, order = Stage.TABLE, Order.ANGLE
    per = ("table",)
    needs = ("table_angle",)
    confused_with = "misalignment and bias (n = 1), K2 and cross-coupling (n = 2) of accelerometers in one mounting"
    reference = "IEEE Std 1293, dividing head angle errors; 0.1 … 10 arcsec"

    sin_1: Scalar = parameter("arcsec", "normal(0, 5 arcsec)", (0.1, 60), "the sine of one period per turn")
    cos_1: Scalar = parameter("arcsec", "normal(0, 5 arcsec)", (0.1, 60), "the cosine of one period per turn")
    sin_2: Scalar = parameter("arcsec", "normal(0, 5 arcsec)", (0.1, 60), "the sine of two periods per turn")
    cos_2: Scalar = parameter("arcsec", "normal(0, 5 arcsec)", (0.1, 60), "the cosine of two periods per turn")

    def apply(self, motion: Motion, ambient: Ambient) -> Motion:
        one, two = motion.table_angle, 2 * motion.table_angle
        first = self.sin_1 * jnp.sin(one) + self.cos_1 * jnp.cos(one)
        second = self.sin_2 * jnp.sin(two) + self.cos_2 * jnp.cos(two)
        first_slope = self.sin_1 * jnp.cos(one) - self.cos_1 * jnp.sin(one)
        second_slope = 2 * (self.sin_2 * jnp.cos(two) - self.cos_2 * jnp.sin(two))
        return replace(
            motion,
            table_angle=motion.table_angle + first + second,
            table_rate=motion.table_rate * (1 + first_slope + second_slope),
        )
