"""A table that the gyro drives: its angle as the solution of a differential equation.

The table turns so that the output of the driving gyro stays zero.  The rate that nulls the output at a given angle and
time is found on the signal path, with every effect of the model, and integrated to the angle of every row.  Effects
with memory are taken at rest.
"""

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax
import jax.numpy as jnp
import lazy_loader
import numpy as np

from imubayes.array_shapes import Array, Float
from imubayes.effects.base import RecordEffect, Stage
from imubayes.model.assembly import Assembly
from imubayes.model.nodes_and_entries import NodeTable, servo_runs
from imubayes.model.signal_path import (
    Broadcast,
    Channels,
    Layer,
    initial_path,
    propagate,
)
from imubayes.procedures.servo_table import driving_channel, turns_of
from imubayes.signal_path_state import Ambient, Motion, Nodes, SignalPath

if TYPE_CHECKING:
    import diffrax
else:
    diffrax = lazy_loader.load("diffrax")  # takes long to import, and few fits need it

# Fixed-point rounds; each shrinks the error of the null by the size of the calibration errors: 1 % to the fourth.
_ROUNDS = 4
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
    """Return the runs in which a gyro drives the table; None where there are none."""
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

        return servos.seconds * jax.lax.fori_loop(0, _ROUNDS, refine, jnp.zeros_like(angle))

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
