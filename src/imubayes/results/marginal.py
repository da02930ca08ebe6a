"""The marginal posterior of one quantity: its draws, their Monte Carlo errors, and the draws that digits need.

The draws have an effective number.  How many digits of a number its Monte Carlo error leaves follows from the numerical
tolerance of JCGM 101.  A standard uncertainty u = c · 10^l, c an integer of one or two digits, is stated to its last
digit when nothing in the computation moves it by more than δ = ½ · 10^l (JCGM 101, 7.9.2).  Sampling has delivered that
digit when twice the Monte Carlo standard error of mean, standard deviation and both ends of the interval is at most δ
(7.9.4).
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from scipy import special

from imubayes.foundations.numerics import leading_decade
from imubayes.foundations.tail_probabilities import normal_survival

Digits = Literal[1, 2]
"""Significant digits of a standard uncertainty."""
_INTERVAL = (0.025, 0.975)


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


def last_digit(uncertainty: float, digits: int) -> int:
    """Return l of u = c · 10^l, where c is an integer of so many digits."""
    return leading_decade(uncertainty, digits) - (digits - 1)


def numerical_tolerance(uncertainty: float, digits: int) -> float:
    """Return δ = ½ · 10^l of a standard uncertainty stated to one or two significant digits (JCGM 101, 7.9.2)."""
    return 0.5 * 10.0 ** last_digit(uncertainty, digits)


def draws_needed(errors: MonteCarloErrors, uncertainty: float, digits: Digits) -> float:
    """Return how many times the draws so many digits need: twice the largest Monte Carlo error is then δ."""
    return (2 * errors.largest / numerical_tolerance(uncertainty, digits)) ** 2
