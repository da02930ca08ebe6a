"""The words of the report for outcomes, rules, obstacles and verdicts, and its numbers as text."""

import math
from collections.abc import Sequence

from imubayes.criticism.explanation_records import Verdict
from imubayes.display.layout import Cell
from imubayes.display.numbers_and_labels import NO_NUMBER, listed, pretty, rounded, significant
from imubayes.foundations.covariates import REFERENCE_TEMPERATURE
from imubayes.foundations.wording import counted
from imubayes.results.marginal import last_digit
from imubayes_qualification.certificate import report_record as record
from imubayes_qualification.certificate.conformity import Obstacle
from imubayes_qualification.display.report.document import Mood
from imubayes_qualification.evaluation.coverage import NORMAL_FACTOR
from imubayes_qualification.evaluation.decision_rules import NoDecision, Outcome, RuleName, Withheld

OUTCOMES: dict[Outcome, tuple[str, Mood]] = {
    "pass": ("PASS", "good"),
    "conditional_pass": ("CONDITIONAL PASS", "weak"),
    "withheld": ("NO DECISION", "bad"),
    "conditional_fail": ("CONDITIONAL FAIL", "bad"),
    "fail": ("FAIL", "bad"),
}
OBSTACLES: dict[Obstacle, str] = {
    "not_converged": "The fit did not converge. None of its numbers may be used, and the unit cannot pass.",
    "not_diagnosed": "The model was never diagnosed: whether it describes the data is unknown, and the unit cannot "
    "pass. Run `imubayes diagnose` on the result and make the report again.",
    "inadequate_model": "The model is inadequate: the diagnosis found that it does not describe the data, so the "
    "uncertainties below are not those of the unit, and the unit cannot pass.",
    "invalid_intervals": "The noise differs from that of the model, so the coverage intervals are not valid, and the "
    "unit cannot pass.",
    "expired_standard": "The certificate of a standard had expired when runs used it, so measurements with "
    "it are not traceable, and the unit cannot pass.",
}
VERDICTS: dict[Verdict, str] = {
    "adequate": "adequate: no effect of the catalogue is missing as far as these runs can show",
    "missing_effect": "inadequate: an effect is missing",
    "equivalent_effects": "inadequate: one of several indistinguishable effects is missing, or one is probably missing",
    "unexplained_structure": "inadequate: the data show a cause that no effect of the catalogue explains",
    "noise_model": "inadequate: the noise differs from that of the model",
    "run_disagrees": "inadequate: one run does not agree with the others, and its record must be checked",
    "undetectable": "undetectable: the runs cannot show the requested effect",
    "not_converged": "none: the fit did not converge",
}
NO_DECISION: dict[NoDecision, str] = {
    "probability": "a probability that the rule needs is withheld",
    "not_determined": "less than half of the information came from the data",
    "taken_as_exact": "uncertainties of the equipment that the model takes as exact could put it beyond the limit",
    "obstacle": "the unit cannot pass, for a reason listed separately",
}
WITHHELD: dict[Withheld, str] = {
    "disagreement": "withheld: the two methods disagree",
    "too_few_draws": "withheld: too few effective draws",
}
_WITHHELD_NUMBER = (
    "Withheld: too few draws; twice the Monte Carlo error exceeds half a unit of the first digit of u (JCGM 101, 7.9)."
)
_NO_POSTERIOR: dict[record.NumberWithheld, str] = {
    "not_converged": "no convergence", "no_draws": "no draws", "monte_carlo_error": "too few draws",
}  # fmt: skip
# Share of U that is left of it by rounding, at least.
_LEAST_WRITTEN = 0.95
# Decimals of a probability, at most.
_MOST_DECIMALS = 4
_RULES: dict[RuleName, str] = {
    "simple_acceptance": "simple acceptance",
    "guard_band": "guard band",
    "ilac_g8_non_binary": "ILAC-G8 non-binary, w = U",
    "conformance_probability": "conformance probability",
    "specific_risk": "specific consumer's risk",
    "global_risk": "global consumer's risk",
}

RULE_MEANS: dict[RuleName, str] = {
    "simple_acceptance": "accepted within the limits, w = 0",
    "guard_band": "accepted within the limits less w at each, rejected otherwise",
    "ilac_g8_non_binary": "pass within the limits less w, fail beyond the limits plus w; in between, conditional "
    "pass within the limits and conditional fail beyond them",
    "conformance_probability": "accepted if p_c is at least that",
    "specific_risk": "accepted if 1 − p_c is at most that",
    "global_risk": "accepted within the limits less w at each, which the production and this risk determine",
}
"""Acceptance of a rule (ISO/IEC 17025, 7.8.6)."""


def rule_text(limit: record.LimitOutcome) -> str:
    """Return the decision rule of a limit: ``guard band, w = 1.65 u``."""
    said = _RULES[limit.rule]
    if limit.rule == "guard_band":
        if limit.guard_width is not None:
            return f"{said}, w = {significant(limit.guard_width)} {pretty(limit.unit)}"
        return f"{said}, w = " + (f"{limit.guard_factor:g} u" if limit.guard_factor is not None else "U")
    if limit.rule == "conformance_probability":
        return f"{said} ≥ {limit.rule_probability:g}"
    if limit.rule in ("specific_risk", "global_risk"):
        return f"{said} ≤ {limit.rule_probability:g}"
    return said


def stated(found: record.ReportedEstimate) -> tuple[str, str, str, str]:
    """Return estimate, standard uncertainty and both ends of the interval with the digits that they deserve."""
    if found.estimate is None or found.standard_uncertainty is None:
        return NO_NUMBER, _NO_POSTERIOR[found.withheld or "no_draws"], NO_NUMBER, NO_NUMBER
    if found.exact:
        return rounded((found.estimate,), None)[0], "0", "", ""
    u, error = found.standard_uncertainty, found.monte_carlo
    estimate, written = with_digits((found.estimate, u), u, error)
    if error is not None and error.digits == 0:
        return estimate, written, NO_NUMBER, NO_NUMBER
    low, high = rounded((found.low, found.high), _last_place(found))
    return estimate, written, low, high


Stated = record.ReportedEstimate | record.LimitOutcome


def value_text(found: Stated) -> str:
    """Return what is stated of a quantity: y ± U; y [low; high], its interval, if this is not symmetric."""
    error, u = found.monte_carlo, found.standard_uncertainty
    if found.estimate is None or u is None:
        why = found.withheld if isinstance(found, record.ReportedEstimate) else None
        return _NO_POSTERIOR[why or "no_draws"]
    if error is None:
        return rounded((found.estimate,), None)[0]
    if error.digits == 0:
        return ": ".join(with_digits((), u, error))
    y, whole, low, high = _rounded(found)
    return f"{y} ± {whole}" if found.interval == "symmetric" else f"{y} [{low}; {high}]"


def _rounded(found: Stated) -> tuple[str, ...]:
    """Return y, U and both ends of the interval to the last place of U."""
    expanded, step = (
        found.expanded_uncertainty or NORMAL_FACTOR * (found.standard_uncertainty or 0.0),
        _last_place(found),
    )
    return rounded((found.estimate, _not_below(expanded, step), found.low, found.high), step)


def uncertainties_text(found: record.ReportedEstimate) -> str:
    """Return u, k and U of a quantity, or u and the kind of its interval, in the digits of its tables."""
    u, unit = stated(found)[1], pretty(found.unit)
    if found.interval != "symmetric":
        return f"u = {u} {unit}, 95 % interval {found.interval}"
    return f"u = {u} {unit}, k = {factor_text(found)}, U = {_rounded(found)[1]} {unit} (95 %)"


def _last_place(found: Stated) -> float:
    """Return a number whose second digit is the last that is stated: that of U, or the first one of u."""
    u, error = found.standard_uncertainty or 0.0, found.monte_carlo
    return 10 * u if error is not None and error.digits == 1 else found.expanded_uncertainty or NORMAL_FACTOR * u


def digits_text(lines: Sequence[Stated]) -> str:
    """Return in how many digits u and U of a table are stated, those with one by name, and why others are withheld."""
    errors = [(line.name, line.monte_carlo) for line in lines if line.monte_carlo is not None]
    few = [name for name, error in errors if error.digits == 1]
    said = "u and U have two significant digits (GUM 7.2.6)"
    said += f", and one if the Monte Carlo error supports no more: {enumerated(few)}." if few else "."
    return f"{said} {_WITHHELD_NUMBER}" if any(not error.digits for _, error in errors) else said


def _not_below(expanded: float, step: float) -> float:
    """Return what U is rounded from: more than it if rounding would take over a twentieth of it (EA-4/02, 6.3)."""
    written = float(rounded((expanded,), step)[0])
    if written >= _LEAST_WRITTEN * expanded:
        return expanded
    return written + 10.0 ** last_digit(step, 2)


def factor_text(found: Stated) -> str:
    """Return the coverage factor of y ± U; what the interval is if there is none."""
    if found.monte_carlo is None or found.monte_carlo.digits == 0:
        return NO_NUMBER
    if found.interval == "symmetric":
        return f"{found.coverage_factor or NORMAL_FACTOR:.2f}"
    return found.interval or NO_NUMBER


def more_draws_text(report: record.QualificationReport) -> str:
    """Return how many numbers are withheld for too few draws and what gives them; empty if none is."""
    errors = [line.monte_carlo for line in report.estimates if line.withheld == "monte_carlo_error"]
    needed = max((error.draws_needed for error in errors if error is not None), default=0.0)
    if not errors:
        return ""
    return (
        f"note: {counted(len(errors), 'number')} withheld, because there are too few draws; "
        f"{significant(needed + 0.05, 2)} times as many are needed: `imubayes fit … --until-digits 1` draws until none "
        "is withheld"
    )


def reference_temperature(report: record.QualificationReport) -> str:
    """Return T_ref of the thermal effects of the model with its unit; each by effect if they differ."""
    stated = {
        effect.name: effect.options["reference_degC"]
        for effect in report.provenance.effects
        if "reference_degC" in effect.options
    }
    if len(set(stated.values()) | {REFERENCE_TEMPERATURE}) == 1:
        return f"{REFERENCE_TEMPERATURE:g} °C"
    others = (f"{value:g} °C of {name}" for name, value in stated.items() if value != REFERENCE_TEMPERATURE)
    return f"{REFERENCE_TEMPERATURE:g} °C, {', '.join(others)}"


def beside(estimate: str, u: str) -> str:
    """Return an estimate with its standard uncertainty, or why they are withheld."""
    return f"{estimate} (u = {u})" if u[0].isdigit() else f"{estimate}: {u}"


def with_digits(
    values: tuple[float | None, ...], uncertainty: float, error: record.MonteCarloError | None
) -> tuple[str, ...]:
    """Return numbers, u the second of them, with the digits that u deserves; or that they are withheld, and why."""
    if error is not None and error.digits == 0:
        return ("withheld", _NO_POSTERIOR["monte_carlo_error"], *(NO_NUMBER for _ in values[2:]))
    return tuple(rounded(values, uncertainty * (1 if error is None or error.digits == 2 else 10)))


def interval_text(found: record.ReportedEstimate) -> str:
    """Return the coverage interval; empty for an exact quantity."""
    _, _, low, high = stated(found)
    return low if found.withheld is not None or not low else f"{low} … {high}"


def probability_text(found: record.Probability | None) -> Cell:
    """Return a probability, or why it is withheld."""
    if found is None:
        return Cell(NO_NUMBER)
    if found.value is None:
        assert found.withheld is not None, "a value is withheld for a reason"
        return Cell(WITHHELD[found.withheld], "bad")
    return Cell(chance(found.value, found.monte_carlo_error))


def chance(value: float, error: float) -> str:
    """Return a probability to the digit that its Monte Carlo error begins at, four decimals at most; never 0 or 1."""
    decimals = min(_MOST_DECIMALS, max(1, -math.floor(math.log10(error)))) if error > 0 else _MOST_DECIMALS
    least = 10.0**-decimals
    if value > 1 - least:
        return f"> {1 - least:.{decimals}f}"
    return f"{value:.{decimals}f}" if value >= least else f"< {least:.{decimals}f}"


def risk_text(risk: float | None) -> str:
    """Return a risk in per cent; an en dash if there is none."""
    if risk is None:
        return NO_NUMBER
    return f"{significant(100 * risk, 2)} %" if risk >= 1e-4 else "< 0.01 %"


def limits_text(limit: record.LimitOutcome) -> str:
    """Return the tolerance interval: ``-20 … 20``, ``≤ 5``."""
    lower, upper = limit.lower, limit.upper
    if lower is None:
        return f"≤ {_plain(upper)}"
    return f"≥ {_plain(lower)}" if upper is None else f"{_plain(lower)} … {_plain(upper)}"


def _plain(value: float | None) -> str:
    return NO_NUMBER if value is None else f"{value:.10g}"


def hash_text(digest: str) -> str:
    """Return a hash in groups that a line can break between."""
    return " ".join(digest[place : place + 16] for place in range(0, len(digest), 16))


def enumerated(names: Sequence[str], most: int = 12) -> str:
    """Return names as a phrase, the rest counted; a word for none."""
    return listed(names, most) or "none"
