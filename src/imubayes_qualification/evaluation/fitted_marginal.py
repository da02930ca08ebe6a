"""A smooth distribution fitted to the draws of one quantity: the second method of every risk.

It is the sinh-arcsinh normal of Jones & Pewsey (Biometrika 96, 2009): x = ξ + η sinh((arsinh z + ε)/δ) with z standard
normal.  ε skews it, δ weighs both tails, and ε = 0, δ = 1 is the normal distribution.  It is fitted by maximum
likelihood.  Four numbers smooth over the noise of the draws.  A quantity of one sign that crowds at zero, such as a
small angle, has a logarithm closer to such a distribution.
"""

import math
from dataclasses import dataclass

import numpy as np
import scipy  # loads its parts when they are first used

from imubayes.foundations.numerics import gauss_legendre

# Nodes of the quadrature, and how far beyond the draws an infinite end is placed, in standard normals.
_NODES, _FAR = 400, 8.0
# The smooth marginal is fitted to the draws of each tail and to so many means of successive draws between them, which
# moves its probabilities by less than 1e-5.
_TAIL, _MIDDLE = 500, 1000
# Log density below which a draw no longer counts in the fit of the marginal.
_LEAST_LOG_DENSITY = -1e3


@dataclass(frozen=True)
class FittedMarginal:
    """A sinh-arcsinh normal distribution of a quantity x, or of log|x| if x has one sign.

    Attributes
    ----------
    location, scale, skewness, tail : ξ, η > 0, ε and δ > 0.
    sign : 0 if x itself has the distribution; ±1 where log(±x) has it.
    """

    location: float
    scale: float
    skewness: float = 0.0
    tail: float = 1.0
    sign: int = 0

    def log_density(self, y: np.ndarray) -> np.ndarray:
        """Return the log density of y, which is x or log|x|, of the same shape."""
        standard = (y - self.location) / self.scale
        angle = self.tail * np.arcsinh(standard) - self.skewness
        slope = np.log(self.tail * np.cosh(angle)) - 0.5 * np.log1p(standard**2) - np.log(self.scale)
        return slope - 0.5 * np.sinh(angle) ** 2 - 0.5 * np.log(2 * np.pi)

    def slopes(self, y: np.ndarray) -> np.ndarray:
        """Return the derivatives of the log density by ξ, log η, ε and log δ, shape (4, …)."""
        standard = (y - self.location) / self.scale
        stretched = self.tail * np.arcsinh(standard)
        by_angle = np.tanh(stretched - self.skewness) - 0.5 * np.sinh(2 * (stretched - self.skewness))
        by_standard = by_angle * self.tail / np.hypot(1.0, standard) - standard / (1 + standard**2)
        return np.stack([-by_standard / self.scale, -by_standard * standard - 1, -by_angle, 1 + by_angle * stretched])

    def probability(self, lower: float, upper: float) -> float:
        """Return the probability of an interval of x, which may be infinite, by Gauss–Legendre quadrature."""
        if self.sign:
            ends = sorted((self.sign * lower, self.sign * upper))
            lower, upper = (math.log(end) if end > 0 else -math.inf for end in ends)
        far = (self.location + self.scale * np.sinh((np.arcsinh(z) + self.skewness) / self.tail) for z in (-_FAR, _FAR))
        low, high = (float(edge) for edge in far)
        low, high = max(lower, low), min(upper, high)
        if not high > low:
            return 0.0
        # In arsinh of the standardised value the density is smooth on the scale of the nodes, whatever its tails.
        ends = np.arcsinh((np.array([low, high]) - self.location) / self.scale)
        nodes, weights = gauss_legendre(_NODES)
        half = (ends[1] - ends[0]) / 2
        angle = ends[0] + half * (nodes + 1)
        values = np.exp(self.log_density(self.location + self.scale * np.sinh(angle))) * self.scale * np.cosh(angle)
        return float(np.clip(half * np.sum(weights * values), 0.0, 1.0))


def fitted_to(draws: np.ndarray) -> FittedMarginal:
    """Return the marginal of maximum likelihood of draws: of the quantity or, if likelier, of its logarithm.

    Parameters
    ----------
    draws : shape (S,), in increasing order.

    Raises
    ------
    ValueError
        if the draws do not vary.
    """
    if not np.std(draws) > 0:
        raise ValueError("draws that do not vary have no density")
    values, weight = _condensed(draws)
    plain, height = _likeliest(values, weight, 0)
    sign = int(np.sign(draws[0]))
    if not np.all(sign * draws > 0) or sign == 0:
        return plain
    logarithm = np.log(sign * values)
    bounded, log_height = _likeliest(logarithm, weight, sign)
    return bounded if log_height - float(weight @ logarithm) > height else plain


def _condensed(draws: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return values and weights, of sum 1, that stand for draws in increasing order."""
    count = len(draws)
    if count <= 2 * _TAIL + _MIDDLE:
        return draws, np.full(count, 1 / count)
    starts = np.linspace(_TAIL, count - _TAIL, _MIDDLE, endpoint=False).astype(int)
    starts = np.concatenate([np.arange(_TAIL), starts, np.arange(count - _TAIL, count)])
    size = np.diff(np.append(starts, count))
    return np.add.reduceat(draws, starts) / size, size / count


def _likeliest(values: np.ndarray, weight: np.ndarray, sign: int) -> tuple[FittedMarginal, float]:
    """Return the marginal of maximum likelihood of values with weights, (S,) each, and its mean log density."""
    centre = float(weight @ values)
    spread = float(np.sqrt(weight @ (values - centre) ** 2))
    standard = (values - centre) / spread

    def loss(parameters: np.ndarray) -> tuple[float, np.ndarray]:
        location, log_scale, skewness, log_tail = parameters
        own = FittedMarginal(location, float(np.exp(log_scale)), skewness, float(np.exp(log_tail)))
        with np.errstate(over="ignore", invalid="ignore"):
            height, slopes = own.log_density(standard), own.slopes(standard)
            usable = height > _LEAST_LOG_DENSITY
            total = weight @ np.where(usable, height, _LEAST_LOG_DENSITY)
            return -float(total), -np.where(usable, slopes, 0.0) @ weight

    limits = [(-20, 20), (-8, 4), (-6, 6), (-2.5, 2.5)]
    found = scipy.optimize.minimize(loss, np.zeros(4), method="L-BFGS-B", jac=True, bounds=limits)
    location, log_scale, skewness, log_tail = (float(each) for each in found.x)
    scale = spread * math.exp(log_scale)
    fitted = FittedMarginal(centre + spread * location, scale, skewness, math.exp(log_tail), sign)
    return fitted, -float(found.fun) - math.log(spread)
