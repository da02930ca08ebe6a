"""From outputs to inputs: the signal path of a model, inverted along the input axis of every channel.

At rest, with the input along the channel's own axis alone, the output is a function of the input and of the
temperatures of sensor and converter.  It is inverted by Newton's method from the nominal scale; the path is linear to
parts in a thousand, so the error is squared at least three digits at a time.
"""

from collections.abc import Mapping

import jax
import jax.numpy as jnp

from imubayes.array_shapes import Array, Float, Scalar
from imubayes.model.sensitive_axes import SensitivityInputs, acting_on, outputs_at

_ITERATIONS = 6


def outputs_of(
    inputs: SensitivityInputs, values: Float[Array, " V"], acting: dict[str, Float[Array, " C"]],
    ambient: Mapping[str, Scalar],
) -> dict[str, Float[Array, " C"]]:  # fmt: skip
    """Return the outputs at inputs along the axes of the channels, kind → (C,), rad/s or m/s² → output units."""
    experience = {}
    for kind, known in inputs.channels.items():
        along = acting[kind][:, None] * known.axes[:, 0]
        zero = jnp.zeros_like(along)
        experience[kind] = acting_on(*((along, zero) if kind == "gyro" else (zero, along)))
    return outputs_at(inputs, values, experience, ambient)


def inputs_of(
    inputs: SensitivityInputs,
    values: Float[Array, " V"],
    outputs: dict[str, Float[Array, " C"]],
    ambient: Mapping[str, Scalar],
) -> dict[str, Float[Array, " C"]]:
    """Return the inputs along the axes of the channels that give these outputs, kind → (C,), rad/s or m/s²."""

    def improved(_, acting):
        ones = jax.tree.map(jnp.ones_like, acting)
        found, slope = jax.jvp(lambda each: outputs_of(inputs, values, each, ambient), (acting,), (ones,))
        return {kind: acting[kind] + (outputs[kind] - found[kind]) / slope[kind] for kind in acting}

    nominal = {kind: (outputs[kind] - known.offset) / known.scale for kind, known in inputs.channels.items()}
    return jax.lax.fori_loop(0, _ITERATIONS, improved, nominal)
