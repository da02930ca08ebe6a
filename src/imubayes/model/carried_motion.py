"""Attitude of a unit in motion, carried by its own gyros from the nearest pose.

The unit is waved, or turned on a drill or a wheel, and nobody knows its motion.  Its outputs are inverted to rates
(`imubayes.model.integrated_outputs`), which are integrated from pose to pose; an instant between two poses has the
attitude of the nearer one, turned by the product P of the rotations since it:

    C_nb(t) = exp(−ω_E τ) · C_nb(pose) · P.

P depends on every coefficient of the gyros.  What gravity says of the attitude at many instants so informs on the
gyros: their scale factor is absolute, by turns that gravity counts.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from imubayes.foundations.arrays import Array, Bool, Float, Int, compose, take
from imubayes.foundations.signal_path_state import HandMotion
from imubayes.model.assembly import Assembly
from imubayes.model.integrated_outputs import Transitions

_FIRST_PRECISION = np.repeat([np.radians(5.0), 0.03], 3) ** -2.0  # of biases, rad/s, and scale factors, a priori
_FARTHEST = 4.0  # standard deviations of the prior that the first estimate of a gyro is followed


class CarriedInstants(eqx.Module):
    """The nodes that are carried (n of them), in the transitions of a campaign (T of them, of K steps).

    Attributes
    ----------
    of_node : shape (N,), place of each node of the campaign among them; n for one that is not carried.
    turn, step : shape (n,), transition, and steps from its start.
    back : shape (n,), whether its pose is that at the end of the transition.
    before, after : shape (n,), the steps before and after it, as t·K + k; the same one at the ends.
    per_second : shape (n,), one over the time between the middles of these steps, 1/s; 0 at the ends.
    """

    of_node: Int[Array, " N"]
    turn: Int[Array, " n"]
    step: Int[Array, " n"]
    back: Bool[Array, " n"]
    before: Int[Array, " n"]
    after: Int[Array, " n"]
    per_second: Float[Array, " n"]


def bind_carried(assembly: Assembly, transitions: Transitions | None) -> CarriedInstants | None:
    """Return the nodes of a campaign that are carried; None if there are none."""
    nodes, campaign = assembly.grouping.nodes, assembly.grouping.campaign
    hand = nodes.stimulus.hand
    if hand is None or transitions is None:
        return None
    turns = [0 if run.tumble is None else run.tumble.turns for run in campaign.runs]
    first = np.cumsum([0, *turns])
    node = np.flatnonzero(hand.carried > 0)
    turn, step = first[nodes.run[node]] + hand.transition[node], hand.step[node]
    length = np.asarray(transitions.step)
    steps = np.sum(length > 0, axis=1)[turn]
    before, after = np.maximum(step - 1, 0), np.minimum(step, steps - 1)
    apart = 0.5 * (length[turn, before] + length[turn, after])
    width = length.shape[1]
    of_node = np.full(len(hand.carried), len(node))
    of_node[node] = np.arange(len(node))
    return CarriedInstants(
        of_node=of_node,
        turn=turn,
        step=step,
        back=hand.back[node],
        before=turn * width + before,
        after=turn * width + after,
        per_second=np.where(before == after, 0.0, 1 / apart),
    )


def carried_motion(
    transitions: Transitions,
    carried: CarriedInstants,
    rate: Float[Array, "TK 3"],
    since_start: Float[Array, "T Kp 3 3"],
) -> HandMotion:
    """Return the motion of every node since its pose; of a node that is not carried the identity.

    Parameters
    ----------
    rate : mean inertial rate of every step, rad/s, body axes.
    since_start : products of the rotations of each transition, as of `turned_since_start`.
    """
    ahead = since_start[carried.turn, carried.step]
    behind = jax.vmap(lambda whole, part: compose(whole.T, part))(take(since_start[:, -1], carried.turn), ahead)
    turn = jnp.where(carried.back[:, None, None], behind, ahead)
    elapsed = jnp.concatenate([jnp.zeros((len(transitions.step), 1)), jnp.cumsum(transitions.step, axis=1)], axis=1)
    time = elapsed[carried.turn, carried.step] - jnp.where(carried.back, elapsed[carried.turn, -1], 0.0)
    early, late = take(rate, carried.before), take(rate, carried.after)

    def of_all(values: Array, otherwise: Array) -> Array:
        return take(jnp.concatenate([values, otherwise[None]]), carried.of_node)

    none = jnp.zeros(3)
    return HandMotion(
        turn=of_all(turn, jnp.eye(3)),
        elapsed=of_all(time, none[0]),
        rate=of_all(0.5 * (early + late), none),
        acceleration=of_all((late - early) * carried.per_second[:, None], none),
        carried=of_all(jnp.ones(len(carried.turn)), none[0]),
    )


def first_point(assembly: Assembly) -> np.ndarray:
    """Return z, (P,), from which a fit begins: the middle of the prior, but for the gyros of a unit in motion.

    If the unit turns many times between its poses, nominal scale factors would be off by more than a turn.  The
    first estimates that the poses of the runs stand on are taken, each by its information: about one axis, at one rate,
    a run determines one combination of bias and scale factor.
    """
    z = np.zeros(len(assembly.layout))
    tumbles = [run.tumble for run in assembly.grouping.campaign.runs if run.tumble is not None]
    first = [tumble.first_gyros for tumble in tumbles if len(tumble.first_gyros)]
    if not first:
        return z
    information = sum((each[1:] for each in first), start=np.diag(_FIRST_PRECISION))
    bias, scale = np.split(np.linalg.solve(information, sum(each[1:] @ each[0] for each in first)), 2)
    axes = {channel.name: channel.axes[0] for channel in assembly.grouping.campaign.of_kind("gyro")}
    along = {"gyro_bias": {name: axis @ bias for name, axis in axes.items()}}
    along["gyro_scale_factor"] = {name: axis**2 @ scale for name, axis in axes.items()}
    for place, parameter in enumerate(assembly.layout.parameters):
        value = along.get(parameter.effect, {}).get(parameter.label[0] if parameter.label else "")
        if value is not None:
            z[place] = np.clip(parameter.prior.z(float(value)), -_FARTHEST, _FARTHEST)
    return z
