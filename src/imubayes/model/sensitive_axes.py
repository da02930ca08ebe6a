"""Sensitive axes and thermal slopes from the signal path, and the outputs of a unit at given rate and specific force.

The true sensitive axis of a channel is the gradient of its output with respect to the rate (or specific force) it is
exposed to, at rest and at the reference temperatures; its length is the scale factor, its angle to the table's axis in
a mounting the true mounting angle.  The relative slope against converter temperature is a derivative as well.  New
effects are included without further code.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import equinox as eqx
import jax
import jax.numpy as jnp

from imubayes.foundations.arrays import Array, Float, Matrix3, Scalar, Vector3, Vectors
from imubayes.foundations.covariates import REFERENCE_TEMPERATURE, ambient_names
from imubayes.foundations.signal_path_state import Ambient, Experience, Nodes, Sample, SignalPath
from imubayes.model.signal_path import Channels, Layer, initial_path, project, propagate

WARMED_UP = 1e9
"""Time since power-on that is longer than any warm-up, s."""


class SensitivityInputs(eqx.Module):
    """Nodes and layers at which the signal path is evaluated.

    Attributes
    ----------
    channels : constants of all channels, per kind.
    sensor_layers : from the projection on, at one node without run.
    mountings : one node per mounting (M of them).
    mounting_layers : effects on the motion at these nodes.
    thermal : one node per run with a converter temperature (T of them), None if there is none.
    thermal_layers : the whole path at these nodes.
    thermal_input : kind → shape (T, C), nominal input in SI.
    """

    channels: dict[str, Channels]
    sensor_layers: tuple[Layer, ...]
    mountings: Nodes
    mounting_layers: tuple[Layer, ...]
    thermal: Nodes | None
    thermal_layers: tuple[Layer, ...]
    thermal_input: dict[str, Float[Array, "T C"]]


@dataclass(frozen=True)
class DerivedQuantity:
    """Name, unit and the factor from the SI number to that unit."""

    name: str
    unit: str
    factor: float


def sensitivities(inputs: SensitivityInputs, values: Float[Array, " V"]) -> dict[str, Float[Array, "C 3"]]:
    """Return the gradient of every channel's output, kind → (C, 3), output units per rad/s or m/s² in body axes."""
    slopes = jax.jacfwd(lambda stimulus: _respond(inputs, values, stimulus))(jnp.zeros(6))
    own = {"gyro": slice(0, 3), "accelerometer": slice(3, 6)}
    return {kind: slopes[kind][:, own[kind]] for kind in inputs.channels}


def _respond(inputs: SensitivityInputs, values, stimulus: Float[Array, " 6"]) -> dict[str, Float[Array, " C"]]:
    """Return the outputs at a rate and a specific force at the reference temperatures, kind → (C,)."""
    warm = jnp.asarray(REFERENCE_TEMPERATURE)
    return outputs_in_body(inputs, values, stimulus, {"temperature": warm, "converter_temperature": warm})


def outputs_in_body(
    inputs: SensitivityInputs, values: Float[Array, " V"], stimulus: Float[Array, " 6"], ambient: Mapping[str, Scalar]
) -> dict[str, Float[Array, " C"]]:
    """Return the outputs at one rate and specific force of the whole unit, kind → (C,), output units.

    Parameters
    ----------
    values, ambient : as of `outputs_at`.
    stimulus : rate (rad/s), then specific force (m/s²), in body axes.
    """
    experience = {
        kind: acting_on(*(jnp.broadcast_to(each, (len(known.scale), 3)) for each in (stimulus[:3], stimulus[3:])))
        for kind, known in inputs.channels.items()
    }
    return outputs_at(inputs, values, experience, ambient)


def acting_on(rate: Vectors, force: Vectors) -> Experience:
    """Return what acts on channels of which rate and specific force are known and nothing else.

    The angular acceleration is not, and the unit turns about the point that its lever arms start from.
    """
    zero = jnp.zeros_like(rate)
    return Experience(rate, force, rate, zero, zero, zero)


def sample_at(axes: Matrix3, rate: Vector3, force: Vector3, ambient: Ambient) -> Sample:
    """Return what one channel feels along its axes, (3, 3), at a rate (rad/s) and a specific force (m/s²)."""
    return project(axes, acting_on(rate, force), ambient)


def outputs_at(
    inputs: SensitivityInputs, values: Float[Array, " V"], experience: dict[str, Experience],
    ambient: Mapping[str, Scalar],
) -> dict[str, Float[Array, " C"]]:  # fmt: skip
    """Return the outputs of a unit wherever it is mounted, kind → (C,), output units.

    Parameters
    ----------
    values : all values the layers refer to, SI.
    experience : kind → what acts on each channel, leaves (C, 3).
    ambient : covariates that are known; power-on was long ago if nothing else is said, all others are 0.
    """
    known = {"power_on": jnp.asarray(WARMED_UP)} | dict(ambient)
    at_node = Ambient(**{name: known.get(name, jnp.zeros(()))[None] for name in ambient_names()})
    path = SignalPath(
        inputs.mountings.stands, at_node, jax.tree.map(lambda leaf: leaf[None], experience), {}, {}
    )  # fmt: skip
    signal = propagate(inputs.sensor_layers, path, values).signal
    return {kind: signal[kind][0] for kind in inputs.channels}


def axes_of_rotation(inputs: SensitivityInputs, values: Float[Array, " V"]) -> Float[Array, "M 3"]:
    """Return the table's axis in body axes, for each mounting."""
    return propagate(inputs.mounting_layers, initial_path(inputs.mountings), values).motion.mounting[:, 2, :]


def thermal_slopes(inputs: SensitivityInputs, values: Float[Array, " V"]) -> dict[str, Float[Array, "T C"]]:
    """Return d(output)/d(converter temperature) over the nominal output of the input, kind → (T, C), per °C."""
    assert inputs.thermal is not None
    instants = inputs.thermal

    def output(temperature):
        warmed = replace(instants, ambient=instants.ambient.updated(converter_temperature=temperature))
        return propagate(inputs.thermal_layers, initial_path(warmed), values).signal

    at = instants.ambient.converter_temperature
    _, slope = jax.jvp(output, (at,), (jnp.ones_like(at),))
    return {
        kind: slope[kind] / (known.scale[None, :] * inputs.thermal_input[kind])
        for kind, known in inputs.channels.items()
    }


def unit_vectors(vectors: Float[Array, "... 3"]) -> Float[Array, "... 3"]:
    """Return vectors of length 1."""
    return vectors / jnp.sqrt(jnp.sum(vectors**2, axis=-1, keepdims=True))


def angle_between(a: Float[Array, "... 3"], b: Float[Array, "... 3"]) -> Float[Array, "..."]:
    """Return the angle between vectors, rad, accurate at 0° and 90° alike.

    At exactly 0° and 180° an angle has no derivative; 0 is returned for it, not NaN.
    """
    a, b = unit_vectors(a), unit_vectors(b)
    return 2 * jnp.arctan2(_length(a - b), _length(a + b))


def _length(vectors: Float[Array, "... 3"]) -> Float[Array, "..."]:
    square = jnp.sum(vectors**2, axis=-1)
    zero = square == 0
    return jnp.where(zero, 0.0, jnp.sqrt(jnp.where(zero, 1.0, square)))
