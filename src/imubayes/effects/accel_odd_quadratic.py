"""Accelerometer odd quadratic nonlinearity K_oq."""

import jax.numpy as jnp

from imubayes.effects.base import Order, SignalEffect, Stage
from imubayes.parameters.parameter import parameter
from imubayes.stimulus import Sample
from imubayes.types import Scalar


class AccelOddQuadratic(SignalEffect):
    """Output quadratic with the sign of the input: signal + K_oq a_i|a_i|."""

    name = "accel_odd_quadratic"
    stage, order = Stage.SENSOR, Order.SENSITIVITY
    kinds = ("accelerometer",)
    confused_with = "K1 and K3, in a 1 g field"
    reference = "IEEE Std 1293, K_oq"

    odd_quadratic: Scalar = parameter("ug/g^2", "normal(0, 50 ug/g^2)", (1, 50), "the odd quadratic coefficient K_oq")

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        return signal + self.odd_quadratic * sample.force[0] * jnp.abs(sample.force[0])
