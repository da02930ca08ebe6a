"""From outputs to inputs: the signal path of a model, inverted along the input axis of every channel.

At rest, with the input along the channel's own axis alone, the output is a function of the input and of the
temperatures of sensor and converter.  It is inverted by Newton's method from the nominal scale; the path is linear to
parts in a thousand, so the error is squared at least three digits at a time.
"""

import equinox as eqx
import jax
import jax.numpy as jnp

from imubayes.array_shapes import Array, Float
from imubayes.covariates import ambient_names
from imubayes.model.sensitive_axes import WARMED_UP, SensitivityInputs
from imubayes.model.signal_path import propagate
from imubayes.signal_path_state import Ambient, Experience, SignalPath

_ITERATIONS = 6


class Conditions(eqx.Module):
    """Temperatures of sensor and converter at which outputs were read, °C."""

    temperature: Float[Array, ""]
    converter_temperature: Float[Array, ""]


def outputs_of(
    inputs: SensitivityInputs, values: Float[Array, " V"], acting: dict[str, Float[Array, " C"]], at: Conditions
) -> dict[str, Float[Array, " C"]]:
    """Return the outputs at inputs along the axes of the channels, kind → (C,), rad/s or m/s² → output units."""
    experience = {}
    for kind, known in inputs.channels.items():
        along = (acting[kind][:, None] * known.axes[:, 0])[None]
        zero = jnp.zeros_like(along)
        motion = (along, zero) if kind == "gyro" else (zero, along)
        experience[kind] = Experience(*motion, zero, zero, zero, zero)
    known = {
        "temperature": at.temperature[None],
        "converter_temperature": at.converter_temperature[None],
        "power_on": jnp.full(1, WARMED_UP),
    }
    ambient = Ambient(**{name: known.get(name, jnp.zeros(1)) for name in ambient_names()})
    path = SignalPath(inputs.mountings.stands, ambient, experience, {}, {})
    signal = propagate(inputs.sensor_layers, path, values).signal
    return {kind: signal[kind][0] for kind in inputs.channels}


def inputs_of(
    inputs: SensitivityInputs, values: Float[Array, " V"], outputs: dict[str, Float[Array, " C"]], at: Conditions
) -> dict[str, Float[Array, " C"]]:
    """Return the inputs along the axes of the channels that give these outputs, kind → (C,), rad/s or m/s²."""

    def improved(_, acting):
        ones = jax.tree.map(jnp.ones_like, acting)
        found, slope = jax.jvp(lambda each: outputs_of(inputs, values, each, at), (acting,), (ones,))
        return {kind: acting[kind] + (outputs[kind] - found[kind]) / slope[kind] for kind in acting}

    nominal = {kind: (outputs[kind] - known.offset) / known.scale for kind, known in inputs.channels.items()}
    return jax.lax.fori_loop(0, _ITERATIONS, improved, nominal)
