"""How well a proposal covers the posterior, from importance weights of independent draws.

A chain of independent proposals stays as long at a point as its weight w = posterior/proposal is large, and where w is
large it rarely comes: a short chain that looks converged may never have seen such a place.  The weights of draws tell
it before the chain does.  Their tail has the index k̂ of a generalised Pareto distribution: above 0.7 no number of
draws that is practical represents the posterior (Vehtari, Simpson, Gelman, Yao & Gabry 2024).  The largest weight is
the number of steps for which a walker stays where it was found, and so the measure of how long a chain has to be.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import lazy_loader
import numpy as np

from imubayes.inference.laplace_move import Proposal

if TYPE_CHECKING:
    import arviz_stats.base.array
else:
    arviz_stats = lazy_loader.load("arviz_stats")  # takes long to import, and only sampling needs it

# Above this index of the weights' tail their variance is infinite, and neither weighted moments nor their errors mean
# anything.  A scatter that a proposal follows to first order alone gives 0.5 to 0.9.
PARETO_K = 0.5
# Where the largest weight of 4000 draws is below this, the rarest place drawn holds a quarter of a per cent of the
# posterior, and how the weights are distributed below it does not matter.
LARGEST_WEIGHT = 10.0
# Weights that differ by less are those of the posterior itself, and have no tail.
_ALIKE = 1e-6
# How many times the draws where the tail of the weights matters.  The index of 4000 weights, from the 190 of its tail,
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
    log_mass : logarithm of the mean weight before it was made 1, the integral of the density where draws met it.
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
    def mass_error(self) -> float:
        """Relative standard error of the mass that was found."""
        return float(self.weight.std() / np.sqrt(self.weight.size))

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
    """Return weighted draws as `weigh` does, more of them where their weights have a heavy tail."""
    weighed = weigh(log_density, proposal, pools, count, seed)
    if weighed is None or not weighed.heavy_tailed:
        return weighed
    return weigh(log_density, proposal, pools, _MORE * count, seed)


def weigh(log_density: BatchedDensity, proposal: Proposal, pools: int, count: int, seed: int) -> WeighedProposal | None:
    """Return `count` weighted draws of a proposal in each of several pools.

    None where no draw of a pool is possible.
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
    return float(arviz_stats.base.array.array_stats.psislw(-finite)[1])
