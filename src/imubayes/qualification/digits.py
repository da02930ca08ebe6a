"""How many digits of a number its Monte Carlo error leaves: the numerical tolerance of JCGM 101.

A standard uncertainty u = c · 10^l, c an integer of one or two digits, is stated to its last digit when nothing in the
computation moves it by more than δ = ½ · 10^l (JCGM 101, 7.9.2).  Sampling has delivered that digit when twice the
Monte Carlo standard error of mean, standard deviation and both ends of the interval is at most δ (7.9.4).
"""

from dataclasses import dataclass
from typing import Literal

from imubayes.qualification.marginal import Marginal

Statistic = Literal["mean", "sd", "low", "high"]
Digits = Literal[1, 2]


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
    return int(f"{uncertainty:.{digits - 1}e}".partition("e")[2]) - (digits - 1)


def numerical_tolerance(uncertainty: float, digits: int) -> float:
    """Return δ = ½ · 10^l of a standard uncertainty stated to one or two significant digits (JCGM 101, 7.9.2)."""
    return 0.5 * 10.0 ** last_digit(uncertainty, digits)


def draws_needed(marginal: Marginal, digits: Digits) -> float:
    """Return how many times the draws so many digits need: twice the largest Monte Carlo error is then δ."""
    return (2 * marginal.errors.largest / numerical_tolerance(marginal.sd, digits)) ** 2


def digits_deserved(marginal: Marginal) -> DeservedDigits:
    """Return the digits that the draws of a quantity deserve.  A quantity that does not vary is exact: two digits."""
    errors: dict[Statistic, float] = {
        "mean": marginal.errors.mean,
        "sd": marginal.errors.sd,
        "low": marginal.errors.low,
        "high": marginal.errors.high,
    }
    worst = max(errors, key=lambda statistic: errors[statistic])
    error = 2 * errors[worst]
    if not marginal.sd > 0:
        return DeservedDigits(2, 0.0, 0.0, worst)
    for digits in (2, 1):
        tolerance = numerical_tolerance(marginal.sd, digits)
        if error <= tolerance:
            return DeservedDigits(digits, tolerance, error, worst)
    return DeservedDigits(0, numerical_tolerance(marginal.sd, 1), error, worst)
