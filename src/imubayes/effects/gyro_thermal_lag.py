"""Gyro bias that follows a temperature behind the thermometer's."""

import jax.numpy as jnp

from imubayes.effects.base import Decay, Order, RecordEffect, Stage
from imubayes.parameters.parameter import parameter
from imubayes.stimulus import Ambient, Sample
from imubayes.types import Scalar


class GyroThermalLag(RecordEffect):
    """Bias linear in the lag: signal + c·(T_τ − T) with dT_τ/dt = (T − T_τ)/τ, and T_τ = T where a run begins.

    A sensor whose bias follows the temperature inside alone has c equal to its coefficient in `gyro_bias_temperature`.
    Between two instants T is taken as straight, which makes the lag exact: the difference T − T_τ fades by e^(−Δt/τ)
    and gains ΔT·(1 − e^(−Δt/τ))·τ/Δt.
    """

    name = "gyro_thermal_lag"
    stage, order = Stage.SENSOR, Order.BIAS
    kinds = ("gyro",)
    needs = ("temperature", "temperature_rate")
    confused_with = (
        "gyro_bias_temperature_rate, where changes are slow against τ; gyro_bias_drift in a single monotonic ramp"
    )
    reference = "first-order lag, IEEE Std 952 thermal model; time constants of minutes"

    coefficient: Scalar = parameter("deg/h/degC", "normal(0, 20 deg/h/degC)", (0.001, 60), "the bias per degree of lag")
    tau: Scalar = parameter(
        "min",
        "lognormal(10 min, 1.0)",
        (0.5, 120),
        "the time constant of the lag",
        null=600.0,
        shape=(1.0, 3.0, 10.0, 30.0, 100.0),
    )

    def carry(self, before: Ambient, now: Ambient, seconds: Scalar) -> Decay:
        elapsed = seconds / self.tau
        # (1 − e^(−x))/x, by its series where x is small: a step of temperature in no time is a lag of that size.
        small = elapsed < 1e-4
        safe = jnp.where(small, 1.0, elapsed)
        gained = jnp.where(small, 1 - elapsed / 2, -jnp.expm1(-safe) / safe)
        return Decay(jnp.exp(-elapsed), gained * (now.temperature - before.temperature))

    def apply(self, signal: Scalar, sample: Sample, memory: Scalar) -> Scalar:
        return signal - self.coefficient * memory
