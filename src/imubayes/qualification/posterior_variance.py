"""Posterior variances by control variates.

The variance of some thousand draws is known to two per cent, which is what a budget has to add up to.  The linear part
u of a quantity q has a variance V that is known (`imubayes.qualification.linear_part`), so V + (s²(q) − s²(u)), both
sample variances of the same draws, has the Monte Carlo error of the difference alone: that of the nonlinear part.
V is the variance of u under the nested Laplace approximation.  Where the sampled u contradict it by more than their
Monte Carlo error allows, the posterior is not that of the approximation and the sample variance itself is taken: the
curvature that Gauss–Newton neglects, for one, changes widths by some per cent.

The slope of q on u, 1 where q is linear, holds what odd orders add to the linear part (statistical linearisation).
What is left is regressed on the second-order part likewise: that of a function of quantities is taken from its members,
and the length of a vector, say, bends otherwise than they do.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from imubayes.qualification.linear_part import LinearPart, QuantityDerivatives, second_order, unbent
from imubayes.qualification.tolerances import CONTRADICTION_ERRORS, MOST_WIDENED

# Relative spread below which a quantity does not vary.
_ROUNDING = 1e-13


@dataclass(frozen=True)
class PosteriorDraws:
    """Posterior draws.

    Attributes
    ----------
    z, h : shapes (S, P) and (S, H), parameters and noise scales, in z.
    values : quantity → shape (S,), in its unit; NaN where it was not computed.
    effective : quantity → effective number of its draws.
    """

    z: np.ndarray
    h: np.ndarray
    values: Mapping[str, np.ndarray]
    effective: Mapping[str, float]


@dataclass(frozen=True)
class PosteriorVariances:
    """Variances of Q quantities.

    Attributes
    ----------
    posterior, error : shapes (Q,), posterior variance, and its Monte Carlo standard error.
    slope : shape (Q,), of the quantity on its linear part.
    widened : shape (Q,), standard deviation of the sampled linear part over that of the approximation where the two
        contradict each other but are alike; else 1.
    second_order : shape (Q,), variance of what the second-order part explains of the rest.
    """

    posterior: np.ndarray
    error: np.ndarray
    slope: np.ndarray
    widened: np.ndarray
    second_order: np.ndarray

    @property
    def scale(self) -> np.ndarray:
        """Factors (Q,) on the variances of the linear part of the approximation."""
        return (self.slope * self.widened) ** 2


def posterior_variances(
    part: LinearPart,
    derivatives: QuantityDerivatives,
    known: np.ndarray,
    known_error: np.ndarray,
    draws: PosteriorDraws,
) -> PosteriorVariances:
    """Return the posterior variances of the quantities of `draws`, in their order.

    Parameters
    ----------
    part : of the posterior of θ.
    derivatives : of the quantities.
    known, known_error : shapes (Q,), variance of the linear part, and its error.
    draws : of the posterior.
    """
    delta, w = unbent(part, draws.z)
    linear = delta @ derivatives.gradient.T
    found = []
    for place, (name, values) in enumerate(draws.values.items()):
        of_linear = KnownVariance(float(known[place]), float(known_error[place]))
        variance = _variance(values, linear[:, place], of_linear, draws.effective[name])
        rest = values - variance[2] * linear[:, place]
        found.append((*variance, _explained(rest, second_order(part, derivatives, place, w))))
    return PosteriorVariances(*np.array(found).reshape(-1, 5).T)


def _explained(rest: np.ndarray, part: np.ndarray) -> float:
    """Return the variance of draws (S,) that their regression on a part of them, (S,), explains."""
    finite = np.isfinite(rest)
    about, along = (each[finite] - each[finite].mean() for each in (rest, part))
    square = float(along @ along)
    return float(about @ along) ** 2 / square / max(len(along), 1) if square > 0 else 0.0


@dataclass(frozen=True)
class KnownVariance:
    """The variance of a linear part, and its error: it is an average over draws of the noise scales."""

    value: float
    error: float


def _variance(
    values: np.ndarray, linear: np.ndarray, known: KnownVariance, effective: float
) -> tuple[float, float, float, float]:
    """Return the variance of draws (S,), its Monte Carlo error, the slope on the linear part (S,), and its widening.

    The linear part serves as control variate.
    """
    finite = np.isfinite(values)
    if not values[finite].std() > _ROUNDING * np.max(np.abs(values[finite])):
        return 0.0, 0.0, 1.0, 1.0
    about, along = (each[finite] - each[finite].mean() for each in (values, linear))
    q, u = about**2, along**2
    effective = min(effective, float(len(q)))
    errors = {"plain": q.std(), "linear": u.std(), "difference": (q - u).std()}
    plain, of_linear, of_difference = (float(error) / np.sqrt(effective) for error in errors.values())
    agrees = abs(float(u.mean()) - known.value) <= CONTRADICTION_ERRORS * np.hypot(of_linear, known.error)
    if agrees and of_difference < plain:
        slope = float(np.mean(about * along) / u.mean())
        return known.value + float((q - u).mean()), float(np.hypot(of_difference, known.error)), slope, 1.0
    widened = float(np.sqrt(u.mean() / known.value)) if not agrees and known.value > 0 else 1.0
    if max(widened, 1 / max(widened, _ROUNDING)) > MOST_WIDENED:
        widened = 1.0
    slope = float(np.mean(about * along) / u.mean()) if widened != 1.0 else 1.0
    return float(q.mean()), plain, slope, widened
