"""Accelerometer scale factor that differs between the two directions."""

import jax.numpy as jnp

from imubayes.effects.base import Order, SignalEffect, Stage
from imubayes.parameters.parameter import parameter
from imubayes.stimulus import Sample
from imubayes.types import Scalar


class AccelScaleAsymmetry(SignalEffect):
    """Scale factor asymmetry: signal + S_a·|a_i|, half the difference of the scale factors of either sign."""

    name = "accel_scale_asymmetry"
    stage, order = Stage.SENSOR, Order.SENSITIVITY
    kinds = ("accelerometer",)
    confused_with = "bias and K2, in a 1 g field of few positions"
    reference = "IEEE Std 1293, scale factor asymmetry K1'"

    asymmetry: Scalar = parameter("ppm", "normal(0, 100 ppm)", (1, 300), "half the difference of the two scale factors")

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        return signal + self.asymmetry * jnp.abs(sample.force[0])
