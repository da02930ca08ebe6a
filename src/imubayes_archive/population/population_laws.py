"""Posterior of the centre and scale of a population, by quadrature on a grid, under two laws of the population.

The estimates yᵢ with variances vᵢ come from units whose true values θᵢ are drawn from the population:

    yᵢ ~ N(θᵢ, vᵢ),    θᵢ ~ N(μ, τ²)  or  θᵢ ~ t_ν(μ, τ),

with flat priors on μ and on τ ≥ 0 (Gelman, Bayesian Analysis 1, 2006: proper posterior from three units on, hardly any
influence from five on).  Given τ, the normal law leaves μ normal in closed form, so one dimension is integrated; the t
law, a scale mixture of normal laws, needs two.  Either law may be normalised: its evidence decides between them.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy import special

from imubayes.foundations.tail_probabilities import normal_survival

_POINTS = 400
# Log density below the maximum at which a grid ends.  Numerical: e⁻²⁵ of the mass of a short tail.
_DEPTH = 25.0
# Grid of ln λ, where τ²/λ is the variance of a unit under the t law: the trapezoidal rule is exact to seven digits for
# values up to some 10³ τ away.
_LOG_MIXING = np.linspace(-18.0, 4.0, 38)
_SIDE, _COARSE = 33, 17
_TINY = 1e-300


@dataclass(frozen=True)
class GridPosterior:
    """Posterior of centre and scale on a grid of G points.

    Attributes
    ----------
    weight : shape (G,), sums to 1.
    centre, centre_variance : shape (G,), the centre given the scale is normal.
    scale : shape (G,).
    freedom : degrees of freedom ν of the t law; infinite for the normal law.
    log_evidence : logarithm of the integral of the likelihood over the flat priors.
    """

    weight: np.ndarray
    centre: np.ndarray
    centre_variance: np.ndarray
    scale: np.ndarray
    freedom: float
    log_evidence: float

    def in_unit(self, centre: float, width: float) -> "GridPosterior":
        """Return the posterior of centre + width times the quantity."""
        return replace(
            self, centre=centre + width * self.centre, centre_variance=width**2 * self.centre_variance,
            scale=width * self.scale,
        )  # fmt: skip

    def of_centre(self) -> tuple[float, float]:
        """Return mean and standard deviation of the centre."""
        mean = float(self.weight @ self.centre)
        return mean, float(np.sqrt(self.weight @ (self.centre_variance + (self.centre - mean) ** 2)))

    def of_scale(self, factor: float = 1.0) -> tuple[float, float]:
        """Return mean and standard deviation of `factor` times the scale."""
        mean = float(self.weight @ self.scale)
        return factor * mean, factor * float(np.sqrt(self.weight @ (self.scale - mean) ** 2))

    def centre_quantile(self, probability: float) -> float:
        """Return a quantile of the centre."""
        return normal_mixture_quantile(probability, self.weight, self.centre, np.sqrt(self.centre_variance))

    def scale_interval(self, mass: float, factor: float = 1.0) -> tuple[float, float]:
        """Return the shortest interval that holds `mass` of `factor` times the scale; it reaches 0 if τ may be 0."""
        scale, place = np.unique(self.scale, return_inverse=True)
        weight = np.bincount(place, self.weight)
        edges = np.concatenate([[max(0.0, 1.5 * scale[0] - 0.5 * scale[1])], (scale[1:] + scale[:-1]) / 2, scale[-1:]])
        below = np.concatenate([[0.0], np.cumsum(weight)])
        starts = np.linspace(0.0, 1.0 - mass, 201)
        low, high = np.interp(starts, below, edges), np.interp(starts + mass, below, edges)
        best = int(np.argmin(high - low))
        return factor * float(low[best]), factor * float(high[best])


def normal_mixture_quantile(probability: float, weight: np.ndarray, mean: np.ndarray, sd: np.ndarray) -> float:
    """Return a quantile of a mixture of normal distributions, by bisection."""
    low, high = float(np.min(mean - 40 * sd)), float(np.max(mean + 40 * sd))
    for _ in range(80):
        middle = 0.5 * (low + high)
        if weight @ normal_survival((mean - middle) / sd) < probability:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


def normal_law(estimate: np.ndarray, variance: np.ndarray) -> GridPosterior:
    """Return the posterior under the normal law.

    Parameters
    ----------
    estimate, variance : shape (n,), n ≥ 3, of the units, the prior of their model divided out.
    """
    scale = _scales(estimate, variance)
    log_density, centre, precision = _at_scales(estimate, variance, scale)
    constant = 0.5 * (1 - len(estimate)) * np.log(2 * np.pi)
    log_weight = constant + log_density + np.log(np.gradient(scale) * ends(len(scale)))
    weight, log_evidence = normalised(log_weight)
    return GridPosterior(weight, centre, 1 / precision, scale, np.inf, log_evidence)


def _at_scales(
    estimate: np.ndarray, variance: np.ndarray, scale: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the log density of each scale up to a constant, and centre and precision of the estimates there, (S,)."""
    total = variance + scale[:, None] ** 2
    precision = np.sum(1 / total, axis=1)
    centre = np.sum(estimate / total, axis=1) / precision
    misfit = np.sum((estimate - centre[:, None]) ** 2 / total, axis=1)
    return -0.5 * (np.log(precision) + np.sum(np.log(total), axis=1) + misfit), centre, precision


def _scales(estimate: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """Return a grid of τ from 0 to where the posterior has vanished, linear at first and geometric in the tail."""
    unit = np.sqrt(np.median(variance)) / len(estimate) + np.std(estimate) + 1e-300
    coarse = unit * np.sinh(np.linspace(0.0, np.arcsinh(1e7), 1200)) * 1e-3
    seen = _at_scales(estimate, variance, coarse)[0]
    kept = np.flatnonzero(seen > seen.max() - _DEPTH)
    low, high = coarse[max(kept[0] - 1, 0)], coarse[min(kept[-1] + 1, len(coarse) - 1)]
    # Equal steps of asinh(τ/c) about the mode: dense where the mass is, however long the tail.
    mode, width = coarse[int(np.argmax(seen))], _width(coarse, seen)
    steps = np.linspace(np.arcsinh((low - mode) / width), np.arcsinh((high - mode) / width), _POINTS)
    return np.maximum(mode + width * np.sinh(steps), 0.0)


def _width(scale: np.ndarray, log_density: np.ndarray) -> float:
    """Return half the width of the region within two of the largest log density."""
    near = np.flatnonzero(log_density > log_density.max() - 2)
    return float(max(scale[min(near[-1] + 1, len(scale) - 1)] - scale[max(near[0] - 1, 0)], 1e-300)) / 2


def ends(count: int) -> np.ndarray:
    """Return the factors of the trapezoidal rule: the first and last points stand for half a step."""
    factor = np.ones(count)
    factor[[0, -1]] = 0.5
    return factor


def normalised(log_weight: np.ndarray) -> tuple[np.ndarray, float]:
    """Return weights that sum to 1, and the logarithm of their sum before."""
    log_evidence = float(np.logaddexp.reduce(log_weight))
    return np.exp(log_weight - log_evidence), log_evidence


def student_law(estimate: np.ndarray, variance: np.ndarray, freedom: float) -> GridPosterior:
    """Return the posterior under the t law with `freedom` degrees of freedom; arguments as of `normal_law`."""
    middle = float(np.median(estimate))
    spread = float(np.median(np.abs(estimate - middle))) / 0.6745 + float(np.sqrt(np.median(variance))) * 1e-3
    reach = 8 * np.sqrt((spread**2 + np.median(variance)) / len(estimate)) + 1e-300
    centres, scales = np.linspace(middle - reach, middle + reach, _COARSE), np.linspace(0.0, 3 * spread, _COARSE)
    for side in (_COARSE, _SIDE):
        seen = _student_density(estimate, variance, freedom, centres, scales)
        centres = refined(centres, seen.max(axis=1), side)
        scales = np.maximum(refined(scales, seen.max(axis=0), side), 0.0)
    log_density = _student_density(estimate, variance, freedom, centres, scales)
    step, grow = centres[1] - centres[0], np.gradient(scales) * ends(_SIDE)
    log_weight = log_density + np.log(step * grow + _TINY)
    weight, log_evidence = normalised(log_weight.reshape(-1))
    kept = weight > 1e-8 * weight.max()
    centre, scale = (each.reshape(-1)[kept] for each in np.meshgrid(centres, scales, indexing="ij"))
    within = np.full(len(centre), step**2 / 12)
    return GridPosterior(weight[kept] / weight[kept].sum(), centre, within, scale, freedom, log_evidence)


def refined(grid: np.ndarray, log_density: np.ndarray, count: int) -> np.ndarray:
    """Return a grid of so many points over the part of a grid where the density has not vanished."""
    kept = np.flatnonzero(log_density > log_density.max() - 14)
    step = grid[1] - grid[0]
    return np.linspace(grid[kept[0]] - step, grid[kept[-1]] + step, count)


def mixing(freedom: float) -> tuple[np.ndarray, np.ndarray]:
    """Return nodes λ and logarithms of weights, (K,) each: t_ν is the mixture of N(0, 1/λ) with λ ~ χ²_ν/ν."""
    half, step = freedom / 2, _LOG_MIXING[1] - _LOG_MIXING[0]
    node = np.exp(_LOG_MIXING)
    return node, half * np.log(half) - special.gammaln(half) + half * _LOG_MIXING - half * node + np.log(step)


def _student_density(
    estimate: np.ndarray, variance: np.ndarray, freedom: float, centres: np.ndarray, scales: np.ndarray
) -> np.ndarray:
    """Return the log likelihood of all units, (centres, scales)."""
    result = np.empty((len(centres), len(scales)))
    squares = (estimate - centres[:, None]) ** 2
    for place, scale in enumerate(scales):
        density = np.sum(mixture(squares, variance, scale, freedom), axis=-1)
        result[:, place] = np.sum(np.log(density + _TINY), axis=1)
    return result


def mixture(squares: np.ndarray, variance: np.ndarray, scale: float, freedom: float) -> np.ndarray:
    """Return the density of units under the t law, node by node of the mixture, (..., n, K).

    Parameters
    ----------
    squares : shape (..., n), squared distance of each unit from the centre.
    variance : shape (n,).
    """
    node, log_weight = mixing(freedom)
    total = variance[:, None] + scale**2 / node
    return np.exp(log_weight - 0.5 * np.log(2 * np.pi * total) - 0.5 * squares[..., None] / total)
