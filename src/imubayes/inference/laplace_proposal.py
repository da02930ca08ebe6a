"""Independence proposals for the sampler, the nested Laplace approximation above all, and their importance weights.

The emcee move proposes from the approximation with exact Metropolis–Hastings weights: whatever the quality of the
approximation, the chain has the posterior as its stationary distribution; the quality decides the acceptance alone.

How well a proposal covers the posterior is determined by the importance weights of independent draws.  A chain of
independent proposals stays as long at a point as its weight w = posterior/proposal is large, and if w is large it
rarely comes: a short chain that looks converged may never have seen such a place.  The weights of draws show it before
the chain does.  Their tail has the index k̂ of a generalised Pareto distribution: above 0.7 no number of draws that is
practical represents the posterior (Vehtari, Simpson, Gelman, Yao & Gabry 2024).  The largest weight is the number of
steps for which a walker stays where it was found, and so the measure of how long a chain has to be.
"""

import importlib
import math
from collections.abc import Callable
from dataclasses import dataclass
from types import ModuleType
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import jax
import numpy as np

from imubayes.compiled.kept_programs import kept
from imubayes.foundations.arrays import Array, Float, on_device
from imubayes.foundations.deferred_modules import DeferredModule
from imubayes.inference.nested_laplace import NestedLaplace, to_normals, to_points
from imubayes.model.likelihood import log_density
from imubayes.model.problem import Problem

if TYPE_CHECKING:
    import emcee
else:
    emcee = DeferredModule("emcee")  # takes long to import, and only sampling needs it


# Points per vectorised block: larger blocks exceed the cache of a core.
_MOST_IN_BLOCK = 16


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
        self.problem, self.block = on_device(problem), math.ceil(batch / blocks)
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
        return to_points(self.approximation, self.problem, normal)

    def to_normal(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the standard normal vectors of points, (n, P + H), and the log density of the proposal, (n,)."""
        return to_normals(self.approximation, self.problem, points)

    def draw(self, random: np.random.RandomState, count: int) -> np.ndarray:
        """Return `count` independent proposals, shape (count, P + H)."""
        return self.to_point(random.normal(size=(count, self.dimensions)))[0]


class LaplaceMove:
    """Move every walker in the coordinates of the proposal, if the posterior is close to standard normal.

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


# Above this index of the weights' tail their variance is infinite, and neither weighted moments nor their errors mean
# anything.  A scatter that a proposal follows to first order alone gives 0.5 to 0.9.
PARETO_K = 0.5
# If the largest weight of 4000 draws is below this, the rarest place drawn holds a quarter of a per cent of the
# posterior, and how the weights are distributed below it does not matter.
LARGEST_WEIGHT = 10.0
# Weights that differ by less are those of the posterior itself, and have no tail.
_ALIKE = 1e-6
# How many times the draws if the tail of the weights matters.  The index of 4000 weights, from the 190 of its tail,
# has a standard error of (1 + k)/√190 = 0.12: of one proposal of index 0.54 three trials gave 0.42, 0.53 and 0.72.
_MORE = 8

# Points (n, D) → log densities (n,).
BatchedDensity = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class WeighedProposal:
    """A proposal, and draws of it with their importance weights.

    Attributes
    ----------
    proposal : what was drawn from.
    points : shape (pools, n, D), independent draws of the proposal.
    weight : shape (pools, n), posterior over proposal, of mean 1; 0 where the posterior density is 0.
    pareto_k : tail index of the weights.
    log_mass : logarithm of the mean weight before it was made 1, the integral of the density if draws met it.
    """

    proposal: Proposal
    points: np.ndarray
    weight: np.ndarray
    pareto_k: float
    log_mass: float = 0.0

    @property
    def largest(self) -> float:
        """The largest weight: the steps for which a walker stays at that point."""
        return float(self.weight.max())

    @property
    def heavy_tailed(self) -> bool:
        """Whether weights beyond those drawn may matter."""
        return self.pareto_k > PARETO_K and self.largest > LARGEST_WEIGHT

    @property
    def acceptance(self) -> float:
        """Share of independent proposals that are taken: E[min(1, w′/w)], current points w-weighted."""
        weight = np.sort(self.weight[0])
        count = len(weight)
        # In ascending order a weight is the smaller one of its pairs with all that follow, in either order, and itself.
        return float(weight @ (2 * np.arange(count, 0, -1) - 1) / (count * weight.sum())) if weight.any() else 0.0

    def resampled(self, pool: int, count: int, random: np.random.RandomState) -> np.ndarray:
        """Return draws of a pool by importance resampling, (count, D): nearly draws of the posterior."""
        share = self.weight[pool] / self.weight[pool].sum()
        return self.points[pool][systematic(share, count, random)]

    def moments(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return mean (D,) and standard deviation (D,) of the posterior, and the relative error of the latter (D,)."""
        weight = (self.weight / self.weight.sum()).reshape(-1)
        points = self.points.reshape(len(weight), -1)
        mean = weight @ points
        square = (points - mean) ** 2
        variance = weight @ square
        error = np.sqrt(weight**2 @ (square - variance) ** 2)
        return mean, np.sqrt(variance), 0.5 * error / variance


def weigh_tail(
    log_density: BatchedDensity, proposal: Proposal, pools: int, count: int, seed: int
) -> WeighedProposal | None:
    """Return weighted draws as `weigh` does, more of them if their weights have a heavy tail."""
    weighed = weigh(log_density, proposal, pools, count, seed)
    if weighed is None or not weighed.heavy_tailed:
        return weighed
    return weigh(log_density, proposal, pools, _MORE * count, seed)


def weigh(log_density: BatchedDensity, proposal: Proposal, pools: int, count: int, seed: int) -> WeighedProposal | None:
    """Return `count` weighted draws of a proposal in each of several pools.

    None if no draw of a pool is possible.
    """
    points, log_weights = [], []
    for pool in range(pools):
        random = np.random.RandomState(np.random.SeedSequence([seed, pool, 7]).generate_state(4))
        drawn, density = proposal.to_point(random.normal(size=(count, proposal.dimensions)))
        points.append(drawn)
        with np.errstate(invalid="ignore"):
            log_weights.append(log_density(drawn) - density)
    log_weight = np.stack(log_weights)
    log_weight = np.where(np.isfinite(log_weight), log_weight, -np.inf)
    best = log_weight.max()
    weight = np.exp(log_weight - best) if np.isfinite(best) else np.zeros_like(log_weight)
    if not weight.any(axis=1).all():
        return None
    mean = float(weight.mean())
    index, log_mass = pareto_k(log_weight.reshape(-1)), float(best) + float(np.log(mean))
    return WeighedProposal(proposal, np.stack(points), weight / mean, index, log_mass)


def systematic(share: np.ndarray, count: int, random: np.random.RandomState) -> np.ndarray:
    """Return `count` places in random order, each as often as its share (n,) says, to within one."""
    at = np.searchsorted(np.cumsum(share), (random.uniform() + np.arange(count)) / count)
    return random.permutation(np.minimum(at, len(share) - 1))


def pareto_k(log_weight: np.ndarray) -> float:
    """Return the tail index of importance weights from their logarithms (n,)."""
    finite = log_weight[np.isfinite(log_weight)]
    if np.ptp(finite) < _ALIKE:
        return 0.0
    # ArviZ takes the negative, as of log likelihoods that are left out.
    return float(arviz("base.array").array_stats.psislw(-finite)[1])


def arviz(module: str) -> ModuleType:
    """Return a module of `arviz_stats`, which takes long to import and only sampling needs.

    A lazily loaded module would do, but arviz_base looks at all modules when it is imported: it would import
    arviz_stats, which imports it, before it is complete.
    """
    return importlib.import_module(f"arviz_stats.{module}")
