"""Converter saturation: inputs beyond a limit are read too small."""

import jax.numpy as jnp

from imubayes.effects.base import Order, SignalEffect, Stage
from imubayes.parameters.parameter import parameter
from imubayes.stimulus import Sample
from imubayes.types import Scalar


class ConverterSaturation(SignalEffect):
    """What exceeds a limit is reduced: signal − k·sign(signal)·max(|signal| − limit, 0); k = 1 is a hard stop.

    The limit is in `scale`, the nominal output for 1 deg/s or 1 g.
    """

    name = "converter_saturation"
    stage, order = Stage.CONVERTER, Order.LIMIT
    kinds = ("gyro", "accelerometer")
    confused_with = "cubic nonlinearity of sensor or converter"
    reference = "full-scale range of ADC, I/F and V/F converters; IEEE Std 1241, clipping"

    compression: Scalar = parameter("%", "normal(0, 10 %)", (0.01, 100), "the share lost of what exceeds the limit")
    limit: Scalar = parameter(
        "scale",
        "lognormal(30 scale, 1.5)",
        (1, 1000),
        "the output from which on it is lost",
        null=1.0,
        shape=(1.0, 3.0, 10.0, 30.0, 100.0, 300.0),
    )

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        excess = jnp.maximum(jnp.abs(signal) - self.limit, 0.0)
        return signal - self.compression * jnp.sign(signal) * excess
