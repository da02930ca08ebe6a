"""The digits in which an estimate is stated: those that its Monte Carlo errors leave.

The numerical tolerance of JCGM 101, 7.9.2 and 7.9.4, is that of `imubayes.results.marginal`.
"""

from dataclasses import dataclass
from typing import Literal

from imubayes.results.marginal import MonteCarloErrors, numerical_tolerance

Statistic = Literal["mean", "sd", "low", "high"]
# Share of an uncertainty that rounding may change it by (EA-4/02 M, 6.3).
_ROUNDING_SHARE = 0.05


@dataclass(frozen=True)
class DeservedDigits:
    """Significant digits of the standard uncertainty that a number deserves.

    Attributes
    ----------
    digits : 2, 1, or 0 if the number is withheld.
    tolerance : δ of those digits; of one digit if the number is withheld.
    error : twice the largest Monte Carlo error.
    worst : the statistic that has it.
    """

    digits: Literal[0, 1, 2]
    tolerance: float
    error: float
    worst: Statistic


def digits_stated(errors: MonteCarloErrors, uncertainty: float, expanded: float) -> Literal[0, 1, 2]:
    """Return the significant digits in which u and U are stated: two (GUM 7.2.6) if the draws support these.

    Rounding to one digit may change u by half.  So one stands only if twice the Monte Carlo error of estimate or u
    is more than rounding may change u by, or that of an end of the interval U.  None if JCGM 101 grants none.
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
