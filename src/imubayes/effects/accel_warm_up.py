"""Accelerometer bias that settles after power-on."""

import jax.numpy as jnp

from imubayes.effects.base import Order, SignalEffect, Stage
from imubayes.parameters.parameter import parameter, time_constant
from imubayes.stimulus import Sample
from imubayes.types import Scalar


class AccelWarmUp(SignalEffect):
    """Bias that fades with the time since power-on: signal + A·e^(−t_on/τ)."""

    name = "accel_warm_up"
    stage, order = Stage.SENSOR, Order.BIAS
    kinds = ("accelerometer",)
    needs = ("power_on",)
    confused_with = "accel_bias_temperature, where the unit warms itself; run offsets, where no run is long against τ"
    reference = "IEEE Std 1293, turn-on transient and warm-up"

    amplitude: Scalar = parameter("ug", "normal(0, 500 ug)", (5, 2000), "the excess of bias at power-on")
    tau: Scalar = time_constant("the time constant")

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        return signal + self.amplitude * jnp.exp(-sample.ambient.power_on / self.tau)
