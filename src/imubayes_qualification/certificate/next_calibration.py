"""When the next calibration is due: the limits of a specification, and the drift between two calibrations."""

import math
from pathlib import Path

import numpy as np

from imubayes.foundations.errors import input_error
from imubayes.foundations.units import DAYS_PER_YEAR
from imubayes.results.repeatability import MOST_INTERVALS, ComparedQuantity, NextDue, Repeatability
from imubayes.results.result import Result
from imubayes_qualification.budgets.unit_under_test import unit_under_test
from imubayes_qualification.certificate.conformity import resolved_limits
from imubayes_qualification.certificate.specification import read_specification

_EXPANDED = 2.0  # coverage factor
_STEPS = 2000


def next_calibrations(found: Repeatability, later: Result, limits: Path) -> tuple[NextDue, ...]:
    """Return when each quantity with limits reaches them, soonest first.

    Parameters
    ----------
    found : two calibrations compared.
    later : the result of the second one.
    limits : file of a specification.

    Raises
    ------
    InputError
        if the calibrations have no dates, or the later one is first.
    """
    if not found.days or found.days < 0:
        raise input_error(
            "a drift needs the dates of both calibrations, the later one second",
            "start of the runs in campaign.toml",
            "start = 2026-01-31T08:00:00Z in the first run of each",
            "state them, or exchange the results",
        )
    compared = {each.name: each for each in found.quantities}
    dues = [
        next_due(each, found.days, limit.tolerance.lower, limit.tolerance.upper)
        for limit in resolved_limits(*read_specification(limits), unit_under_test(later))
        if (each := compared.get(limit.quantity.name)) is not None and each.unit == limit.quantity.unit
    ]
    return tuple(sorted(dues, key=lambda due: float("inf") if due.days is None else due.days))


def next_due(found: ComparedQuantity, days: float, lower: float, upper: float) -> NextDue:
    """Return when a quantity reaches a limit; `days` between both calibrations, infinite limits if there is none.

    The drift is taken as even from the first calibration on, so that the value t after the second is
    x₂ + (x₂ − x₁) t / D, with the uncertainty of both and what they have in common.
    """
    common = 0.5 * (found.first_sd**2 + found.second_sd**2 - found.difference_sd**2)
    drift = found.second - found.first
    share = np.linspace(0.0, MOST_INTERVALS, _STEPS)
    variance = ((1 + share) * found.second_sd) ** 2 + (share * found.first_sd) ** 2 - 2 * share * (1 + share) * common
    reach = _EXPANDED * np.sqrt(np.maximum(variance, 0.0))
    value = found.second + drift * share
    outside = (value + reach > upper) | (value - reach < lower)
    at = float(share[int(np.argmax(outside))]) * days if outside.any() else None
    return NextDue(
        name=found.name,
        unit=found.unit,
        rate=drift * DAYS_PER_YEAR / days,
        rate_sd=found.difference_sd * DAYS_PER_YEAR / days,
        lower=lower if math.isfinite(lower) else None,
        upper=upper if math.isfinite(upper) else None,
        days=at,
    )
