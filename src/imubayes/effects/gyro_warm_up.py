"""Gyro bias that settles after power-on."""

import jax.numpy as jnp

from imubayes.effects.base import Order, SignalEffect, Stage
from imubayes.parameters.parameter import parameter
from imubayes.stimulus import Sample
from imubayes.types import Scalar


class GyroWarmUp(SignalEffect):
    """Bias that fades with the time since power-on: signal + A·e^(−t_on/τ)."""

    name = "gyro_warm_up"
    stage, order = Stage.SENSOR, Order.BIAS
    kinds = ("gyro",)
    needs = ("power_on",)
    confused_with = "gyro_bias_temperature, where the unit warms itself; run offsets, where no run is long against τ"
    reference = "IEEE Std 952, turn-on transient and warm-up"

    amplitude: Scalar = parameter("deg/h", "normal(0, 20 deg/h)", (0.01, 100), "the excess of bias at power-on")
    tau: Scalar = parameter(
        "min",
        "lognormal(10 min, 1.0)",
        (0.5, 120),
        "the time constant",
        null=600.0,
        shape=(1.0, 3.0, 10.0, 30.0, 100.0),
    )

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        return signal + self.amplitude * jnp.exp(-sample.ambient.power_on / self.tau)
