"""Gyro scale factor that differs between the two directions of rotation."""

import jax.numpy as jnp

from imubayes.effects.base import Order, SignalEffect, Stage
from imubayes.parameters.parameter import parameter
from imubayes.stimulus import Sample
from imubayes.types import Scalar


class GyroScaleAsymmetry(SignalEffect):
    """Scale factor asymmetry: signal + S_a·|Ω|, half the difference of the scale factors of either direction."""

    name = "gyro_scale_asymmetry"
    stage, order = Stage.SENSOR, Order.SENSITIVITY
    kinds = ("gyro",)
    needs = ("turning",)
    confused_with = "gyro_scale_quadratic, where few rates are tested; a bias, at one rate"
    reference = "IEEE Std 952, asymmetry error; 10 … 300 ppm"

    asymmetry: Scalar = parameter(
        "ppm", "normal(0, 100 ppm)", (10, 300), "half the difference of the two scale factors"
    )

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        return signal + self.asymmetry * jnp.abs(sample.rate[0])
