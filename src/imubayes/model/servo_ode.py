"""A table that the gyro drives: its angle as the solution of a differential equation.

The table turns so that the output of the driving gyro stays nothing.  At an angle and an instant the rate at which it
does is found on the signal path itself, with every effect of the model; integrated, it gives the angle of every row.
Effects with a memory are taken as at rest.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from imubayes.effects.base import Effect, RecordEffect, Stage
from imubayes.model.assembly import Assembly
from imubayes.model.bound_effects import BoundEffect
from imubayes.model.nodes import servo_runs
from imubayes.model.signal_path import (
    AddOffset,
    Broadcast,
    Channels,
    Convert,
    Layer,
    Project,
    Resolve,
    initial_path,
    propagate,
    sorted_layers,
)
from imubayes.procedures.servo_table import driving_channel, turns_of
from imubayes.stimulus import Ambient, Motion, Nodes, SignalPath
from imubayes.types import Array, Float

# The balance is found by rounds that each shrink its error by the size of the calibration errors: 1 % to the fourth.
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
    ambient : circumstances of every row, (S, K).
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


def bind_servos(assembly: Assembly, acting: Sequence[BoundEffect]) -> Servos | None:
    """Return the runs in which a gyro drives the table; None where there are none."""
    campaign, nodes = assembly.grouping.campaign, assembly.grouping.nodes
    driven = servo_runs(campaign)
    if not driven:
        return None
    runs = [campaign.runs[index] for index in driven]
    longest = max(run.rows for run in runs)
    own = [np.flatnonzero(nodes.run == index) for index in driven]
    # Nodes come sorted by the number of nodes of their row; those of one run are put back into the order of its rows.
    own = [place[np.argsort(nodes.stimulus.row[place], kind="stable")] for place in own]
    padded = np.stack([np.concatenate([place, np.repeat(place[-1:], longest - len(place))]) for place in own])
    time = nodes.stimulus.ambient["time"][padded]
    seconds = time[:, -1] - time[:, 0]
    first = np.array([place[0] for place in own])
    gyros = [channel for channel in campaign.channels if channel.kind == "gyro"]
    driver = np.array([driving_channel(campaign, run) for run in runs])
    axes = np.stack([gyros[place].axes[0] * gyros[place].scale_si for place in driver])
    layers: list[Layer] = [
        Resolve(tuple((kind, len(one.scale)) for kind, one in assembly.channels.items())),
        Project(assembly.channels),
        Convert(assembly.channels, np.zeros(len(driven))),
        AddOffset(assembly.channels),
        *(
            layer
            for one in acting
            if issubclass(one.effect_class, Effect) and one.effect_class.stage >= Stage.TABLE
            if not issubclass(one.effect_class, RecordEffect)
            for layer in assembly.effect_layers(one, first)
        ),
    ]
    return Servos(
        stand=nodes.stand[first],
        driver=np.eye(len(gyros))[driver],
        gain=np.sum(axes * np.stack([nodes.stimulus.mounting[node, 2] for node in first]), axis=1),
        first=nodes.stimulus.table_angle[first],
        seconds=seconds,
        place=(time - time[:, :1]) / seconds[:, None],
        ambient=Ambient(**{name: values[padded] for name, values in nodes.stimulus.ambient.items()}),
        # A power of two, so that records of about the same length are one compiled program.
        steps=2 ** math.ceil(math.log2(STEPS_PER_TURN * max(1.0, *map(turns_of, runs)))),
        layers=sorted_layers(layers),
    )


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
    before = [one for one in layers if one.place()[0] == Stage.STAND and not isinstance(one, Broadcast)]
    stands = jax.tree.map(lambda leaf: leaf[servos.stand], propagate(before, initial_path(instants), values).motion)

    def turning(share: Any, angle: Float[Array, " S"], _: None) -> Float[Array, " S"]:
        ambient = jax.tree.map(
            lambda one: jax.vmap(lambda x, y: jnp.interp(share, x, y))(servos.place, one), servos.ambient
        )
        ambient = ambient.updated(table_angle=angle)

        def nearer(_: Array, rate: Float[Array, " S"]) -> Float[Array, " S"]:
            moving = replace(stands, table_angle=angle, table_rate=rate)
            return rate - _output(servos, channels, moving, ambient, values) / servos.gain

        return servos.seconds * jax.lax.fori_loop(0, _ROUNDS, nearer, jnp.zeros_like(angle))

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


def between(share: Any, place: Float[Array, "S K"], values: Float[Array, "S K"]) -> Float[Array, " S"]:
    """Return what each run recorded at a share of its time, between its rows."""
    return jax.vmap(lambda x, y: jnp.interp(share, x, y))(place, values)


def _output(
    servos: Servos, channels: dict[str, Channels], motion: Motion, ambient: Ambient, values
) -> Float[Array, " S"]:
    """Return what the driving gyro reads beyond its nominal offset, output units."""
    path = propagate(servos.layers, SignalPath(motion, ambient, {}, {}, {}), values)
    return jnp.sum(servos.driver * (path.signal["gyro"] - channels["gyro"].offset[None, :]), axis=1)
