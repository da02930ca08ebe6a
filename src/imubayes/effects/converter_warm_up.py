"""Converter offset that settles after power-on."""

import jax.numpy as jnp

from imubayes.effects.base import Order, SignalEffect, Stage
from imubayes.parameters.parameter import parameter, time_constant
from imubayes.stimulus import Sample
from imubayes.types import Scalar


class ConverterWarmUp(SignalEffect):
    """Offset that fades with the time since power-on: signal + A·e^(−t_on/τ)."""

    name = "converter_warm_up"
    stage, order = Stage.CONVERTER, Order.OFFSET
    kinds = ("gyro", "accelerometer")
    needs = ("power_on",)
    confused_with = (
        "the sensor's own warm-up, without injected current; converter_offset_drift, where the converter warms itself"
    )
    reference = "turn-on transient of ADC, I/F and V/F converters"

    amplitude: Scalar = parameter("output", "normal(0, 1e-3 scale)", (1e-06, 0.1), "the excess of offset at power-on")
    tau: Scalar = time_constant("the time constant")

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        return signal + self.amplitude * jnp.exp(-sample.ambient.power_on / self.tau)
