"""When a quantity may leave its limits, by the drift between two calibrations: when the next one is due.

The drift is taken as even from the first calibration on, so that the value t after the second is
x₂ + (x₂ − x₁) t / D, with the uncertainty of both and what they have in common.  Two calibrations fix a straight line
and cannot test it: the interval is stated with that reservation, and for ten times the time between them at most.  A
drift of several calibrations is one of `batch trends`.
"""

import math
from typing import NamedTuple

import numpy as np

from imubayes.foundations.records import Record
from imubayes.foundations.units import DAYS_PER_YEAR

MOST_INTERVALS = 10.0
EXPANDED = 2.0  # coverage factor
_STEPS = 2000


class NextDue(Record):
    """Drift of a quantity with limits, in its unit.

    Attributes
    ----------
    rate, rate_sd : drift per year, and its standard uncertainty.
    lower, upper : limits; None where there is none.
    days : after the second calibration, until the value with its expanded uncertainty (k = 2) reaches a limit; None
        where it does not within ten times the days between both.
    """

    name: str
    unit: str
    rate: float
    rate_sd: float
    lower: float | None
    upper: float | None
    days: float | None


class TwoEstimates(NamedTuple):
    """A quantity by two calibrations: estimates and standard uncertainties, and that of their difference."""

    first: float
    first_sd: float
    second: float
    second_sd: float
    difference_sd: float


def next_due(name: str, unit: str, found: TwoEstimates, days: float, lower: float, upper: float) -> NextDue:
    """Return when a quantity reaches a limit; `days` between both calibrations, infinite limits where there is none."""
    common = 0.5 * (found.first_sd**2 + found.second_sd**2 - found.difference_sd**2)
    drift = found.second - found.first
    share = np.linspace(0.0, MOST_INTERVALS, _STEPS)
    variance = ((1 + share) * found.second_sd) ** 2 + (share * found.first_sd) ** 2 - 2 * share * (1 + share) * common
    reach = EXPANDED * np.sqrt(np.maximum(variance, 0.0))
    value = found.second + drift * share
    outside = (value + reach > upper) | (value - reach < lower)
    at = float(share[int(np.argmax(outside))]) * days if outside.any() else None
    return NextDue(
        name=name,
        unit=unit,
        rate=drift * DAYS_PER_YEAR / days,
        rate_sd=found.difference_sd * DAYS_PER_YEAR / days,
        lower=lower if math.isfinite(lower) else None,
        upper=upper if math.isfinite(upper) else None,
        days=at,
    )
