"""Sensitive axes and thermal slopes from the signal path, and its inversion from outputs to rate and specific force.

The true sensitive axis of a channel is the gradient of its output with respect to the rate (or specific force) it is
exposed to, at rest and at the reference temperatures; its length is the scale factor, its angle to the table's axis in
a mounting the true mounting angle.  The relative slope against converter temperature is a derivative as well.  New
effects are included without further code.

Rate and specific force of the body follow from the outputs of all channels at once.  For one row the signal path y =
f(u) of the warmed-up unit is solved for u = (rate, specific force) by Gauss–Newton steps, weighted by the noise: u ← u
+ H (y − f(u)) with H = (JᵀWJ)⁻¹JᵀW, J = ∂f/∂u.  The path is linear to parts in a thousand, so each step gains three
digits.  The uncertainty of u has two sources: an error δθ of the parameters moves the solution by −H (∂f/∂θ) δθ; the
noise of the outputs moves it by H ε.

The path is also inverted along the input axis of every channel.  At rest, with the input along the channel's own axis
alone, the output is a function of the input and of the temperatures of sensor and converter.  It is inverted by
Newton's method from the nominal scale, which squares the error, at least three digits at a time.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import equinox as eqx
import jax
import jax.numpy as jnp

from imubayes.compiled.kept_programs import kept
from imubayes.foundations.arrays import Array, Bool, Float, Int, Scalar, Vectors
from imubayes.foundations.covariates import REFERENCE_TEMPERATURE, ambient_names
from imubayes.foundations.signal_path_state import Ambient, Experience, Nodes, SignalPath
from imubayes.model.signal_path import Channels, Layer, initial_path, propagate

WARMED_UP = 1e9  # s since power-on: longer than any warm-up


class SensitivityInputs(eqx.Module):
    """Nodes and layers at which the signal path is evaluated.

    Attributes
    ----------
    channels : constants of all channels, per kind.
    sensor_layers : from the projection on, at one node without run.
    mountings : one node per mounting (M of them).
    mounting_layers : effects on the motion at these nodes.
    thermal : one node per run with a converter temperature (T of them), None where there is none.
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


def outputs_at(
    inputs: SensitivityInputs, values: Float[Array, " V"], experience: dict[str, Experience],
    ambient: Mapping[str, Scalar],
) -> dict[str, Float[Array, " C"]]:  # fmt: skip
    """Return the outputs of a unit wherever it is mounted, kind → (C,), output units.

    Parameters
    ----------
    values : all values the layers refer to, SI.
    experience : kind → what acts on each channel, leaves (C, 3).
    ambient : covariates that are known; power-on was long ago where nothing else is said, all others are 0.
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


_ITERATIONS = 6


class RowSolution(eqx.Module):
    """The inputs of R rows, n of the six components of rate and specific force.

    Attributes
    ----------
    inputs : shape (R, n), rad/s and m/s².
    step : shape (R, n), the last correction: how far the iteration still moved.
    by_parameters : shape (R, n, K), standard deviations that the independent causes of the parameters' error give.
    gain : shape (R, n, C), H: inputs per output.
    """

    inputs: Float[Array, "R n"]
    step: Float[Array, "R n"]
    by_parameters: Float[Array, "R n K"]
    gain: Float[Array, "R n C"]


@kept
def solve_rows(
    inputs: SensitivityInputs,
    values: Float[Array, " V"],
    places: Int[Array, " A"],
    factor: Float[Array, "A K"],
    kinds: tuple[str, ...],
    outputs: Float[Array, "R C"],
    weights: Float[Array, "R C"],
    temperatures: Float[Array, "R 2"],
) -> RowSolution:
    """Return what the body experienced in every row.

    Parameters
    ----------
    values : all values the layers refer to, SI.
    places, factor : the uncertain ones among them, and a factor L of their covariance L Lᵀ.
    kinds : kinds of channels that are read; what the other kind would measure is taken as zero.
    outputs : of the channels of these kinds, one kind after the other, output units.
    weights : inverse variances of the outputs.
    temperatures : of sensor and converter, °C.
    """
    unknown = unknowns(kinds)

    def predicted(changed, acting, at):
        stimulus = jnp.zeros(6).at[unknown].set(acting)
        found = outputs_in_body(inputs, changed, stimulus, {"temperature": at[0], "converter_temperature": at[1]})
        return jnp.concatenate([found[kind] for kind in kinds])

    def of_row(read, weight, at):
        def gain_at(acting):
            slope = jax.jacfwd(lambda u: predicted(values, u, at))(acting)
            weighted = slope.T * weight[None, :]
            return jnp.linalg.solve(weighted @ slope, weighted)

        def improved(_, state):
            acting, _ = state
            step = gain_at(acting) @ (read - predicted(values, acting, at))
            return acting + step, step

        start = jnp.zeros(len(unknown))
        acting, step = jax.lax.fori_loop(0, _ITERATIONS, improved, (start, start))
        gain = gain_at(acting)
        moved = jax.jacfwd(lambda c: predicted(jnp.asarray(values).at[places].add(factor @ c), acting, at))(
            jnp.zeros(factor.shape[1])
        )
        return acting, step, -gain @ moved, gain

    return RowSolution(*jax.vmap(of_row)(outputs, weights, temperatures))


def unknowns(kinds: tuple[str, ...]) -> Int[Array, " n"]:
    """Return which components of (rate, specific force) the channels of some kinds determine, shape (n,)."""
    chosen: Bool[Array, " 6"] = jnp.array(["gyro" in kinds] * 3 + ["accelerometer" in kinds] * 3)
    return jnp.flatnonzero(chosen, size=3 * len(kinds))


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
