"""Spreads that the units determine only together: what is known of one of them, the others not held.

If runs determine the sum of a scale factor and a mounting angle, the units determine the sum of the two variances.
Given one spread the other looks known, and which of the two gets the scatter depends on where the search began.  The
posterior of such a spread is therefore integrated over the others, and so are the units given the population.

With the precisions Gᵢ of `joint_population`, the Fisher information on log τ is 2 τₚ² τ_q² Σᵢ (Gᵢ)²ₚ_q.  The slope of
the marginal likelihood is the expectation of the slope of the joint one (Fisher's identity):

    ∂ log p(y) / ∂ log τₚ = Σᵢ (E[(θᵢₚ − μₚ − eᵢₚ)²] / τₚ² − 1).

On a grid of τₚ the other spreads are at their most probable values by Fisher scoring, with their Laplace factor.
Priors of spreads are flat, as for a single parameter.
"""

from dataclasses import dataclass

import numpy as np

from imubayes_archive.population.joint_population import JointPopulation
from imubayes_archive.population.population_laws import GridPosterior, normalised

CONFOUNDED = 0.25
"""Share of the information on the logarithm of a spread that the other spreads take, above which they are not held
(effort: below it the standard deviation of the logarithm would grow by less than a sixth)."""
_PRIOR = 0.1
"""Information on the logarithm of a spread that keeps the matrix regular."""
_REACH, _POINTS = (0.03, 8.0), 32
_SCORING, _SETTLED, _LONGEST = 8, 0.02, 1.0


@dataclass(frozen=True)
class SpreadMarginal:
    """What is known of a spread and of its parameter, the other spreads not held; in units of the prior.

    Attributes
    ----------
    posterior : of the population mean and of the spread.
    mean, sd : shape (n,), of each unit given the population.
    """

    posterior: GridPosterior
    mean: np.ndarray
    sd: np.ndarray


def spread_information(joint: JointPopulation) -> np.ndarray:
    """Return the Fisher information on the logarithms of the spreads, (P, P)."""
    return 2 * np.einsum("np,npq,nq->pq", 1 / joint.precision, joint.gains**2, 1 / joint.precision)


def confounded(joint: JointPopulation) -> np.ndarray:
    """Return the parameters whose spreads are determined only together, (K,)."""
    return np.flatnonzero(taken_by_others(joint) > CONFOUNDED)


def taken_by_others(joint: JointPopulation) -> np.ndarray:
    """Return the share of the information on each spread that the other spreads take, (P,)."""
    information = spread_information(joint) + _PRIOR * np.eye(len(joint.variance))
    return 1 - 1 / (np.diag(information) * np.diag(np.linalg.inv(information)))


def spread_marginal(joint: JointPopulation, place: int, together: np.ndarray, freedom: float) -> SpreadMarginal:
    """Return what is known of one spread, those that are determined only together not held.

    Parameters
    ----------
    joint : the population with its most probable spreads.
    place : of the parameter.
    together : shape (K,), the parameters whose spreads are determined only together.
    freedom : degrees of freedom of its law; infinite for the normal law.
    """
    others = together[together != place]
    total = joint.variance[place] + joint.variance[others].sum()
    scale = np.sqrt(min(total, 1.0)) * np.geomspace(*_REACH, _POINTS)
    log_density, fitted = np.empty(_POINTS), list[JointPopulation]()
    found = joint
    for k, each in enumerate(scale):
        found, log_density[k] = _others_fitted(found.with_variances(np.array([place]), np.array([each**2])), others)
        fitted.append(found)
    weight, log_evidence = normalised(log_density + np.log(np.gradient(scale)))
    centre, centre_variance = (np.array(part) for part in zip(*(_of_mean(each, place) for each in fitted), strict=True))
    own, sd = (np.stack([each.given[part][:, place] for each in fitted]) for part in (0, 1))
    mean = weight @ own
    variance = weight @ (sd**2 + (own - mean) ** 2)
    posterior = GridPosterior(weight, centre, centre_variance, scale, freedom, log_evidence)
    return SpreadMarginal(posterior, mean, np.sqrt(variance))


def _of_mean(joint: JointPopulation, place: int) -> tuple[float, float]:
    mean, covariance = joint.means
    return float(mean[place]), float(covariance[place, place])


def _others_fitted(joint: JointPopulation, others: np.ndarray) -> tuple[JointPopulation, float]:
    """Return the population with the most probable spreads of others, and the log density with these integrated."""
    value = _log_density(joint, others)
    for _ in range(_SCORING if len(others) else 0):
        slope = spread_slope(joint)[others] + 1
        information = spread_information(joint)[np.ix_(others, others)] + np.eye(len(others))
        step = np.linalg.solve(information, slope)
        step *= min(1.0, _LONGEST / np.max(np.abs(step)))
        while True:
            tried = joint.with_variances(others, joint.variance[others] * np.exp(2 * step))
            better = _log_density(tried, others)
            if better > value or np.max(np.abs(step)) < _SETTLED:
                break
            step = step / 4
        if better <= value:
            break
        joint, value = tried, better
        if np.max(np.abs(step)) < _SETTLED:
            break
    information = spread_information(joint)[np.ix_(others, others)] + np.eye(len(others))
    return joint, value - 0.5 * float(np.linalg.slogdet(information)[1])


def _log_density(joint: JointPopulation, others: np.ndarray) -> float:
    """Return the log marginal likelihood with the flat priors of other spreads, in their logarithms."""
    return log_marginal(joint) + 0.5 * float(np.sum(np.log(joint.variance[others])))


def log_marginal(joint: JointPopulation) -> float:
    """Return the log likelihood of the spreads, units and means integrated, up to a constant."""
    mean, covariance = joint.means
    centre = mean + joint.offsets
    linear = joint.units.linear + joint.precision * centre
    fit = np.einsum("np,npq,nq->", linear, joint.conditional, linear) - np.sum(joint.precision * centre**2)
    determinants = np.linalg.slogdet(joint.conditional)[1].sum() + np.sum(np.log(joint.precision))
    return 0.5 * float(fit + determinants - mean @ mean + np.linalg.slogdet(covariance)[1])


def spread_slope(joint: JointPopulation) -> np.ndarray:
    """Return the slope of `log_marginal` by the logarithms of the spreads, (P,)."""
    mean, covariance = joint.means
    apart = joint.given[0] - mean - joint.offsets
    by_mean = joint.conditional * joint.precision[:, None, :] - np.eye(len(mean))
    shared = np.einsum("npq,qr,npr->np", by_mean, covariance, by_mean)
    square = apart**2 + np.einsum("npp->np", joint.conditional) + shared
    return np.sum(joint.precision * square - 1, axis=0)
