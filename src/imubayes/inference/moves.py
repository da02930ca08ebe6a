"""The emcee move that proposes from the nested Laplace approximation.

An independence proposal with exact Metropolis–Hastings weights: the posterior stays exact whatever the quality of the
approximation, which only decides how often a proposal is taken.
"""

from collections.abc import Callable

import emcee
import equinox as eqx
import jax
import numpy as np
from emcee.moves import Move

from imubayes.inference.laplace import NestedLaplace, draw, log_proposal
from imubayes.model.likelihood import Problem, log_density
from imubayes.types import Array, Float

_draw = eqx.filter_jit(
    lambda approximation, problem, normal, side: jax.vmap(lambda one, two: draw(approximation, problem, one, two))(
        normal, side
    )
)
_log_proposal = eqx.filter_jit(
    lambda approximation, problem, points: jax.vmap(lambda one: log_proposal(approximation, problem, one))(points)
)


@eqx.filter_jit
def _log_density(problem: Problem, points: Float[Array, "n PH"]) -> Float[Array, " n"]:
    size = problem.size[0]
    return jax.vmap(lambda one: log_density(problem, one[:size], one[size:]))(points)


class LogDensity:
    """The log density of a problem for many points at once, in z.

    Points are handed to the compiled function in batches of one size, so that it is compiled once.  What is not a
    number counts as impossible; +∞ is an error, since a sampler would take it for the best of all points.
    """

    def __init__(self, problem: Problem, batch: int):
        self.problem, self.batch = problem, batch
        self.evaluations = 0

    def __call__(self, points: np.ndarray) -> np.ndarray:
        count = len(points)
        self.evaluations += count
        padded = np.concatenate([points, np.repeat(points[-1:], -count % self.batch, axis=0)])
        parts = [
            np.asarray(_log_density(self.problem, padded[start : start + self.batch]))
            for start in range(0, len(padded), self.batch)
        ]
        values = np.concatenate(parts)[:count]
        if np.any(values == np.inf):
            raise FloatingPointError("the log density is +∞ at a sampled point")
        return np.where(np.isnan(values), -np.inf, values)


class LaplaceProposal:
    """Draws from the nested Laplace approximation, and its log density, for whole ensembles."""

    def __init__(self, approximation: NestedLaplace, problem: Problem):
        self.approximation, self.problem = approximation, problem

    def draw(self, random: np.random.RandomState, count: int) -> np.ndarray:
        """Return `count` draws, shape (count, P + H)."""
        parameters, hyperparameters = self.problem.size
        normal = random.normal(size=(count, parameters + hyperparameters))
        side = random.uniform(size=(count, hyperparameters))
        return np.array(_draw(self.approximation, self.problem, normal, side))

    def log_density(self, points: np.ndarray) -> np.ndarray:
        """Return the log density of the proposal at points, shape (n, P + H)."""
        return np.array(_log_proposal(self.approximation, self.problem, points))


class IndependenceMove(Move):
    """Replace every walker by an independent draw, with probability min(1, p′q/(p q′))."""

    def __init__(self, draw: Callable, log_density: Callable):
        self.draw, self.log_density = draw, log_density
        self.proposed = self.taken = 0

    def propose(self, model, state):
        """Advance the whole ensemble; see `emcee.moves.Move`."""
        count = len(state.coords)
        points = self.draw(model.random, count)
        new, _ = model.compute_log_prob_fn(points)
        with np.errstate(invalid="ignore"):
            ratio = new - state.log_prob + self.log_density(state.coords) - self.log_density(points)
        # A walker at zero density takes whatever is possible; nothing impossible is ever taken.
        ratio = np.where(np.isneginf(state.log_prob), np.inf, ratio)
        ratio = np.where(np.isneginf(new) | np.isnan(ratio), -np.inf, ratio)
        accepted = np.log(model.random.uniform(size=count)) < ratio
        self.proposed += count
        self.taken += int(accepted.sum())
        proposal = emcee.State(points, log_prob=new)
        return self.update(state, proposal, accepted), accepted
