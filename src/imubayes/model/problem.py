"""The problem as arrays, and its prediction as a pure function of the parameters.

A `Problem` is one pytree: the nominal motion, the layers of the signal path, the measured entries, the noise, the
priors.  Nothing here closes over a campaign, so units of equal structure are stacked and treated in one vmap.

The forward model lies on the device and is compiled.  Measurements, their noise and the priors are arrays of NumPy:
the algebra that follows a linearisation contains no forward model and compiles nothing (`placed`).
"""

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from imubayes.compiled.kept_programs import compile_ahead, kept
from imubayes.foundations.arrays import (
    Array,
    Bool,
    Float,
    Int,
    Scalars,
    in_batches,
    namespace,
    on_device,
    on_host,
    take,
    take_last,
)
from imubayes.foundations.signal_path_state import Nodes, SignalPath
from imubayes.model.carried_motion import CarriedInstants, carried_motion
from imubayes.model.integrated_outputs import (
    Servos,
    Transitions,
    closing_rotations,
    inverted_rates,
    servo_angles,
    turned_since_start,
)
from imubayes.model.nodes_and_entries import Timeline
from imubayes.model.parameter_priors import HyperCorrelation
from imubayes.model.signal_path import Channels, Layer, initial_path, propagate
from imubayes.noise import components
from imubayes.noise.components import (
    Entry,
    EntryNoise,
    Noise,
    RowSpan,
    SeriesNoise,
    SharedNoise,
    SlowNoise,
    StateCovariance,
    TailNoise,
)
from imubayes.parameters.declarations import Priors

# Half the distance of central differences of a noise formula, as a share of its parameter.
_SHARE = 1e-4
# Batch size of predictions: larger batches would be mostly padding for the usual few points.
_AT_ONCE = 8
# Readings up to which a program that is not optimised saves more time than it takes: of 720 its 40 linearisations take
# 0.1 s more, and to compile it 0.8 s less; of 2300 both are 0.7 s.
_SMALL, _FEW_STEPS = 1000, 3000


class NoiseLayer(eqx.Module):
    """A noise member with the places of its values: one per entry, or per run and channel for shared, AR(1) and tails.

    `acts` is 1 where the member applies and 0 elsewhere.
    """

    noise: type[Noise] = eqx.field(static=True)
    places: dict[str, Array]
    acts: Float[Array, " M"]

    def correlations(self, h: Float[Array, "*batch H"]) -> Float[Array, "*batch M"]:
        """Return the correlation of neighbouring rows of every run and channel."""
        return self._evaluate(h, _correlation)

    def entry_variances(self, h: Float[Array, "*batch H"], entries: Entry) -> Float[Array, "*batch M"]:
        """Return the variance of every entry."""
        return self._evaluate(h, variance_of, entries)

    def shared_variances(self, h: Float[Array, "*batch H"]) -> Float[Array, "*batch M"]:
        """Return the variance of what all entries of a run and channel have in common."""
        return self._evaluate(h, shared_variance_of)

    def tails(self, h: Float[Array, " H"]) -> Float[Array, " M"]:
        """Return one over the degrees of freedom of every run and channel, 0 for a normal distribution."""
        return self._evaluate(h, _tail)

    def states(self, h: Float[Array, " H"], row: RowSpan) -> StateCovariance:
        """Return the covariance of every entry with those of its run and channel; zero if the member is not."""
        member = self.noise
        assert issubclass(member, SlowNoise)
        chosen = _chosen(self, h)
        if namespace(h, self.acts) is np:
            return on_host(_states(member, chosen, self.acts, row))
        return _each_state(member, chosen, self.acts, row)

    def _evaluate(self, h: Float[Array, "*batch H"], quantity: Callable, *entries: Entry) -> Float[Array, "*batch M"]:
        return evaluated(self, h, quantity, *entries)


# Functions rather than methods: those of a module of Equinox cost more to look up than most formulas to evaluate.


def evaluated(
    layer: NoiseLayer, h: Float[Array, "*batch H"], quantity: Callable, *entries: Entry
) -> Float[Array, "*batch M"]:
    """Return a quantity of every entry, such as `variance_of`, at values of the noise parameters in SI."""
    return layer.acts * _at(layer, quantity, _chosen(layer, h), *entries)


def slopes_of(
    layer: NoiseLayer, h: Float[Array, "*batch H"], quantity: Callable, *entries: Entry
) -> list[tuple[Array, Array]]:
    """Return the derivatives of a quantity of every entry by the values that it depends on.

    By central differences over a share of each value, which are exact to rounding for a quadratic formula.

    Returns
    -------
    For each field, places (M,) in h and derivatives (M,).
    """
    chosen, found = _chosen(layer, h), []
    for field, place in layer.places.items():
        step = _SHARE * chosen[field]
        up, down = (_at(layer, quantity, chosen | {field: chosen[field] + side * step}, *entries) for side in (1, -1))
        found.append((place, layer.acts * (up - down) / (2 * step)))
    return found


def _chosen(layer: NoiseLayer, h: Float[Array, "*batch H"]) -> dict[str, Array]:
    return {field: take_last(h, place) for field, place in layer.places.items()}


def _at(layer: NoiseLayer, quantity: Callable, chosen: dict[str, Array], *entries: Entry) -> Array:
    """Return a quantity for the values of every entry; a formula of a user's file may hold for one entry alone."""
    member = layer.noise
    if namespace(layer.acts, *chosen.values()) is not np:
        return _one_by_one(member, quantity, chosen, entries)
    if member.__module__.rpartition(".")[0] == components.__name__.rpartition(".")[0]:
        # Its fields are all that a formula takes of a member: to make one takes longer than the formula.
        return np.asarray(quantity(member, SimpleNamespace(**chosen), *entries))
    shape = np.broadcast_shapes(*(value.shape for value in chosen.values()))
    rows = ({field: value[at] for field, value in chosen.items()} for at in np.ndindex(shape[:-1]))
    found = [np.asarray(_compiled_one_by_one(member, quantity, row, entries)) for row in rows]
    return np.stack(found).reshape(shape)


def variance_of(member: type[EntryNoise], fields: Any, entry: Entry) -> Array:
    """Return the variance of an entry."""
    return member.variance(fields, entry)


def shared_variance_of(member: type[SharedNoise], fields: Any) -> Array:
    """Return the variance of what all entries of a run and channel have in common."""
    return member.shared_variance(fields)


def _correlation(member: type[SeriesNoise], fields: Any) -> Array:
    return member.lag_one_correlation(fields)


def _tail(member: type[TailNoise], fields: Any) -> Array:
    return 1 / member.degrees(fields)


def _one_by_one(member: type[Noise], quantity: Callable, chosen: dict[str, Array], entries: tuple[Entry, ...]) -> Array:
    return jax.vmap(lambda values, *entry: quantity(member, member(**values), *entry))(chosen, *entries)


_compiled_one_by_one = kept(_one_by_one)


def _each_state(member: type[SlowNoise], chosen: dict[str, Array], acts: Array, row: RowSpan) -> StateCovariance:
    def of_entry(values, acts, start, length, gap):
        found = member(**values).states(RowSpan(start, length, gap, row.times))
        return StateCovariance(
            acts * found.variance, acts * found.mean, acts * found.end, found.over_gap, found.over_row
        )

    return jax.vmap(of_entry)(chosen, acts, row.start, row.length, row.gap)


_states = kept(_each_state)  # formulas of vectors, written for one row


class Observations(eqx.Module):
    """What was measured (E entries in G groups, a group being one run and channel).

    Attributes
    ----------
    value : shape (E,), output units; 0 for closing rotations, rad.
    weight : shape (E,), 1, or 0 for an entry that is masked out.
    entry : facts about each entry.
    readout : shape (E_r,), place of each entry in the flattened outputs; closing rotations follow after these.
    group : shape (E,), group of each entry.
    members : shape (G, M), entries of each group, E where padded.
    in_time : shape (G, M), the same in the order of time.
    rank : shape (E,), the place of an entry's row in the order of time of its run.
    """

    value: Float[Array, " E"]
    weight: Float[Array, " E"]
    entry: Entry
    readout: Int[Array, " Er"]
    group: Int[Array, " E"]
    members: Int[Array, "G M"]
    in_time: Int[Array, "G M"]
    rank: Int[Array, " E"]


class Sparsity(eqx.Module):
    """Sparsity of the Jacobian; parameters of one colour affect no common entry.

    Attributes
    ----------
    colour : shape (P,).
    reach : shape (E, P), bool.
    seeds : shape (colours, P), 0 or 1.
    """

    colour: Int[Array, " P"]
    reach: Bool[Array, "E P"]
    seeds: Float[Array, "K P"]


class Problem(eqx.Module):
    """Everything the inference needs, as arrays.

    Attributes
    ----------
    nodes, channels, layers, transitions, carried, servos : the forward model.
    turns : rows as (number of rows, nodes per row), in the order of the nodes; static.
    node_weight : shape (N,).
    timeline : times of the entries; None in a model without slow noise.
    nulls : shape (V − P,), null values of effects, appended to the parameters.
    priors, hyper_priors : from z to SI values, θ and h.
    hyper_correlation : of the prior of h; None if its components are independent.
    spread_of : shape (P,), place in h of the parameter's learnt prior width, H where the prior is fixed.
    spread_unit : shape (P,), width of the parameter's own prior, SI.
    """

    nodes: Nodes
    channels: dict[str, Channels]
    layers: tuple[Layer, ...]
    transitions: Transitions | None
    carried: CarriedInstants | None
    servos: Servos | None
    turns: tuple[tuple[int, int], ...] = eqx.field(static=True)
    node_weight: Float[Array, " N"]
    nulls: Float[Array, " nulls"]
    priors: Priors
    hyper_priors: Priors
    hyper_correlation: HyperCorrelation | None
    noise: tuple[NoiseLayer, ...]
    observations: Observations
    timeline: Timeline | None
    sparsity: Sparsity
    spread_of: Int[Array, " P"]
    spread_unit: Float[Array, " P"]

    @property
    def size(self) -> tuple[int, int]:
        """Number of parameters and of hyperparameters."""
        return self.spread_of.shape[-1], len(self.hyper_priors.order)


def placed(problem: Problem) -> Problem:
    """Return a problem with its forward model on the device, and observations, noise and priors as arrays of NumPy."""
    host = on_host(problem)
    return replace(
        on_device(problem), priors=host.priors, hyper_priors=host.hyper_priors, noise=host.noise,
        hyper_correlation=host.hyper_correlation, observations=host.observations, timeline=host.timeline,
        spread_of=host.spread_of, spread_unit=host.spread_unit,
    )  # fmt: skip


def values_of(problem: Problem, z: Float[Array, " P"]) -> Float[Array, " V"]:
    """Return all values the layers refer to: parameters in SI, then nulls."""
    return jnp.concatenate([problem.priors.values(z), problem.nulls])


def signal_path(problem: Problem, values: Float[Array, " V"]) -> SignalPath:
    """Return the signal path at every node, for parameters in SI and nulls."""
    return _signal_path(problem, values)[0]


def _signal_path(problem: Problem, values: Float[Array, " V"]) -> tuple[SignalPath, Float[Array, "T Kp 3 3"] | None]:
    """Return the signal path at every node, and the rotations between poses; None if there are none."""
    nodes, transitions = problem.nodes, problem.transitions
    if transitions is None:
        return propagate(problem.layers, initial_path(nodes), values), None
    rate = inverted_rates(transitions, problem.channels, values)
    turned = turned_since_start(transitions, rate)
    if problem.carried is not None:
        nodes = replace(nodes, hand=carried_motion(transitions, problem.carried, rate, turned))
    return propagate(problem.layers, initial_path(nodes), values), turned


def predict(problem: Problem, z: Float[Array, " P"]) -> Float[Array, " E"]:
    """Return the predicted value of every entry, output units (rad for closing rotations)."""
    return predict_from(problem, values_of(problem, z))


# Compiled separately: traced once, whatever derivatives are taken of it.
@jax.jit
def predict_from(problem: Problem, values: Float[Array, " V"]) -> Float[Array, " E"]:
    """Return the prediction from parameters in SI and nulls."""
    path, turned = _signal_path(problem, values)
    outputs = [row_means(problem, path.signal[kind]).reshape(-1) for kind in sorted(problem.channels)]
    if problem.servos is not None:
        angles = servo_angles(problem.servos, problem.layers, problem.nodes, problem.channels, values)
        outputs.append(jnp.degrees(angles).reshape(-1))
    predicted = take(jnp.concatenate(outputs), problem.observations.readout)
    if problem.transitions is None or turned is None:
        return predicted
    closing = closing_rotations(problem.transitions, path.motion, turned)
    return jnp.concatenate([predicted, closing.reshape(-1)])


def is_small(problem: Problem, *given: Any) -> bool:
    """Whether all that is evaluated in a fit takes less time than to optimise the program for it."""
    steps = 0 if problem.carried is None or problem.transitions is None else problem.transitions.step.size
    return len(problem.observations.value) <= _SMALL and steps <= _FEW_STEPS


def _each_predicted(problem: Problem, points: Float[Array, "n P"]) -> Float[Array, "n E"]:
    return jax.vmap(lambda z: predict(problem, z))(points)


_predict_batch = kept(_each_predicted, briefly=is_small)


def compile_predictions(problem: Problem) -> None:
    """Compile the program of `predict_many` while the process goes on."""
    compile_ahead(_predict_batch, problem, np.zeros((_AT_ONCE, problem.size[0])))


def predict_many(problem: Problem, points: np.ndarray) -> np.ndarray:
    """Return the predictions of many points (n, P), shape (n, E).

    In batches of one size, so that the signal path is compiled once.
    """
    return in_batches(lambda batch: _predict_batch(problem, batch), np.asarray(points), _AT_ONCE)


def row_means(problem: Problem, signal: Float[Array, "N C"]) -> Float[Array, "R C"]:
    """Average the nodes of each row; rows come sorted by their number of nodes, so this is a reshape and a sum."""
    weighted = signal * problem.node_weight[:, None]
    means, place = [], 0
    for rows, nodes in problem.turns:
        block = weighted[place : place + rows * nodes]
        means.append(block.reshape(rows, nodes, -1).sum(axis=1))
        place += rows * nodes
    return jnp.concatenate(means)


def predict_with_jacobian(problem: Problem, z: Float[Array, " P"]) -> tuple[Float[Array, " E"], Float[Array, "E P"]]:
    """Return f(z) and ∂f/∂z.

    One forward derivative per colour instead of one per parameter (compressed Jacobian): parameters of one colour
    affect no common entry, so their columns are separated by the sparsity pattern.
    """
    sparsity = problem.sparsity
    predicted, push = jax.linearize(lambda point: predict(problem, point), z)
    packed = jax.vmap(push)(sparsity.seeds) if problem.carried is None else _in_turn(push, sparsity.seeds)
    return predicted, jnp.where(sparsity.reach, take(packed, sparsity.colour).T, 0.0)


def _in_turn(push: Callable, seeds: Float[Array, "S P"]) -> Float[Array, "S E"]:
    """Return a linear function of each seed, some at once: that of a long motion would not stay in the cache.

    The last batch is filled with zeros: a rest would be compiled for itself.
    """
    count = len(seeds)
    batches = jnp.pad(seeds, ((0, -count % _AT_ONCE), (0, 0))).reshape(-1, _AT_ONCE, seeds.shape[1])
    packed = jax.lax.map(jax.vmap(push), batches)
    return packed.reshape(-1, packed.shape[-1])[:count]


def hyper_prior_square(problem: Problem, h: Float[Array, "*batch H"]) -> Scalars:
    """Return −2 log p(h), up to the constant H log 2π."""
    return (h**2).sum(-1) if problem.hyper_correlation is None else problem.hyper_correlation.square(h)


def prior_widths(problem: Problem, h: Float[Array, "*batch H"]) -> Float[Array, "*batch P"]:
    """Return the standard deviation of each z_θ: 1, or the learnt prior width over the stated one."""
    if namespace(h, problem.spread_of) is np and not (problem.spread_of < problem.size[1]).any():
        return np.ones((*h.shape[:-1], len(problem.spread_of)))
    values = problem.hyper_priors.values(h)
    xp = namespace(values, problem.spread_of)
    widths = take_last(xp.concatenate([values, xp.ones((*values.shape[:-1], 1))], axis=-1), problem.spread_of)
    return xp.where(problem.spread_of < values.shape[-1], widths / problem.spread_unit, 1.0)


def masked(problem: Problem, left_out: np.ndarray) -> Problem:
    """Return the problem with entries, (E,) bool, masked out; shapes are unchanged, so nothing is recompiled."""
    weight = problem.observations.weight * (~left_out).astype(float)
    return eqx.tree_at(lambda known: known.observations.weight, problem, weight)
