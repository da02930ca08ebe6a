"""The marginal posterior of one quantity: draws, a smooth distribution fitted to them, and the digits they deserve.

The draws have an effective number.  The fitted marginal is the sinh-arcsinh normal of Jones & Pewsey (Biometrika 96,
2009): x = ξ + η sinh((arsinh z + ε)/δ) with z standard normal.  ε skews it, δ weighs both tails, and ε = 0, δ = 1 is
the normal distribution.  It is fitted by maximum likelihood and serves as the second method of every risk: four numbers
smooth over the noise of the draws.  A quantity of one sign that crowds at zero, such as a small angle, has a logarithm
closer to such a distribution.

How many digits of a number its Monte Carlo error leaves follows from the numerical tolerance of JCGM 101.  A standard
uncertainty u = c · 10^l, c an integer of one or two digits, is stated to its last digit when nothing in the computation
moves it by more than δ = ½ · 10^l (JCGM 101, 7.9.2).  Sampling has delivered that digit when twice the Monte Carlo
standard error of mean, standard deviation and both ends of the interval is at most δ (7.9.4).
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
import scipy  # loads its parts when they are first used
from scipy import special

from imubayes.foundations.numerics import gauss_legendre, leading_decade
from imubayes.foundations.tail_probabilities import normal_survival

# Nodes of the quadrature, and how far beyond the draws an infinite end is placed, in standard normals.
_NODES, _FAR = 400, 8.0
_INTERVAL = (0.025, 0.975)
# The smooth marginal is fitted to the draws of each tail and to so many means of successive draws between them, which
# moves its probabilities by less than 1e-5.
_TAIL, _MIDDLE = 500, 1000
# Log density below which a draw no longer counts in the fit of the marginal.
_LEAST_LOG_DENSITY = -1e3


@dataclass(frozen=True)
class MonteCarloErrors:
    """Monte Carlo standard errors of mean, standard deviation and both ends of the coverage interval."""

    mean: float
    sd: float
    low: float
    high: float

    @property
    def largest(self) -> float:
        """The largest of the four."""
        return max(self.mean, self.sd, self.low, self.high)


@dataclass(frozen=True)
class Marginal:
    """Draws of one quantity.

    Attributes
    ----------
    draws : shape (S,), finite.
    effective : number of independent draws that carry as much information.
    """

    draws: np.ndarray
    effective: float

    @cached_property
    def mean(self) -> float:
        """The estimate: the posterior mean."""
        return float(np.mean(self.draws))

    @cached_property
    def sd(self) -> float:
        """The standard uncertainty: the posterior standard deviation."""
        return float(np.std(self.draws))

    @cached_property
    def interval(self) -> tuple[float, float]:
        """The 95 % equal-tailed coverage interval."""
        low, high = self._quantiles(np.array(_INTERVAL))
        return float(low), float(high)

    @cached_property
    def smooth(self) -> "FittedMarginal":
        """The distribution fitted to the draws; raises `ValueError` where they do not vary."""
        return fitted_to(self._in_order)

    @cached_property
    def errors(self) -> MonteCarloErrors:
        """Monte Carlo errors: of the sd by the kurtosis, of the ends by order statistics (Vehtari et al. 2021, § 4)."""
        square = (self.draws - self.mean) ** 2
        excess = float(np.mean(square * square)) / self.sd**4 if self.sd > 0 else 1.0
        of_sd = self.sd * np.sqrt(max(excess - 1, 0.0) / (4 * self.effective))
        low, high = (self._quantile_error(probability) for probability in _INTERVAL)
        return MonteCarloErrors(self.sd / np.sqrt(self.effective), float(of_sd), low, high)

    def _quantile_error(self, probability: float) -> float:
        shape = self.effective * probability + 1, self.effective * (1 - probability) + 1
        below, above = self._quantiles(special.betaincinv(*shape, normal_survival(np.array([1.0, -1.0]))))
        return float((above - below) / 2)

    @cached_property
    def _in_order(self) -> np.ndarray:
        return np.sort(self.draws)

    def _quantiles(self, probabilities: np.ndarray) -> np.ndarray:
        """Return what `numpy.quantile` does, from draws that are sorted once."""
        count = len(self.draws)
        return np.interp(probabilities * (count - 1), np.arange(count), self._in_order)


@dataclass(frozen=True)
class FittedMarginal:
    """A sinh-arcsinh normal distribution of a quantity x, or of log|x| where x has one sign.

    Attributes
    ----------
    location, scale, skewness, tail : ξ, η > 0, ε and δ > 0.
    sign : 0 where x itself has the distribution; ±1 where log(±x) has it.
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
    """Return the marginal of maximum likelihood of draws: of the quantity or, where likelier, of its logarithm.

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


Statistic = Literal["mean", "sd", "low", "high"]
Digits = Literal[1, 2]
# Share of an uncertainty that rounding may change it by (EA-4/02 M, 6.3).
_ROUNDING_SHARE = 0.05


@dataclass(frozen=True)
class DeservedDigits:
    """Significant digits of the standard uncertainty that a number deserves.

    Attributes
    ----------
    digits : 2, 1, or 0 where the number is withheld.
    tolerance : δ of those digits; of one digit where the number is withheld.
    error : twice the largest Monte Carlo error.
    worst : the statistic that has it.
    """

    digits: Literal[0, 1, 2]
    tolerance: float
    error: float
    worst: Statistic


def last_digit(uncertainty: float, digits: int) -> int:
    """Return l of u = c · 10^l, where c is an integer of so many digits."""
    return leading_decade(uncertainty, digits) - (digits - 1)


def numerical_tolerance(uncertainty: float, digits: int) -> float:
    """Return δ = ½ · 10^l of a standard uncertainty stated to one or two significant digits (JCGM 101, 7.9.2)."""
    return 0.5 * 10.0 ** last_digit(uncertainty, digits)


def draws_needed(errors: MonteCarloErrors, uncertainty: float, digits: Digits) -> float:
    """Return how many times the draws so many digits need: twice the largest Monte Carlo error is then δ."""
    return (2 * errors.largest / numerical_tolerance(uncertainty, digits)) ** 2


def digits_stated(errors: MonteCarloErrors, uncertainty: float, expanded: float) -> Literal[0, 1, 2]:
    """Return the significant digits in which u and U are stated: two (GUM 7.2.6) where the draws support these.

    Rounding to one digit may change u by half.  So one stands only where twice the Monte Carlo error of estimate or u
    is more than rounding may change u by, or that of an end of the interval U.  None where JCGM 101 grants none.
    """
    near = 2 * max(errors.mean, errors.sd) <= _ROUNDING_SHARE * uncertainty
    two = near and 2 * max(errors.low, errors.high) <= _ROUNDING_SHARE * expanded
    deserved = digits_deserved(errors, uncertainty).digits
    return 2 if deserved and two else deserved


def digits_deserved(errors: MonteCarloErrors, uncertainty: float) -> DeservedDigits:
    """Return the digits that numbers deserve.  A quantity that does not vary is exact: two digits."""
    listed: dict[Statistic, float] = {"mean": errors.mean, "sd": errors.sd, "low": errors.low, "high": errors.high}
    worst = max(listed, key=lambda statistic: listed[statistic])
    error = 2 * listed[worst]
    if not uncertainty > 0:
        return DeservedDigits(2, 0.0, 0.0, worst)
    for digits in (2, 1):
        tolerance = numerical_tolerance(uncertainty, digits)
        if error <= tolerance:
            return DeservedDigits(digits, tolerance, error, worst)
    return DeservedDigits(0, numerical_tolerance(uncertainty, 1), error, worst)
