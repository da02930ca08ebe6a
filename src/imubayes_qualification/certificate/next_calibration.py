"""When the next calibration is due: the limits of a specification, and the drift between two calibrations."""

from pathlib import Path

from imubayes.foundations.errors import input_error
from imubayes.results.repeatability import NextDue, Repeatability, next_due
from imubayes.results.result import Result
from imubayes_qualification.budgets.unit_under_test import unit_under_test
from imubayes_qualification.certificate.conformity import resolved_limits
from imubayes_qualification.certificate.specification import read_specification


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
