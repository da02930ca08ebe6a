"""Attitude closure of a free tumble: the integrated gyro rates must carry the attitude of each pose into the next.

Between poses the unit is turned by hand and its motion is known from its own sensors alone.  The signal path is
therefore inverted: outputs become angular rate and specific force by fixed-point iteration (a few rounds, since every
channel is nominal to some percent), the rates are integrated, and the closure error of the rotation is the observation.
The Earth's rotation is removed exactly, in the local level: C_nb(stop) = exp(−ω_E Δt) · C_nb(start) · Π exp(ω_k Δt_k +
coning_k).
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from imubayes.array_shapes import Array, Float
from imubayes.effects.base import Stage
from imubayes.gather import take
from imubayes.model.assembly import Assembly
from imubayes.model.signal_path import Channels, Layer, propagate
from imubayes.rotations import compose, exponential, small_rotation
from imubayes.signal_path_state import Ambient, Experience, Motion, Records, SignalPath

# Each round shrinks the error of the inverse by the size of the calibration errors: 3 % to the fourth is 1 ppm.
_ROUNDS = 4


class Transitions(eqx.Module):
    """All transitions of a campaign (T of them, of K steps each).

    Attributes
    ----------
    start, stop : shape (T,), nodes of the poses that a transition joins.
    step : shape (T, K), s.
    readings : kind → shape (T·K, C), output units.
    coning : shape (T, K, 3), rad.
    ambient : covariates of every step, T·K of them: those of the preceding pose.
    records : the static nodes in the order of time, for effects with memory.
    inverse : kind → shape (3, C); least-squares inverse of the nominal axes.
    layers : effects on the circumstances, then the signal path from the projection on, with places of values for T·K
        instants.
    """

    start: Array
    stop: Array
    step: Float[Array, "T K"]
    readings: dict[str, Float[Array, "TK C"]]
    coning: Float[Array, "T K 3"]
    ambient: Ambient
    records: Records
    inverse: dict[str, Float[Array, "3 C"]]
    layers: tuple[Layer, ...]


def nominal_inverse(axes: Array) -> np.ndarray:
    """Return the least-squares inverse (3, C) of the input axes, from axes (C, 3, 3)."""
    return np.linalg.pinv(np.asarray(axes)[:, 0, :])


def bind_transitions(assembly: Assembly) -> Transitions | None:
    """Return the transitions of all free tumbles, padded to the longest; None where there are none."""
    campaign, nodes = assembly.grouping.campaign, assembly.grouping.nodes
    tumbles = [(index, run.tumble) for index, run in enumerate(campaign.runs) if run.tumble is not None]
    if not tumbles:
        return None
    steps = max(tumble.step.shape[1] for _, tumble in tumbles)
    node_of = {(run, pose): node for node, (run, pose) in enumerate(zip(nodes.run, nodes.pose, strict=True))}
    start = np.concatenate([[node_of[run, pose] for pose in tumble.start] for run, tumble in tumbles])
    stop = np.concatenate([[node_of[run, pose] for pose in tumble.stop] for run, tumble in tumbles])
    node = np.repeat(start, steps)
    step = _padded([tumble.step for _, tumble in tumbles], steps)
    readings = _padded([tumble.readings for _, tumble in tumbles], steps)
    return Transitions(
        start=start,
        stop=stop,
        step=step,
        readings=_readings_by_kind(assembly, step, readings),
        coning=_padded([tumble.coning for _, tumble in tumbles], steps),
        ambient=Ambient(**{name: values[node] for name, values in nodes.stimulus.ambient.items()}),
        records=assembly.nodes.records.at(node),
        inverse={kind: nominal_inverse(channels.axes) for kind, channels in assembly.channels.items()},
        layers=(
            *assembly.ambient_path(node),
            *assembly.path(
                node,
                (Stage.PLACE, Stage.SENSOR, Stage.CONVERTER),
                keep=lambda _, effect_class: effect_class.stage >= Stage.SENSOR,
            ),
        ),
    )


def _padded(arrays: list[np.ndarray], steps: int) -> np.ndarray:
    """Return arrays (T_i, K_i, …) joined along the first axis, the second padded with zeros to `steps`."""
    widths = [[(0, 0), (0, steps - array.shape[1]), *[(0, 0)] * (array.ndim - 2)] for array in arrays]
    return np.concatenate([np.pad(array, width) for array, width in zip(arrays, widths, strict=True)])


def _readings_by_kind(assembly: Assembly, step: np.ndarray, readings: np.ndarray) -> dict[str, Array]:
    by_kind: dict[str, Array] = {}
    for kind, channels in assembly.channels.items():
        columns = [i for i, channel in enumerate(assembly.grouping.campaign.channels) if channel.kind == kind]
        # Padded steps have no length and get the nominal offset: no rotation, and no force to invert.
        padded = np.where(step[..., None] == 0, channels.offset, readings[..., columns])
        by_kind[kind] = padded.reshape(-1, len(columns))
    return by_kind


def closing_rotations(
    transitions: Transitions, channels: dict[str, Channels], motion: Motion, values: Float[Array, " V"]
) -> Float[Array, "T 3"]:
    """Return the closure error of each transition as a rotation vector, rad, body axes.

    Parameters
    ----------
    transitions : the recorded motion between poses.
    channels : constants of the channels, per kind.
    motion : the static nodes after all kinematic effects; its mounting is the attitude of each pose.
    values : all parameters in SI, then the null values.
    """
    turned = jax.vmap(compose)(motion.base, motion.mounting)
    rate = _inverted(transitions, channels, values)["gyro"]
    count, steps = transitions.step.shape
    rotation = rate.reshape(count, steps, 3) * transitions.step[..., None] + transitions.coning
    carried = _product(jax.vmap(jax.vmap(exponential))(rotation))
    elapsed = transitions.step.sum(axis=1)
    earth = jax.vmap(exponential)(-take(motion.earth_rate, transitions.start) * elapsed[:, None])
    reached = jax.vmap(compose)(jax.vmap(compose)(earth, take(turned, transitions.start)), carried)
    expected = take(turned, transitions.stop)
    return jax.vmap(lambda a, b: small_rotation(compose(a.T, b)))(expected, reached)


def _inverted(transitions: Transitions, channels: dict[str, Channels], values) -> dict[str, Array]:
    """Return rate and force in body axes, kind → (T·K, 3), that reproduce the recorded outputs."""

    def refine(_: Array, found: dict[str, Array]) -> dict[str, Array]:
        predicted = _readout(transitions, channels, found, values)
        misfit = {
            kind: (read - predicted[kind]) / channels[kind].scale[None, :]
            for kind, read in transitions.readings.items()
        }
        return {kind: found[kind] + misfit[kind] @ transitions.inverse[kind].T for kind in found}

    zero: dict[str, Array] = {kind: jnp.zeros((len(read), 3)) for kind, read in transitions.readings.items()}
    return jax.lax.fori_loop(0, _ROUNDS, refine, zero)


def _readout(transitions: Transitions, channels: dict[str, Channels], found: dict[str, Array], values):
    """Return the predicted channel outputs, kind → (T·K, C)."""
    zero = jnp.zeros_like(next(iter(found.values())))
    body = Experience(found.get("gyro", zero), found.get("accelerometer", zero), zero, zero, zero, zero)
    experience = {
        kind: jax.tree.map(lambda leaf, of=known: jnp.broadcast_to(leaf[:, None], (len(leaf), len(of.scale), 3)), body)
        for kind, known in channels.items()
    }
    path = SignalPath(_no_motion(len(zero)), transitions.ambient, experience, {}, {}, records=transitions.records)
    return propagate(transitions.layers, path, values).signal


def _no_motion(count: int) -> Motion:
    zero, still = jnp.zeros(count), jnp.zeros((count, 3))
    eye = jnp.broadcast_to(jnp.eye(3), (count, 3, 3))
    return Motion(eye, eye, zero, zero, zero, still, still, still, still)


def _product(rotations: Float[Array, "T K 3 3"]) -> Float[Array, "T 3 3"]:
    """Return the ordered product over K, pairwise."""
    while rotations.shape[1] > 1:
        if rotations.shape[1] % 2:
            last = jnp.broadcast_to(jnp.eye(3), (len(rotations), 1, 3, 3))
            rotations = jnp.concatenate([rotations, last], axis=1)
        rotations = jax.vmap(jax.vmap(compose))(rotations[:, ::2], rotations[:, 1::2])
    return rotations[:, 0]
