"""Possible responses of a sensor to a covariate: impossible forms, and forms of an effect of the catalogue.

A form is judged by its size at the input.  Without a bound a covariate that hardly varies, such as the Earth rate on a
dividing head, explains anything by a coefficient that no sensor has.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from imubayes.criticism.evidence.free_forms import FormHypothesis, free_forms, with_prior
from imubayes.criticism.evidence.linear_problem import UNEXPECTED, LinearProblem, RowKind
from imubayes.foundations.units import to_si
from imubayes.responses.residual_covariates import ResidualCovariate

LARGEST: Mapping[RowKind, Mapping[str, float]] = {
    "gyro": {"rate": 0.1 * to_si("deg/s"), "force": 3000 * to_si("deg/h"), "temperature": 180 * to_si("deg/h")},
    "accelerometer": {"rate": to_si("mg"), "force": 0.1 * to_si("g"), "temperature": 5 * to_si("mg")},
}
"""Largest responses of poor sensors: per deg/s, per g and per °C.  Convention: three times the largest values of data
sheets."""
_LEVER_ARM = 0.5
"""Largest distance of an accelerometer from the axis of a table, m: its response to the square of a rate."""
_SAME_SPAN = 1e-3
"""Share of the squares of a form beyond the columns of an effect, up to which it is that effect.  Numerical."""


def possible_forms(problem: LinearProblem, known: Sequence[ResidualCovariate]) -> tuple[FormHypothesis, ...]:
    """Return the forms outside the catalogue that a sensor can make, with their prior probabilities."""
    found = (_possible(problem, known, each) for each in free_forms(problem, known))
    return with_prior([each for each in found if each is not None and not _is_an_effect(problem, each)], UNEXPECTED / 2)


def _possible(
    problem: LinearProblem, known: Sequence[ResidualCovariate], form: FormHypothesis
) -> FormHypothesis | None:
    """Return a form with the amplitudes that a sensor can have; None if it has none."""
    covariates = [each for each in known if each.name in form.covariates]
    largest = max((largest_amplitude(problem, k, covariates) for k in form.columns), default=np.inf)
    kept = tuple(each for each in form.amplitudes if each <= largest)
    return replace(form, amplitudes=kept) if kept else None


def largest_amplitude(problem: LinearProblem, channel: int, covariates: Sequence[ResidualCovariate]) -> float:
    """Return the largest response of a channel to the least of some covariates, in units of the noise of a row.

    It is infinite for covariates without a bound, such as the time.
    """
    rows = problem.rows[channel]
    bounds = LARGEST.get(rows.kind, {})
    found = [np.inf]
    for each in covariates:
        per_unit = next((size for name, size in bounds.items() if each.name.startswith(name)), None)
        values = each.values[rows.entry]
        values = values[np.isfinite(values)]
        if per_unit is None or not len(values) or not rows.noise:
            continue
        reach = float(np.abs(values).max() if not each.name.startswith("temperature") else np.ptp(values))
        response = per_unit * reach
        if rows.kind == "accelerometer" and each.name.startswith("rate"):
            response += _LEVER_ARM * (to_si("deg/s") * reach) ** 2
        found.append(response / rows.noise)
    return min(found)


def _is_an_effect(problem: LinearProblem, form: FormHypothesis) -> bool:
    """Return whether a linear response to a vector is what an effect of the catalogue, with its coefficients, makes."""
    if form.family != "vector":
        return False
    start, spans = problem.own, []
    for response in problem.candidates:
        spans.append(range(start, start + len(response.coefficients)))
        start += len(response.coefficients)
    return any(all(_spanned(problem, k, form, span) for k in form.columns) for span in spans)


def _spanned(problem: LinearProblem, channel: int, form: FormHypothesis, span: range) -> bool:
    rows = problem.rows[channel]
    here = np.flatnonzero((rows.live >= span.start) & (rows.live < span.stop))
    if not len(here):
        return False
    made, columns = form.columns[channel].make(), rows.columns[:, here]
    left = made - columns @ np.linalg.lstsq(columns, made)[0]
    return float(np.sum(left**2)) <= _SAME_SPAN * float(np.sum(made**2))
