"""How much of what is known of a population is lost because the posteriors of its units were estimated from draws.

A mean and a variance estimated from S draws are wrong by s²/S and 2s⁴/S in the mean square.  Such an error ε(Λ) of the
log likelihood of the population's parameters Λ turns its posterior p into p e^ε, up to a factor.  To second order the
Kullback–Leibler divergence between the two is half the variance of ε over the posterior.  Its expectation over the
draws is, in nats,

    ½ Σᵢ Σ_k var_k,i · Var_Λ[∂ₖ ln Lᵢ(Λ)]  +  ½ Var_Λ[½ Σᵢ Σ_k var_k,i · (∂ₖ ln Lᵢ(Λ))²],

where k runs over mean and variance of a unit.  The first term is lost precision.  The second is lost accuracy: the
logarithm of an estimate is too small by half its variance.  J. Heinzel and S. Vitale (2025, arXiv:2509.07221) define
the sum as the information error and recommend at most 0.2 bits.
"""

import numpy as np

from imubayes.batch.population_laws import GridPosterior, mixing
from imubayes.batch.unit_posteriors import UnitPosteriors

MOST_BITS = 0.2
"""Information error above which an estimate of a population is refused (Heinzel and Vitale, 2025)."""


def information_error(posterior: GridPosterior, units: UnitPosteriors) -> float:
    """Return the information error of the posterior of a population, in bits.

    Parameters
    ----------
    posterior : of centre and scale.
    units : all of them; those without information are left out.
    """
    used = units.informative & np.isfinite(units.draws)
    if not used.any():
        return 0.0
    weight = posterior.weight
    precision, bias = 0.0, np.zeros(len(weight))
    for place in np.flatnonzero(used):
        by_mean, by_variance = _sensitivities(posterior, units, int(place))
        variance, draws = units.sd[place] ** 2, units.draws[place]
        for slope, error in ((by_mean, variance / draws), (by_variance, 2 * variance**2 / draws)):
            precision += 0.5 * error * _variance(weight, slope)
            bias += 0.5 * error * (slope - weight @ slope) ** 2
    nats = precision + 0.5 * _variance(weight, bias)
    return float(nats / np.log(2))


def _variance(weight: np.ndarray, values: np.ndarray) -> float:
    return float(weight @ (values - weight @ values) ** 2)


def _sensitivities(posterior: GridPosterior, units: UnitPosteriors, place: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the derivatives of a unit's log likelihood by its posterior mean and variance, (G,) each.

    Under the normal law the centre of each grid point is integrated over: its mean stands for it, and the variance of
    the centre adds to that of the unit.
    """
    estimate, variance = (each[place] for each in units.likelihood)
    by_estimate, by_variance = _slopes(posterior, float(estimate), float(variance))
    square = units.sd[place] ** 2
    grows = (variance / square) ** 2
    moves = variance * (estimate - units.mean[place]) / square**2
    return by_estimate * variance / square, by_variance * grows + by_estimate * moves


def _slopes(posterior: GridPosterior, estimate: float, variance: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the derivatives of the log density of a unit by its estimate and by its variance, (G,) each."""
    distance = estimate - posterior.centre
    squares = distance**2 + posterior.centre_variance
    if np.isinf(posterior.freedom):
        total = variance + posterior.scale**2
        return -distance / total, 0.5 * (squares / total - 1) / total
    node, log_weight = mixing(posterior.freedom)
    total = variance + posterior.scale[:, None] ** 2 / node
    share = log_weight - 0.5 * np.log(total) - 0.5 * squares[:, None] / total
    share = np.exp(share - share.max(axis=1, keepdims=True))
    share /= share.sum(axis=1, keepdims=True)
    slope = -distance * np.sum(share / total, axis=1)
    return slope, 0.5 * np.sum(share * (squares[:, None] / total - 1) / total, axis=1)
