"""Conformance probability of a quantity, by two methods that have to agree.

JCGM 106 defines p_c as the posterior probability that the quantity is within its tolerance interval.  The draws give it
as a fraction with a Monte Carlo error; quadrature over the fitted marginal gives it again.  Where the two differ by
more than the errors allow, the number is withheld: the reader gets the reason instead.
"""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from imubayes.qualification.marginal import Marginal
from imubayes.qualification.tolerances import LEAST_EFFECTIVE, RISK_ERRORS, RISK_SHAPE

Withheld = Literal["disagreement", "too_few_draws"]


@dataclass(frozen=True)
class ToleranceInterval:
    """Limits of a quantity; an infinite one is none."""

    lower: float = -math.inf
    upper: float = math.inf

    def contains(self, values: np.ndarray) -> np.ndarray:
        """Return whether each value is within the limits, shape as given, bool."""
        return (values >= self.lower) & (values <= self.upper)

    def guarded(self, width: float) -> "ToleranceInterval":
        """Return the acceptance interval with a guard band of this width inside each limit (JCGM 106, 8.3)."""
        return ToleranceInterval(self.lower + width, self.upper - width)


@dataclass(frozen=True)
class ProbabilityByTwoMethods:
    """A probability from draws and from quadrature.

    Attributes
    ----------
    from_draws, from_quadrature : of the two methods.
    error : Monte Carlo standard error of the first.
    allowed : largest difference between the two.
    withheld : why no value is stated; None where one is.
    """

    from_draws: float
    from_quadrature: float
    error: float
    allowed: float
    withheld: Withheld | None

    @property
    def value(self) -> float | None:
        """The probability; None where it is withheld."""
        return None if self.withheld is not None else self.from_draws


def compared(
    from_draws: float, from_quadrature: float, error: float, effective: float = math.inf
) -> ProbabilityByTwoMethods:
    """Return a probability found by two methods, withheld where they disagree or where draws are too few."""
    allowed = RISK_ERRORS * error + RISK_SHAPE
    withheld: Withheld | None = None
    if not abs(from_draws - from_quadrature) <= allowed:
        withheld = "disagreement"
    elif effective < LEAST_EFFECTIVE:
        withheld = "too_few_draws"
    return ProbabilityByTwoMethods(from_draws, from_quadrature, error, allowed, withheld)


def fraction_error(fraction: float, effective: float) -> float:
    """Return the Monte Carlo standard error of a fraction of so many independent draws.

    With one success and one failure added, so that a fraction of 0 or 1 has an error too.
    """
    smoothed = (fraction * effective + 1) / (effective + 2)
    return math.sqrt(smoothed * (1 - smoothed) / (effective + 2))


def conformance_probability(marginal: Marginal, tolerance: ToleranceInterval) -> ProbabilityByTwoMethods:
    """Return p_c: the posterior probability that a quantity is within its tolerance interval (JCGM 106, 7.1)."""
    inside = float(np.mean(tolerance.contains(marginal.draws)))
    error = fraction_error(inside, marginal.effective)
    if not marginal.sd > 0:
        return compared(inside, inside, 0.0, marginal.effective)
    smooth = marginal.smooth.probability(tolerance.lower, tolerance.upper)
    return compared(inside, smooth, error, marginal.effective)
