"""The population of a noise scale over units, and what is known of it in each unit given the others.

Few units determine the scatter between runs, and all of them together may still bound it only from above.  Likelihoods
are therefore taken as they are, on a grid of the logarithm x of the scale, and not as normal:

    p(yᵢ | μ, τ) = ∫ [(1 − ε) N(x | μ, τ²) + ε N(x | μ₀, σ₀²)] Lᵢ(x) dx.

The second term is a unit that is unlike the others: what is known of it is the prior of the model.  The prior of the
population mean μ is that of the model, as a normal distribution of the logarithm; the spread τ is half-normal(0, 0.5):
scales of units of one type rarely differ by more than a factor of three.
"""

from dataclasses import dataclass

import numpy as np

from imubayes_archive.population.population_laws import GridPosterior, ends, normalised, refined
from imubayes_archive.population.population_structure import CONTAMINATION

SPREAD = 0.5
"""Standard deviation of the prior of τ (convention)."""
_GRID, _MEANS, _SPREADS, _REACH, _DEPTH = 400, 49, 25, 4.0, 2


@dataclass(frozen=True)
class ScaleLikelihoods:
    """Log likelihoods of a noise scale in n units on one grid of its logarithm.

    Attributes
    ----------
    grid : shape (X,), ascending, equal steps.
    log_likelihood : shape (n, X).
    """

    grid: np.ndarray
    log_likelihood: np.ndarray

    @staticmethod
    def of(grids: np.ndarray, log_likelihoods: np.ndarray, prior: tuple[float, float]) -> "ScaleLikelihoods":
        """Return likelihoods (n, G) of their own grids (n, G) on one grid, continued linearly beyond their ends."""
        low = min(float(grids.min()), prior[0] - _REACH * prior[1])
        high = max(float(grids.max()), prior[0] + _REACH * prior[1])
        grid = np.linspace(low, high, _GRID)
        rows = [_continued(grid, own, row) for own, row in zip(grids, log_likelihoods, strict=True)]
        return ScaleLikelihoods(grid, np.array(rows) - np.max(rows, axis=1, keepdims=True))


def _continued(grid: np.ndarray, own: np.ndarray, row: np.ndarray) -> np.ndarray:
    inside = np.interp(grid, own, row)
    slopes = (row[1] - row[0]) / (own[1] - own[0]), (row[-1] - row[-2]) / (own[-1] - own[-2])
    # Beyond its ends a likelihood does not rise: nothing has been seen of it there.
    below = np.minimum(grid - own[0], 0) * max(slopes[0], 0.0)
    return inside + below + np.maximum(grid - own[-1], 0) * min(slopes[1], 0.0)


@dataclass(frozen=True)
class ScalePopulation:
    """The population of a noise scale; logarithms throughout.

    Attributes
    ----------
    posterior : of its mean and spread.
    mean, sd : shape (n,), of each unit given all units.
    others_mean, others_sd : shape (n,), of each unit given the other units alone: its prior.
    """

    posterior: GridPosterior
    mean: np.ndarray
    sd: np.ndarray
    others_mean: np.ndarray
    others_sd: np.ndarray


def scale_population(likelihoods: ScaleLikelihoods, prior: tuple[float, float]) -> ScalePopulation:
    """Return the population of a noise scale; `prior` is mean and standard deviation of the population mean."""
    step = likelihoods.grid[1] - likelihoods.grid[0]
    means = np.linspace(prior[0] - _REACH * prior[1], prior[0] + _REACH * prior[1], _MEANS)
    spreads = np.geomspace(step, _REACH * SPREAD, _SPREADS)
    for _ in range(_DEPTH):
        seen = _log_density(likelihoods, prior, means, spreads).max(axis=1)
        means = refined(means, seen, _MEANS)
    log_density = _log_density(likelihoods, prior, means, spreads)
    log_weight = log_density + np.log(np.gradient(spreads) * ends(len(spreads)))
    weight, log_evidence = normalised(log_weight.reshape(-1))
    centre, scale = (each.reshape(-1) for each in np.meshgrid(means, spreads, indexing="ij"))
    within = np.full(len(centre), (means[1] - means[0]) ** 2 / 12)
    kept = weight > 1e-8 * weight.max()
    share = weight[kept] / weight[kept].sum()
    posterior = GridPosterior(share, centre[kept], within[kept], scale[kept], np.inf, log_evidence)
    return ScalePopulation(posterior, *_of_units(likelihoods, posterior, prior))


def _kernels(grid: np.ndarray, centre: np.ndarray, scale: np.ndarray, prior: tuple[float, float]) -> np.ndarray:
    """Return the densities of a unit on the grid, (points, X)."""
    inside = np.exp(-0.5 * ((grid - centre[:, None]) / scale[:, None]) ** 2) + 1e-300
    outside = np.exp(-0.5 * ((grid - prior[0]) / prior[1]) ** 2)
    inside = inside / inside.sum(axis=1, keepdims=True)
    return (1 - CONTAMINATION) * inside + CONTAMINATION * outside / outside.sum()


def _log_density(
    likelihoods: ScaleLikelihoods, prior: tuple[float, float], means: np.ndarray, spreads: np.ndarray
) -> np.ndarray:
    """Return the log density of mean and spread, (means, spreads)."""
    centre, scale = (each.reshape(-1) for each in np.meshgrid(means, spreads, indexing="ij"))
    densities = _kernels(likelihoods.grid, centre, scale, prior) @ np.exp(likelihoods.log_likelihood).T
    log_density = np.log(densities + 1e-300).sum(axis=1)
    log_density += -0.5 * ((centre - prior[0]) / prior[1]) ** 2 - 0.5 * (scale / SPREAD) ** 2
    return log_density.reshape(len(means), len(spreads))


def _of_units(
    likelihoods: ScaleLikelihoods, posterior: GridPosterior, prior: tuple[float, float]
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return mean and sd of each unit given all units, and given the others, (n,) each."""
    grid, likelihood = likelihoods.grid, np.exp(likelihoods.log_likelihood)
    kernels = _kernels(grid, posterior.centre, np.sqrt(posterior.scale**2 + posterior.centre_variance), prior)
    own = kernels @ likelihood.T + 1e-300
    # The evidence of a unit is divided out of the weights to leave the others.
    others = posterior.weight[:, None] / own
    predictive = (others / others.sum(axis=0)).T @ kernels
    given = predictive * likelihood
    return *_moments(grid, given), *_moments(grid, predictive)


def _moments(grid: np.ndarray, density: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    share = density / density.sum(axis=1, keepdims=True)
    mean = share @ grid
    return mean, np.sqrt(np.maximum(share @ grid**2 - mean**2, 0.0))
