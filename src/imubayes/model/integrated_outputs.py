"""Outputs that follow from integration: attitude closure of a free tumble, and the angle of a gyro-driven table.

In a free tumble the integrated gyro rates must carry the attitude of each pose into the next.  Between poses the unit
is turned by hand and its motion is known from its own sensors alone.  The signal path is therefore inverted: outputs
become angular rate and specific force by fixed-point iteration (a few rounds, since every channel is nominal to some
percent), the rates are integrated, and the closure error of the rotation is the observation.  The Earth's rotation is
removed exactly, in the local level: C_nb(stop) = exp(−ω_E Δt) · C_nb(start) · Π exp(ω_k Δt_k + coning_k).

A table that the gyro drives turns so that the output of the driving gyro stays zero; its angle solves a differential
equation.  The rate that nulls the output at a given angle and time is found on the signal path, with every effect of
the model, and integrated to the angle of every row.  Effects with memory are taken at rest.
"""

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from imubayes.effects.base import RecordEffect, Stage
from imubayes.foundations.arrays import Array, Float, compose, exponential, right_jacobian, small_rotation, take
from imubayes.foundations.campaign_data import Campaign, Tumble
from imubayes.foundations.deferred_modules import DeferredModule
from imubayes.foundations.signal_path_state import Ambient, Experience, Motion, Nodes, Records, SignalPath
from imubayes.model.assembly import Assembly
from imubayes.model.nodes_and_entries import NodeTable, servo_runs
from imubayes.model.signal_path import Broadcast, Channels, Layer, initial_path, propagate
from imubayes.procedures.carried import nominal_rates
from imubayes.procedures.servo_table import driving_channel, turns_of

if TYPE_CHECKING:
    import diffrax
else:
    diffrax = DeferredModule("diffrax")  # takes long to import, and few fits need it


# Each round shrinks the error of the inverse by the size of the calibration errors: 3 % to the sixth is 1e-9.
# The derivative is that of the exact inverse: after fewer rounds the two would not agree.
_ROUNDS = 6
# Steps of a transition for which the slope of the rate is known to the second order at its ends as well.
_LEAST_STEPS = 3


class Transitions(eqx.Module):
    """All transitions of a campaign (T of them, of K steps each).

    Attributes
    ----------
    start, stop : shape (T,), nodes of the poses that a transition joins.
    step : shape (T, K), s.
    readings : kind → shape (T·K, C), output units.
    coning : shape (T, K, 3), rad.
    acceleration : shape (T·K, 3), rad/s², body axes; the slope of the nominal rates, for gyros that lag.
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
    acceleration: Float[Array, "TK 3"]
    ambient: Ambient
    records: Records
    inverse: dict[str, Float[Array, "3 C"]]
    layers: tuple[Layer, ...]


def nominal_inverse(axes: Array) -> np.ndarray:
    """Return the least-squares inverse (3, C) of the input axes, from axes (C, 3, 3)."""
    return np.linalg.pinv(np.asarray(axes)[:, 0, :])


def bind_transitions(assembly: Assembly) -> Transitions | None:
    """Return the transitions of all free tumbles, padded to the longest; None if there are none."""
    campaign, nodes = assembly.grouping.campaign, assembly.grouping.nodes
    tumbles = _with_turns(campaign)
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
        acceleration=_padded([_slopes(tumble, campaign) for _, tumble in tumbles], steps).reshape(-1, 3),
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


def _with_turns(campaign: Campaign) -> list[tuple[int, Tumble]]:
    """Return the tumbles that have turns between their poses, with the number of their run."""
    tumbles = [(index, run.tumble) for index, run in enumerate(campaign.runs) if run.tumble is not None]
    return [(index, tumble) for index, tumble in tumbles if tumble.turns]


def _padded(arrays: list[np.ndarray], steps: int) -> np.ndarray:
    """Return arrays (T_i, K_i, …) joined along the first axis, the second padded with zeros to `steps`."""
    widths = [[(0, 0), (0, steps - array.shape[1]), *[(0, 0)] * (array.ndim - 2)] for array in arrays]
    return np.concatenate([np.pad(array, width) for array, width in zip(arrays, widths, strict=True)])


def _slopes(tumble: Tumble, campaign: Campaign) -> np.ndarray:
    """Return the angular acceleration in every step by the nominal gyros, (T, K, 3), rad/s², body axes.

    An effect of the acceleration is small, so that errors of the nominal scale do not matter; biases have no slope.
    """
    rate, found = nominal_rates(tumble, campaign), np.zeros((*tumble.step.shape, 3))
    for place, length in enumerate(tumble.step):
        count = int(np.sum(length > 0))
        if count >= _LEAST_STEPS:
            middle = (np.cumsum(length) - length / 2)[:count]
            found[place, :count] = np.gradient(rate[place, :count], middle, axis=0, edge_order=2)
    return found


def _readings_by_kind(assembly: Assembly, step: np.ndarray, readings: np.ndarray) -> dict[str, Array]:
    by_kind: dict[str, Array] = {}
    for kind, channels in assembly.channels.items():
        columns = [i for i, channel in enumerate(assembly.grouping.campaign.channels) if channel.kind == kind]
        # Padded steps have no length and get the nominal offset: no rotation, and no force to invert.
        padded = np.where(step[..., None] == 0, channels.offset, readings[..., columns])
        by_kind[kind] = padded.reshape(-1, len(columns))
    return by_kind


def inverted_rates(
    transitions: Transitions, channels: dict[str, Channels], values: Float[Array, " V"]
) -> Float[Array, "TK 3"]:
    """Return the mean inertial rate of every step that reproduces the recorded outputs, rad/s, body axes.

    Parameters
    ----------
    transitions : the recorded motion between poses.
    channels : constants of the channels, per kind.
    values : all parameters in SI, then the null values.
    """
    place = 3 * list(transitions.readings).index("gyro")
    return _inverted(values, transitions=transitions, channels=channels)[:, place : place + 3]


def turned_since_start(transitions: Transitions, rate: Float[Array, "TK 3"]) -> Float[Array, "T Kp 3 3"]:
    """Return the products of the first 0, 1, … K rotations of every transition.

    Parameters
    ----------
    transitions : the recorded motion between poses.
    rate : mean inertial rate of every step, rad/s, body axes.
    """
    return _turned(rate.reshape(*transitions.step.shape, 3) * transitions.step[..., None] + transitions.coning)


@jax.custom_jvp
def _turned(vectors: Float[Array, "T K 3"]) -> Float[Array, "T Kp 3 3"]:
    """Return the products of the first 0, 1, … K rotations by vectors."""
    first = jnp.broadcast_to(jnp.eye(3), (len(vectors), 3, 3))
    steps = jnp.swapaxes(jax.vmap(jax.vmap(exponential))(vectors), 0, 1)
    total, before = jax.lax.scan(lambda so_far, step: (so_far @ step, so_far), first, steps)
    return jnp.concatenate([jnp.swapaxes(before, 0, 1), total[:, None]], axis=1)


@_turned.defjvp
def _turned_slope(primals, tangents):
    """Return the products and their derivatives, from sums of vectors in place of products of matrices.

    With C_k the product of the first k rotations, exp(φ + dφ) = exp(φ) exp(J dφ), J the right Jacobian, gives
    dC_k = [Σ_j C_(j+1) J_j dφ_j]× C_k, j < k (Solà, Deray and Atchuthan, arXiv 1812.01537, eq. 143).
    """
    (vectors,), (moved,) = primals, tangents
    turned = _turned(vectors)
    by_step = turned[:, 1:] @ jax.vmap(jax.vmap(right_jacobian))(vectors)
    each = jnp.einsum("tkij,tkj->kti", by_step, moved)

    def onward(so_far: Array, step: Array) -> tuple[Array, Array]:
        return so_far + step, so_far + step

    sums = jax.lax.scan(onward, jnp.zeros_like(each[0]), each)[1]
    along = jnp.concatenate([jnp.zeros_like(each[:1]), sums]).swapaxes(0, 1)
    return turned, jnp.cross(along[..., None, :], turned.swapaxes(-1, -2)).swapaxes(-1, -2)


def closing_rotations(
    transitions: Transitions, motion: Motion, turned: Float[Array, "T Kp 3 3"]
) -> Float[Array, "T 3"]:
    """Return the closure error of each transition as a rotation vector, rad, body axes.

    Parameters
    ----------
    transitions : the recorded motion between poses.
    motion : all nodes after all kinematic effects; its mounting is the attitude of each pose.
    turned : products of the rotations of each transition, as of `turned_since_start`.
    """
    attitude = jax.vmap(compose)(motion.base, motion.mounting)
    elapsed = transitions.step.sum(axis=1)
    earth = jax.vmap(exponential)(-take(motion.earth_rate, transitions.start) * elapsed[:, None])
    reached = jax.vmap(compose)(jax.vmap(compose)(earth, take(attitude, transitions.start)), turned[:, -1])
    expected = take(attitude, transitions.stop)
    return jax.vmap(lambda a, b: small_rotation(compose(a.T, b)))(expected, reached)


@eqx.filter_custom_jvp
def _inverted(values: Float[Array, " V"], *, transitions: Transitions, channels: dict[str, Channels]) -> Array:
    """Return rate and force in body axes, (T·K, 3·kinds) in the order of the readings, that reproduce the outputs."""
    zero = jnp.zeros((transitions.step.size, 3 * len(transitions.readings)))
    return jax.lax.fori_loop(
        0, _ROUNDS, lambda _, found: found + _correction(transitions, channels, found, values), zero
    )


@_inverted.def_jvp
def _inverted_slope(primals, tangents, *, transitions: Transitions, channels: dict[str, Channels]):
    """Return the inverse and its derivative by the implicit function theorem.

    With c(x, v) the correction of inputs x, which vanishes at the inverse, dx = (−∂c/∂x)⁻¹ ∂c/∂v dv: one derivative of
    the readout in place of one for each round.  −∂c/∂x is the identity but for the errors of the unit, a matrix for
    each step, and its inverse a series with as many terms as the inverse has rounds.
    """
    (values,), (direction,) = primals, tangents
    found = _inverted(values, transitions=transitions, channels=channels)
    if direction is None:
        return found, None
    still = jax.lax.stop_gradient(found)

    def left(unit: Array) -> Array:
        """Return (1 + ∂c/∂x) of a unit vector, the same in all steps."""
        along = jnp.broadcast_to(unit, still.shape)
        return along + jax.jvp(lambda x: _correction(transitions, channels, x, values), (still,), (along,))[1]

    error = jax.vmap(left, out_axes=2)(jnp.eye(still.shape[1]))
    moved = jax.jvp(lambda v: _correction(transitions, channels, still, v), (values,), (direction,))[1]
    slope = moved
    for _ in range(_ROUNDS):
        slope = moved + jnp.einsum("nij,nj->ni", error, slope)
    return found, slope


def _correction(transitions: Transitions, channels: dict[str, Channels], found: Array, values) -> Array:
    """Return what the outputs recorded beyond those of rates and forces `found`, inverted by the nominal axes."""
    kinds = list(transitions.readings)
    parts = dict(zip(kinds, jnp.split(found, len(kinds), axis=1), strict=True))
    predicted = _readout(transitions, channels, parts, values)
    misfit = {kind: (transitions.readings[kind] - predicted[kind]) / channels[kind].scale[None, :] for kind in kinds}
    return jnp.concatenate([misfit[kind] @ transitions.inverse[kind].T for kind in kinds], axis=1)


def _readout(transitions: Transitions, channels: dict[str, Channels], found: dict[str, Array], values):
    """Return the predicted channel outputs, kind → (T·K, C)."""
    zero = jnp.zeros_like(next(iter(found.values())))
    rate, force = found.get("gyro", zero), found.get("accelerometer", zero)
    body = Experience(rate, force, zero, transitions.acceleration, zero, zero)
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


# Fixed-point rounds; each shrinks the error of the null by the size of the calibration errors: 1 % to the fourth.
_NULL_ROUNDS = 4
STEPS_PER_TURN = 96


class Servos(eqx.Module):
    """All servo-table runs of a campaign (S of them, of K rows each, padded with the last).

    Attributes
    ----------
    stand : shape (S,), the stand of each.
    driver : shape (S, C), 1 for the gyro that drives the table, 0 for the others.
    gain : shape (S,), nominal output of that gyro per rad/s of the table.
    first : shape (S,), first reading of the table's angle, rad.
    seconds : shape (S,), from the first to the last row.
    place : shape (S, K), time of each row as a share of that.
    ambient : covariates of every row, (S, K).
    steps : number of steps of the integration; static.
    layers : the signal path from the table on, with places of values for S nodes.
    """

    stand: Array
    driver: Float[Array, "S C"]
    gain: Float[Array, " S"]
    first: Float[Array, " S"]
    seconds: Float[Array, " S"]
    place: Float[Array, "S K"]
    ambient: Ambient
    steps: int = eqx.field(static=True)
    layers: tuple[Layer, ...]


def bind_servos(assembly: Assembly) -> Servos | None:
    """Return the runs in which a gyro drives the table; None if there are none."""
    campaign, nodes = assembly.grouping.campaign, assembly.grouping.nodes
    indices = servo_runs(campaign)
    if not indices:
        return None
    runs = [campaign.runs[index] for index in indices]
    node = _nodes_in_row_order(nodes, indices)
    time, first = nodes.stimulus.ambient["time"][node], node[:, 0]
    seconds = time[:, -1] - time[:, 0]
    gyros = campaign.of_kind("gyro")
    driver = np.array([driving_channel(campaign, run) for run in runs])
    axes = np.stack([gyros[index].axes[0] * gyros[index].scale_si for index in driver])
    return Servos(
        stand=nodes.stand[first],
        driver=np.eye(len(gyros))[driver],
        gain=np.sum(axes * nodes.stimulus.mounting[first, 2], axis=1),
        first=nodes.stimulus.table_angle[first],
        seconds=seconds,
        place=(time - time[:, :1]) / seconds[:, None],
        ambient=Ambient(**{name: values[node] for name, values in nodes.stimulus.ambient.items()}),
        # A power of two, so that records of about the same length share one compiled program.
        steps=2 ** math.ceil(math.log2(STEPS_PER_TURN * max(1.0, *map(turns_of, runs)))),
        layers=assembly.path(
            first,
            (Stage.TABLE, Stage.PLACE, Stage.SENSOR, Stage.CONVERTER),
            keep=lambda _, effect_class: not issubclass(effect_class, RecordEffect),
        ),
    )


def _nodes_in_row_order(nodes: NodeTable, indices: list[int]) -> np.ndarray:
    """Return the nodes of some runs, each with one node per row, in the order of the rows; shape (S, K).

    Shorter runs are padded with their last node.
    """
    own = [np.flatnonzero(nodes.run == index) for index in indices]
    own = [node[np.argsort(nodes.stimulus.row[node], kind="stable")] for node in own]
    longest = max(map(len, own))
    return np.stack([np.pad(node, (0, longest - len(node)), mode="edge") for node in own])


def servo_angles(
    servos: Servos,
    layers: tuple[Layer, ...],
    instants: Nodes,
    channels: dict[str, Channels],
    values: Float[Array, " V"],
) -> Float[Array, "S K"]:
    """Return the table's angle at every row of every run, rad.

    Parameters
    ----------
    layers : the whole signal path; those up to the stand are passed here.
    instants : all nodes.
    channels : constants of the channels, per kind.
    values : all parameters in SI, then the null values.
    """
    before = [layer for layer in layers if layer.sort_key()[0] == Stage.STAND and not isinstance(layer, Broadcast)]
    stands = jax.tree.map(lambda leaf: leaf[servos.stand], propagate(before, initial_path(instants), values).motion)

    def turning(share: Any, angle: Float[Array, " S"], _: None) -> Float[Array, " S"]:
        ambient = jax.tree.map(
            lambda rows: jax.vmap(lambda x, y: jnp.interp(share, x, y))(servos.place, rows), servos.ambient
        )
        ambient = ambient.updated(table_angle=angle)

        def refine(_: Array, rate: Float[Array, " S"]) -> Float[Array, " S"]:
            moving = replace(stands, table_angle=angle, table_rate=rate)
            return rate - _output(servos, channels, moving, ambient, values) / servos.gain

        return servos.seconds * jax.lax.fori_loop(0, _NULL_ROUNDS, refine, jnp.zeros_like(angle))

    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(turning),
        diffrax.Tsit5(),
        0.0,
        1.0,
        None,
        servos.first + stands.table_angle,
        stepsize_controller=diffrax.StepTo(ts=jnp.linspace(0.0, 1.0, servos.steps + 1)),
        saveat=diffrax.SaveAt(dense=True),
        adjoint=diffrax.ForwardMode(),
        max_steps=servos.steps,
    )
    everywhere = jax.vmap(jax.vmap(solution.evaluate))(servos.place)
    return jnp.diagonal(everywhere, axis1=0, axis2=2).T


def _output(
    servos: Servos, channels: dict[str, Channels], motion: Motion, ambient: Ambient, values
) -> Float[Array, " S"]:
    """Return the output of the driving gyro less its nominal offset, output units."""
    path = propagate(servos.layers, SignalPath(motion, ambient, {}, {}, {}), values)
    return jnp.sum(servos.driver * (path.signal["gyro"] - channels["gyro"].offset[None, :]), axis=1)
