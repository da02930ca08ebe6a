"""The joint fit of units in lanes.

As in `imubayes.inference.posterior_mode`, θ is found by Gauss–Newton steps at given noise scales, and these by the
maximum of their Laplace marginal, until neither changes.  The model is so nearly linear that three Jacobians are enough
as a rule: one in the middle of the prior, one after two steps with it, and one at the mode.  Every lane takes the same
number of steps with a Jacobian, and one that is done keeps its values: the result of a unit does not depend on those
beside it.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from imubayes.array_shapes import Array, Bool, Float, Scalar
from imubayes.batch.group_moments import (
    GroupedModel,
    GroupIndex,
    expected_information,
    grouped_misfit,
    grouped_model,
    normal_equations,
    with_misfit,
)
from imubayes.batch.lanes import LANES, LaneStructure
from imubayes.batch.marginal_slope import marginal_slope
from imubayes.model.problem import Problem

# The decrement, in posterior standard deviations, below which a fit has converged, and that of a fit that is done.
_DECREMENT, _DONE = 1e-2, 1e-3
# A Jacobian serves as long as a step leaves less than this share of the decrement.
_NEARLY_LINEAR = 1e-2
# The marginal of the noise scales needs a Jacobian of the mode: taken no farther away than this.
_CLOSE = 1.0
_LINEARISATIONS, _HALVINGS = 20, 6
# Steps of the noise scales: at most this many, ended by one shorter than _SHORT, on the way to the mode than _ROUGH; a
# step is at most 1 along each axis.
_CLIMB, _SHORT, _ROUGH, _SHORTEST = 40, 1e-4, 0.1, 1e-2
_LEAST_CURVATURE, _ROUNDING = 0.1, 1e-9
# The rank-one update is skipped where step and secant error are this close to orthogonal.
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


class Advance(eqx.Module):
    """The noise scales, the step (P,) of θ to the mode of the linearised model there, and its decrement."""

    climb: Climb
    step: Float[Array, " P"]
    decrement: Scalar


class LaneMode(eqx.Module):
    """Where the fits ended; all leaves have the lanes first.

    Attributes
    ----------
    model : linearised at, or close to, the mode; its misfit is that at the mode.
    h : noise scales.
    decrement : size of the step still to go, in posterior standard deviations.
    converged : whether θ and h converged.
    """

    model: GroupedModel
    h: Array
    decrement: Array
    converged: Array


def first_curvature(problem: Problem, index: GroupIndex, model: GroupedModel, h: Array) -> Array:
    """Return the curvature that a climb begins with."""
    return expected_information(problem, index, model, h)


def advance(
    problem: Problem, index: GroupIndex, model: GroupedModel, h: Array, curvature: Array, short: Scalar
) -> Advance:
    """Return the noise scales of most marginal density in the linearised model, and the step to its mode there."""
    return _towards(problem, index, model, _climbed(problem, index, model, h, curvature, short))


def advance_at(problem: Problem, index: GroupIndex, model: GroupedModel, h: Array, curvature: Array) -> Advance:
    """Return the step to the mode of the linearised model at given noise scales."""
    return _towards(problem, index, model, Climb(h, curvature, jnp.asarray(True)))


def _towards(problem: Problem, index: GroupIndex, model: GroupedModel, climb: Climb) -> Advance:
    known = normal_equations(problem, index, model, climb.h)
    step = jax.scipy.linalg.cho_solve((jnp.linalg.cholesky(known.precision), True), known.gradient)
    return Advance(climb, step, jnp.sqrt(jnp.maximum(known.gradient @ step, 0.0)))


def _climbed(
    problem: Problem, index: GroupIndex, model: GroupedModel, h: Array, curvature: Array, least: Scalar
) -> Climb:
    """Return the mode of the marginal of h by quasi-Newton steps (symmetric rank one) with backtracking."""

    def body(state):
        h, value, gradient, curvature, length, count, _ = state
        eigenvalues, axes = jnp.linalg.eigh(curvature)
        along = axes.T @ gradient / jnp.maximum(jnp.abs(eigenvalues), _LEAST_CURVATURE)
        step = length * (axes @ jnp.clip(along, -1.0, 1.0))
        ahead, there = marginal_slope(problem, index, model, h + step)
        better = ahead >= value - _ROUNDING
        lacking = gradient - there - curvature @ step
        weight = lacking @ step
        telling = jnp.abs(weight) > _TELLING * jnp.linalg.norm(lacking) * jnp.linalg.norm(step)
        learnt = curvature + jnp.where(telling, jnp.outer(lacking, lacking) / jnp.where(telling, weight, 1.0), 0.0)
        chosen = jax.tree.map(
            lambda new, old: jnp.where(better, new, old), (h + step, ahead, there), (h, value, gradient)
        )
        curvature = jnp.where(jnp.all(jnp.isfinite(learnt)), learnt, curvature)
        short = jnp.max(jnp.abs(step)) < least
        return *chosen, curvature, jnp.where(better, 1.0, 0.3 * length), count + 1, short

    def going(state):
        length, count, short = state[4:]
        return (count < _CLIMB) & ~short & (length > _SHORTEST)

    value, gradient = marginal_slope(problem, index, model, h)
    start = (h, value, gradient, curvature, jnp.asarray(1.0), jnp.asarray(0), jnp.asarray(False))
    end = jax.lax.while_loop(going, body, start)
    return Climb(end[0], end[3], end[6] | (end[4] <= _SHORTEST))


def moved(
    problem: Problem, index: GroupIndex, model: GroupedModel, h: Array, step: Array
) -> tuple[GroupedModel, Scalar]:
    """Return the model about the end of a step, Jacobian kept, and how much higher the log density is there."""
    ahead = with_misfit(model, model.z + step, grouped_misfit(problem, index, model.z + step))

    def height(at: GroupedModel) -> Scalar:
        return -0.5 * normal_equations(problem, index, at, h).square

    return ahead, height(ahead) - height(model)


def find_modes(structure: LaneStructure, varying: Problem, given: Array | None = None) -> LaneMode:
    """Return the joint fits of stacked units, from the middle of the prior.

    Parameters
    ----------
    given : noise scales to keep, shape (LANES, H); they are found where None.
    """
    size, hyper = structure.problem.size
    z, h = jnp.zeros((LANES, size)), jnp.zeros((LANES, hyper)) if given is None else given
    middle = structure.run(grouped_model, varying, z)
    climb = Climb(h, structure.run(first_curvature, varying, middle, h), jnp.ones(LANES, dtype=bool))
    near, climb = _approached(structure, varying, middle, climb, given is not None)
    done, result = np.zeros(LANES, dtype=bool), None
    for _ in range(_LINEARISATIONS):
        model = structure.run(grouped_model, varying, near.z)
        found, climb = _one_linearisation(structure, varying, model, climb, given is not None)
        result = found if result is None else _chosen(done, result, found)
        done = done | np.asarray(found.converged) | ~np.isfinite(np.asarray(found.decrement))
        if done.all():
            break
        near = result.model
        climb = eqx.tree_at(lambda c: c.h, climb, result.h)
    assert result is not None
    return result


def _advanced(
    structure: LaneStructure, varying: Problem, model: GroupedModel, climb: Climb, short: float, keep: bool
) -> Advance:
    """Return where the linearised models end, noise scales as they are where they are to be kept."""
    if keep:
        return structure.run(advance_at, varying, model, climb.h, climb.curvature)
    return structure.run(advance, varying, model, climb.h, climb.curvature, jnp.full(LANES, short))


def _approached(
    structure: LaneStructure, varying: Problem, model: GroupedModel, climb: Climb, keep: bool
) -> tuple[GroupedModel, Climb]:
    """Return the models after two steps with the Jacobian of the middle of the prior, and the noise scales."""
    first = _advanced(structure, varying, model, climb, _ROUGH, keep)
    near = _stepped(structure, varying, model, first)
    second = structure.run(advance_at, varying, near, first.climb.h, first.climb.curvature)
    return _stepped(structure, varying, near, second), first.climb


def _one_linearisation(
    structure: LaneStructure, varying: Problem, model: GroupedModel, climb: Climb, keep: bool
) -> tuple[LaneMode, Climb]:
    """Return where the fits end with one Jacobian, and the noise scales with the curvature learnt on the way."""
    first = _advanced(structure, varying, model, climb, _SHORT, keep)
    near, decrement = _stepped(structure, varying, model, first), np.asarray(first.decrement)
    second = _advanced(structure, varying, near, first.climb, _SHORT, keep)
    ended, _ = structure.run(moved, varying, near, second.climb.h, second.step)
    left = np.asarray(second.decrement)
    share = left / np.maximum(decrement, _DONE)
    ready = (share < _NEARLY_LINEAR) | (decrement < _DONE)
    error = left * np.minimum(share, 1.0)
    converged = (decrement < _CLOSE) & ready & (error < _DECREMENT) & np.asarray(second.climb.settled)
    return LaneMode(ended, second.climb.h, jnp.asarray(error), jnp.asarray(converged)), second.climb


def _stepped(structure: LaneStructure, varying: Problem, model: GroupedModel, first: Advance) -> GroupedModel:
    """Return the models after their steps, halved where the log density would fall."""
    length = np.ones(LANES)
    near, gain = structure.run(moved, varying, model, first.climb.h, first.step)
    for _ in range(_HALVINGS):
        worse = ~(np.asarray(gain) >= -1e-6 * (1 + np.asarray(first.decrement)))
        if not worse.any():
            break
        length = np.where(worse, length / 2, length)
        near, gain = structure.run(moved, varying, model, first.climb.h, first.step * length[:, None])
    return near


def _chosen(done: np.ndarray, old: Any, new: Any) -> Any:
    """Return the old values of lanes that are done, the new ones of the others."""
    return jax.tree.map(lambda a, b: jnp.where(done.reshape(-1, *(1,) * (a.ndim - 1)), a, b), old, new)
