"""The emcee move that proposes from the nested Laplace approximation.

An independence proposal with exact Metropolis–Hastings weights: whatever the quality of the approximation, the chain
has the posterior as its stationary distribution; the quality decides the acceptance alone.
"""

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import lazy_loader
import numpy as np

from imubayes.array_shapes import Array, Float
from imubayes.inference.nested_laplace import NestedLaplace, to_normal, to_point
from imubayes.kept_programs import kept
from imubayes.model.likelihood import log_density
from imubayes.model.problem import Problem

if TYPE_CHECKING:
    import emcee
else:
    emcee = lazy_loader.load("emcee")  # takes long to import, and only sampling needs it


# Points per vectorised block: larger blocks exceed the cache of a core.
_MOST_IN_BLOCK = 16


def in_blocks(function: Callable[[Array], Any], rows: Float[Array, "n PH"]) -> Any:
    """Apply a function of one row to all; the last block is padded, since a shorter one would be compiled as well.

    Vectorised as a whole, the precisions of 4000 draws take hundreds of megabytes, and five times as long.
    """
    count = rows.shape[0]
    block = min(_MOST_IN_BLOCK, count)
    padded = jnp.concatenate([rows, jnp.repeat(rows[-1:], -count % block, axis=0)])
    return jax.tree.map(lambda whole: whole[:count], jax.lax.map(function, padded, batch_size=block))


@kept
def _to_point(approximation: NestedLaplace, problem: Problem, normal: Float[Array, "n PH"]):
    return in_blocks(lambda vector: to_point(approximation, problem, vector), normal)


@kept
def _to_normal(approximation: NestedLaplace, problem: Problem, points: Float[Array, "n PH"]):
    return in_blocks(lambda point: to_normal(approximation, problem, point), points)


@kept
def _log_density(problem: Problem, points: Float[Array, "n PH"], block: int) -> Float[Array, " n"]:
    size = problem.size[0]
    return jax.lax.map(lambda point: log_density(problem, point[:size], point[size:]), points, batch_size=block)


class LogDensity:
    """The log density of a problem for many points at once, in z.

    Points are evaluated in batches of fixed size, so that the function is compiled once.  NaN counts as zero density;
    +∞ raises FloatingPointError, since a walker would never leave such a point.
    """

    def __init__(self, problem: Problem, batch: int):
        # Blocks of nearly the largest size, with little padding in the last.
        blocks = math.ceil(batch / _MOST_IN_BLOCK)
        self.problem, self.block = problem, math.ceil(batch / blocks)
        self.batch = blocks * self.block
        self.evaluations = 0

    def __call__(self, points: np.ndarray) -> np.ndarray:
        count = len(points)
        self.evaluations += count
        padded = np.concatenate([points, np.repeat(points[-1:], -count % self.batch, axis=0)])
        parts = [
            np.asarray(_log_density(self.problem, padded[start : start + self.batch], self.block))
            for start in range(0, len(padded), self.batch)
        ]
        values = np.concatenate(parts)[:count]
        if np.any(values == np.inf):
            raise FloatingPointError("the log density is +∞ at a sampled point")
        return np.where(np.isnan(values), -np.inf, values)


@runtime_checkable
class Proposal(Protocol):
    """A map from standard normal vectors to points and back, with the log density of the points."""

    @property
    def dimensions(self) -> int:
        """Number D of parameters."""
        ...

    def to_point(self, normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the points of standard normal vectors, (n, D), and the log density of the proposal, (n,)."""
        ...

    def to_normal(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the standard normal vectors of points, (n, D), and the log density of the proposal, (n,)."""
        ...


class LaplaceProposal:
    """The nested Laplace approximation for whole ensembles: a map from standard normal vectors and back."""

    def __init__(self, approximation: NestedLaplace, problem: Problem):
        self.approximation, self.problem = approximation, problem
        self.dimensions = sum(problem.size)

    def to_point(self, normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the points of standard normal vectors, (n, P + H), and the log density of the proposal, (n,)."""
        points, density = _to_point(self.approximation, self.problem, normal)
        return np.array(points), np.array(density)

    def to_normal(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the standard normal vectors of points, (n, P + H), and the log density of the proposal, (n,)."""
        normal, density = _to_normal(self.approximation, self.problem, points)
        return np.array(normal), np.array(density)

    def draw(self, random: np.random.RandomState, count: int) -> np.ndarray:
        """Return `count` independent proposals, shape (count, P + H)."""
        return self.to_point(random.normal(size=(count, self.dimensions)))[0]


class LaplaceMove:
    """Move every walker in the coordinates of the proposal, where the posterior is close to standard normal.

    u′ = √(1 − β²) u + β ξ leaves the standard normal invariant (preconditioned Crank–Nicolson, Cotter et al. 2013), so
    a move is accepted with probability min(1, w′/w), w = posterior over proposal.  β = 1 is an independent draw;
    smaller steps free a walker from a place where the density of the proposal is far too low.  The walkers that take a
    short step are drawn anew in each step, independently of their state.

    Parameters
    ----------
    proposal : map and log density.
    short_step : β of the short steps, above 0, at most 1.
    short_share : share of walkers that take a short step.

    Attributes
    ----------
    proposed, taken : numbers of independent draws proposed and accepted.
    """

    def __init__(self, proposal: Proposal, short_step: float, short_share: float):
        self.proposal, self.short_step, self.short_share = proposal, short_step, short_share
        self.proposed = self.taken = 0
        self.forget()

    def forget(self) -> None:
        """Discard the cached normal vectors of the walkers, as in a run that is resumed."""
        self._known: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None

    def _normal(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return `to_normal` of the walkers, from the last step unless another move has changed them since."""
        if self._known is not None and np.array_equal(self._known[0], points):
            return self._known[1:]
        return self.proposal.to_normal(points)

    def propose(self, model: Any, state: Any) -> "tuple[emcee.State, np.ndarray]":
        """Advance the whole ensemble; emcee asks nothing else of a move."""
        count = len(state.coords)
        normal, old_proposal = self._normal(state.coords)
        step = np.where(model.random.uniform(size=count) < self.short_share, self.short_step, 1.0)[:, None]
        fresh = np.sqrt(1 - step**2) * normal + step * model.random.normal(size=normal.shape)
        points, new_proposal = self.proposal.to_point(fresh)
        new, _ = model.compute_log_prob_fn(points)
        with np.errstate(invalid="ignore"):
            ratio = (new - new_proposal) - (state.log_prob - old_proposal)
        # A walker at zero density accepts any point of positive density; a point of zero density is never accepted.
        ratio = np.where(np.isneginf(state.log_prob), np.inf, ratio)
        ratio = np.where(np.isneginf(new) | np.isnan(ratio), -np.inf, ratio)
        accepted = np.log(model.random.uniform(size=count)) < ratio
        independent = step[:, 0] == 1
        self.proposed += int(independent.sum())
        self.taken += int(accepted[independent].sum())
        state = emcee.moves.Move().update(state, emcee.State(points, log_prob=new), accepted)
        normal = np.where(accepted[:, None], fresh, normal)
        self._known = state.coords.copy(), normal, np.where(accepted, new_proposal, old_proposal)
        return state, accepted
