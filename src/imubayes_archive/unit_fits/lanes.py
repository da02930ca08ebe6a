"""The joint fit of units of one structure side by side, in the lanes of one compiled function.

Two bound models have the same structure if their arrays have the same shapes and all places in them, which are
integers, are the same: the same runs, channels, parameters and missing readings.  Places are shared by the lanes; only
numbers are stacked.  The number of lanes is fixed, and the compiled function is driven from Python.  A chunk that does
not fill the lanes is filled up with copies of its last unit.

As in `imubayes.inference.posterior_mode`, θ is found by Gauss–Newton steps at given noise scales, and these by the
maximum of their Laplace marginal, until neither changes.  The model is so nearly linear that three Jacobians are enough
as a rule: one in the middle of the prior, one after two steps with it, and one at the mode.  A step without a new
Jacobian costs a residual and sums.  Every lane takes the same number of steps with a Jacobian, and one that is done
keeps its values: the result of a unit does not depend on those beside it.
"""

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from imubayes.compiled.kept_programs import run_bound
from imubayes.foundations.arrays import Array, Bool, Float, Int, Scalar, on_device
from imubayes.model.bind import Model
from imubayes.model.problem import Problem
from imubayes_archive.unit_fits import group_moments as moments

LANES = 4
"""Units side by side: with more the arrays leave the cache of a core."""
_DIGITS = 16


def structure_key(problem: Problem) -> str:
    """Return the key of a problem's structure."""
    digest = hashlib.sha256(str(jax.tree.structure(problem)).encode())
    for path, leaf in jax.tree_util.tree_flatten_with_path(problem)[0]:
        array = np.asarray(leaf)
        digest.update(f"{array.dtype}{array.shape}".encode())
        if _is_shared(path, array):
            digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()[:_DIGITS]


def _is_shared(path: tuple, leaf: Any) -> bool:
    """Return whether all units of a structure have an array in common: places, and the seeds of the Jacobian."""
    return np.asarray(leaf).dtype.kind != "f" or ".sparsity" in jax.tree_util.keystr(path)


Stacked = tuple[Array, ...]
"""The arrays of units in lanes that differ between units, each (LANES, …)."""


@dataclass(frozen=True)
class LaneStructure:
    """The compiled functions of a structure, by its first problem."""

    problem: Problem
    index: moments.GroupIndex

    @staticmethod
    def of(problem: Problem) -> "LaneStructure | None":
        """Return the structure of a problem; None where its readings cannot be summed up by groups."""
        index = moments.group_index(problem)
        return None if index is None else LaneStructure(problem, on_device(index))

    @cached_property
    def _shared(self) -> tuple[bool, ...]:
        return tuple(_is_shared(path, leaf) for path, leaf in jax.tree_util.tree_flatten_with_path(self.problem)[0])

    @cached_property
    def _common(self) -> Stacked:
        leaves = zip(jax.tree.leaves(self.problem), self._shared, strict=True)
        return tuple(on_device(leaf) for leaf, same in leaves if same)

    @cached_property
    def _places(self) -> tuple[Array, ...]:
        return tuple(jax.tree.leaves(self.index))

    @cached_property
    def _token(self) -> object:
        return object()

    def stacked(self, models: Sequence[Model]) -> Stacked:
        """Return the arrays that differ between units, stacked in lanes."""
        filled = [*models, *[models[-1]] * (LANES - len(models))]
        units = [jax.tree.leaves(model.problem) for model in filled]
        own = [leaves for *leaves, same in zip(*units, self._shared, strict=True) if not same]
        return tuple(jax.device_put([np.stack([np.asarray(leaf) for leaf in leaves]) for leaves in own]))

    def run(self, function: Callable, varying: Stacked, *arguments: Any) -> Any:
        """Return `function(problem, index, *arguments)` of every lane.

        Parameters
        ----------
        function : of one unit, from a module; compiled once for a structure.
        arguments : arrays with the lanes first; their tree is the same every time.
        """
        # Leaves are handed over, not problems: taking a problem apart costs more than a small function of it.
        given = jax.tree.leaves(arguments)
        key = (self._token, function, *((leaf.shape, leaf.dtype) for leaf in given))
        arrays = [*self._common, *varying, *self._places, *given]
        return run_bound(
            key, _mapped, arrays,
            lambda: (function, self._with(self._common, True), self._with(varying, False), self.index, *arguments),
        )  # fmt: skip

    def _with(self, arrays: Stacked, shared: bool) -> Problem:
        """Return the problem with its arrays that are shared, or those that are not, and None for the others."""
        left = iter(arrays)
        leaves = [next(left) if same == shared else None for same in self._shared]
        return jax.tree.unflatten(jax.tree.structure(self.problem), leaves)


def _mapped(function: Callable, common: Problem, varying: Problem, index: moments.GroupIndex, *arguments: Any) -> Any:
    def of_unit(own, *given):
        return function(eqx.combine(common, own), index, *given)

    return jax.vmap(of_unit)(varying, *arguments)


def of_lane(tree: Any, lane: int) -> Any:
    """Return the arrays of one lane."""
    return jax.tree.map(lambda leaf: leaf[lane], tree)


# The decrement, in posterior standard deviations, below which a fit has converged, and that of a fit that is done.
_DECREMENT, _DONE = 1e-2, 1e-3
# A Jacobian serves as long as a step leaves less than this share of the decrement.
_NEARLY_LINEAR = 1e-2
# The marginal of the noise scales needs a Jacobian of the mode: taken no farther away than this.
_CLOSE = 1.0
_LINEARISATIONS, _HALVINGS = 20, 6
# Steps of the noise scales: at most this many, ended by one shorter than _SHORT; a step is at most 1 along each axis.
_CLIMB, _SHORT, _SHORTEST = 40, 1e-4, 1e-2
_LEAST_CURVATURE, _ROUNDING = 0.1, 1e-9
# A step of θ is halved if the log density falls by more than rounding, for a decrement of 1.
_LEVEL = 1e-6
# The rank-one update is skipped if step and secant error are this close to orthogonal.
_TELLING = 1e-8


class Climb(eqx.Module):
    """The noise scales of most marginal density in a linearised model; of several units with the lanes first.

    Attributes
    ----------
    h : shape (H,).
    curvature : shape (H, H), negative Hessian of the marginal as learnt from the steps.
    settled : whether the steps ended.
    """

    h: Float[Array, "*lanes H"]
    curvature: Float[Array, "*lanes H H"]
    settled: Bool[Array, "*lanes"]


class Chord(eqx.Module):
    """Where steps of θ with one Jacobian end.

    Attributes
    ----------
    model : about the end, Jacobian kept.
    first, last : decrements of the first and of the last step.
    """

    model: moments.GroupedModel
    first: Scalar
    last: Scalar


class LaneMode(eqx.Module):
    """Where the fits ended; all leaves have the lanes first.

    Attributes
    ----------
    model : linearised at, or close to, the mode; its misfit is that at the mode.
    h : noise scales.
    decrement : size of the step still to go, in posterior standard deviations.
    converged : whether θ and h converged.
    """

    model: moments.GroupedModel
    h: Array
    decrement: Array
    converged: Array


def first_curvature(problem: Problem, index: moments.GroupIndex, model: moments.GroupedModel, h: Array) -> Array:
    """Return the curvature that a climb begins with."""
    return moments.expected_information(problem, index, model, h)


def climbed(problem: Problem, index: moments.GroupIndex, model: moments.GroupedModel, start: Climb) -> Climb:
    """Return the mode of the marginal of h by quasi-Newton steps (symmetric rank one) with backtracking."""

    def towards(gradient, curvature):
        eigenvalues, axes = jnp.linalg.eigh(curvature)
        along = axes.T @ gradient / jnp.maximum(jnp.abs(eigenvalues), _LEAST_CURVATURE)
        return axes @ jnp.clip(along, -1.0, 1.0)

    def body(state):
        h, value, gradient, curvature, step, length, count = state
        ahead, there = moments.marginal_slope(problem, index, model, h + step)
        better = ahead >= value - _ROUNDING
        lacking = gradient - there - curvature @ step
        weight = lacking @ step
        telling = jnp.abs(weight) > _TELLING * jnp.linalg.norm(lacking) * jnp.linalg.norm(step)
        learnt = curvature + jnp.where(telling, jnp.outer(lacking, lacking) / jnp.where(telling, weight, 1.0), 0.0)
        h, value, gradient = jax.tree.map(
            lambda new, old: jnp.where(better, new, old), (h + step, ahead, there), (h, value, gradient)
        )
        curvature = jnp.where(jnp.all(jnp.isfinite(learnt)), learnt, curvature)
        length = jnp.where(better, 1.0, 0.3 * length)
        return h, value, gradient, curvature, length * towards(gradient, curvature), length, count + 1

    def going(state):
        step, length, count = state[4:]
        return (count < _CLIMB) & ~(jnp.max(jnp.abs(step)) < _SHORT) & (length > _SHORTEST)

    value, gradient = moments.marginal_slope(problem, index, model, start.h)
    step = towards(gradient, start.curvature)
    state = (start.h, value, gradient, start.curvature, step, jnp.asarray(1.0), jnp.asarray(0))
    h, _, _, curvature, step, length, _ = jax.lax.while_loop(going, body, state)
    is_last = jnp.max(jnp.abs(step)) < _SHORT
    return Climb(jnp.where(is_last, h + step, h), curvature, is_last | (length <= _SHORTEST))


def along_chord(
    problem: Problem, index: moments.GroupIndex, model: moments.GroupedModel, h: Array, steps: Int[Array, ""]
) -> Chord:
    """Return where steps to the mode at given noise scales end, all with one Jacobian.

    A step is halved while the log density falls.
    """
    start = moments.normal_equations(problem, index, model, h)
    factor = jnp.linalg.cholesky(start.precision)

    def body(state):
        here, (square, gradient), length, halvings, count, first, _ = state
        step = jax.scipy.linalg.cho_solve((factor, True), gradient)
        decrement = jnp.sqrt(jnp.maximum(gradient @ step, 0.0))
        z = here[0] + length * step
        there = (z, moments.grouped_misfit(problem, index, z))
        known = moments.normal_equations(problem, index, moments.with_misfit(model, *there), h)
        rises = 0.5 * (square - known.square) >= -_LEVEL * (1 + decrement)
        taken = rises | (halvings == _HALVINGS)
        ahead = (there, (known.square, known.gradient), 1.0, 0, count + 1)
        stays = (here, (square, gradient), length / 2, halvings + 1, count)
        chosen = jax.tree.map(lambda new, old: jnp.where(taken, new, old), ahead, stays)
        return *chosen, jnp.where(count == 0, decrement, first), decrement

    none, zero = jnp.asarray(0.0), jnp.asarray(0)
    state = ((model.z, model.misfit), (start.square, start.gradient), jnp.asarray(1.0), zero, zero, none, none)
    (z, misfit), *_, first, last = jax.lax.while_loop(lambda state: state[4] < steps, body, state)
    return Chord(moments.with_misfit(model, z, misfit), first, last)


def find_modes(structure: LaneStructure, varying: Stacked, given: Array | None = None) -> LaneMode:
    """Return the joint fits of stacked units, from the middle of the prior.

    Parameters
    ----------
    given : noise scales to keep, shape (LANES, H); they are found if None.
    """
    size, hyper = structure.problem.size
    middle = structure.run(moments.grouped_model, varying, np.zeros((LANES, size)))
    # Far from the mode the residuals are no measure of the noise: its scales wait for the next Jacobian.
    h = np.zeros((LANES, hyper)) if given is None else given
    climb = Climb(h, structure.run(first_curvature, varying, middle, h), np.full(LANES, given is not None))
    near = _stepped(structure, varying, middle, climb, 2).model
    done, result = np.zeros(LANES, dtype=bool), None
    for _ in range(_LINEARISATIONS):
        model = structure.run(moments.grouped_model, varying, near.z)
        found, climb = _one_linearisation(structure, varying, model, climb, given is not None)
        result = found if result is None else _chosen(done, result, found)
        done = done | np.asarray(found.converged) | ~np.isfinite(np.asarray(found.decrement))
        if done.all():
            break
        near = result.model
        climb = eqx.tree_at(lambda c: c.h, climb, result.h)
    assert result is not None
    return result


def _stepped(
    structure: LaneStructure, varying: Stacked, model: moments.GroupedModel, climb: Climb, steps: int
) -> Chord:
    return structure.run(along_chord, varying, model, climb.h, np.full(LANES, steps))


def _one_linearisation(
    structure: LaneStructure, varying: Stacked, model: moments.GroupedModel, climb: Climb, keep: bool
) -> tuple[LaneMode, Climb]:
    """Return where the fits end with one Jacobian, and the noise scales with the curvature learnt on the way."""
    close = np.ones(LANES, dtype=bool)
    if not keep:
        near = _stepped(structure, varying, model, climb, 1)
        close, model = np.asarray(near.first) < _CLOSE, near.model
        climb = structure.run(climbed, varying, model, climb)
    end = _stepped(structure, varying, model, climb, 2)
    decrement, left = np.asarray(end.first), np.asarray(end.last)
    share = left / np.maximum(decrement, _DONE)
    ready = (share < _NEARLY_LINEAR) | (decrement < _DONE)
    error = left * np.minimum(share, 1.0)
    converged = close & (decrement < _CLOSE) & ready & (error < _DECREMENT) & np.asarray(climb.settled)
    return LaneMode(end.model, climb.h, jnp.asarray(error), jnp.asarray(converged)), climb


def _chosen(done: np.ndarray, old: Any, new: Any) -> Any:
    """Return the old values of lanes that are done, the new ones of the others."""
    return jax.tree.map(lambda a, b: jnp.where(done.reshape(-1, *(1,) * (a.ndim - 1)), a, b), old, new)
