"""Converter leakage: an offset that doubles every few degrees."""

import jax.numpy as jnp

from imubayes.effects.base import Order, SignalEffect, Stage
from imubayes.parameters.parameter import option, parameter
from imubayes.stimulus import Sample
from imubayes.types import Scalar


class ConverterLeakage(SignalEffect):
    """Offset exponential in converter temperature: signal + L·(2^((T_c − T_ref)/D) − 1).

    A junction in silicon has D of about 10 °C; the leakage at T_ref itself is bias.
    """

    name = "converter_leakage"
    stage, order = Stage.CONVERTER, Order.OFFSET
    kinds = ("gyro", "accelerometer")
    needs = ("converter_temperature",)
    confused_with = "converter_offset_drift and its quadratic, over a narrow range of temperature"
    reference = "reverse current of a p–n junction, doubling every 10 °C"

    leakage: Scalar = parameter(
        "output", "normal(0, 1e-4 scale)", (1e-06, 0.01), "the leakage at the reference temperature"
    )
    doubling: Scalar = parameter(
        "degC",
        "lognormal(10 degC, 0.3)",
        (5, 20),
        "the rise of temperature that doubles the leakage",
        null=10.0,
        shape=(6.0, 8.0, 10.0, 14.0),
    )
    reference_degC: float = option(25.0, "reference temperature T_ref, °C")

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        warmer = (sample.ambient.converter_temperature - self.reference_degC) / self.doubling
        return signal + self.leakage * jnp.expm1(jnp.log(2.0) * warmer)
