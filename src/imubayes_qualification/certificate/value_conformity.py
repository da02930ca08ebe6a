"""Conformity of one measured value to its limits, for equations and certificates of the user's own.

The rules, probabilities and risks are those of the report (`evaluation.decision_rules`).
"""

import math
from dataclasses import dataclass
from typing import get_args

import numpy as np
from pydantic import BaseModel, ValidationError

from imubayes.foundations.errors import InputError, Issue, closest_first, input_error, refuse
from imubayes.foundations.records import Presented
from imubayes.foundations.tail_probabilities import normal_survival
from imubayes.results.marginal import Marginal
from imubayes_qualification.certificate.report_record import ReportedEstimate
from imubayes_qualification.certificate.specification import ProductionEntry, RuleEntry, issues_of_rule, rule_of
from imubayes_qualification.evaluation import decision_rules as rules
from imubayes_qualification.evaluation.coverage import NORMAL_FACTOR, coverage_of
from imubayes_qualification.evaluation.propagation import Propagated

Measured = Propagated | ReportedEstimate | tuple[float, float] | np.ndarray


@dataclass(frozen=True, repr=False)
class ConformityStatement(Presented):
    """A measured value against its limits.

    Attributes
    ----------
    value, uncertainty, expanded : estimate, u, and U of 95 % coverage.
    limits : lower and upper; infinite for none.
    rule : as applied.
    outcome : pass, conditional pass, conditional fail or fail; withheld if a probability that it needs is.
    guard_band : w inside each limit; None for rules on probabilities.
    acceptance : estimates with which a unit is delivered; None if none is.
    conformance : p_c, the probability that the quantity is within the limits; None if it is withheld.
    consumer_risk, producer_risk : specific risks, of the decision that was taken.
    global_consumer_risk, global_producer_risk : shares of all units tested, if the production is known.

    Examples
    --------
    >>> import imubayes
    >>> stated = imubayes.conformity((1.2, 0.1), upper=1.5, rule="simple_acceptance")
    >>> stated.outcome, round(stated.conformance, 4)
    ('pass', 0.9987)
    """

    value: float
    uncertainty: float
    expanded: float
    limits: tuple[float, float]
    rule: rules.DecisionRule
    outcome: rules.Outcome
    guard_band: float | None
    acceptance: tuple[float, float] | None
    conformance: float | None
    consumer_risk: float | None
    producer_risk: float | None
    global_consumer_risk: float | None = None
    global_producer_risk: float | None = None

    @property
    def accepted(self) -> bool:
        """Whether the unit is delivered."""
        return self.outcome in rules.ACCEPTED


def conformity(
    measured: Measured,
    *,
    lower: float = -math.inf,
    upper: float = math.inf,
    rule: rules.RuleName = "guard_band",
    factor: float | None = None,
    width: float | None = None,
    probability: float | None = None,
    production: tuple[float, float] | None = None,
    output: str = "",
) -> ConformityStatement:
    """Return whether a measured value conforms to its limits, with the risks of the decision (JCGM 106).

    Parameters
    ----------
    measured : of `propagate`; or ``report[name]``; or (estimate, u), if normal; or draws, shape (S,), S ≥ 400.
    lower, upper : limits.
    rule : of the decision: simple_acceptance, guard_band (w = 1.65 u), ilac_g8_non_binary (w = U),
        conformance_probability, specific_risk, or global_risk, which needs a production.
    factor, width : of the guard band, in u or in the unit of the quantity.
    probability : least conformance probability, or largest risk; 0.95 and 0.05.
    production : mean and standard deviation of the true values of all units tested.
    output : of the equation, if it has several.

    Raises
    ------
    InputError
        for a value that is not measured, crossed or missing limits, an unknown rule, and wrong arguments of a rule.

    Examples
    --------
    >>> import imubayes
    >>> imubayes.conformity((1.2, 0.1), upper=1.5).outcome
    'pass'
    """
    _check(measured, lower, upper, rule, production)
    tolerance = rules.ToleranceInterval(lower, upper)
    chosen = _rule(rule, factor, width, probability)
    estimate = _estimate(measured, tolerance, output, chosen)
    made = None if production is None else _production(production)
    decision = rules.applied(chosen, estimate, tolerance, made)
    accepted = rules.acceptance_interval(chosen, estimate.standard, tolerance, decision)
    overall = None if made is None else rules.global_risks(made, estimate.standard, tolerance, accepted)
    consumer, producer = rules.specific_risks(estimate.conformance.value, decision.outcome)
    return ConformityStatement(
        value=estimate.value,
        uncertainty=estimate.standard,
        expanded=estimate.expanded,
        limits=(lower, upper),
        rule=chosen,
        outcome=decision.outcome,
        guard_band=decision.guard_band,
        acceptance=None if accepted is None else (accepted.lower, accepted.upper),
        conformance=estimate.conformance.value,
        consumer_risk=consumer,
        producer_risk=producer,
        global_consumer_risk=None if overall is None else overall.consumer.from_quadrature,
        global_producer_risk=None if overall is None else overall.producer.from_quadrature,
    )


def _rule(
    name: rules.RuleName, factor: float | None, width: float | None, probability: float | None
) -> rules.DecisionRule:
    """Return the rule as a specification would state it, with the guard band of a specification without a rule."""
    if name == "guard_band" and factor is None and width is None:
        factor = rules.GUARD_FACTOR
    entry = _entry(RuleEntry, name=name, factor=factor, width=width, probability=probability)
    refuse(issues_of_rule(entry, "conformity"))
    return rule_of(entry)


def _production(stated: tuple[float, float]) -> rules.Production:
    if len(stated) != 2:
        allowed = "(mean, standard deviation) of the units tested"
        raise input_error(f"{len(stated)} numbers do not describe a production", "production", allowed, "correct it")
    entry = _entry(ProductionEntry, mean=stated[0], sd=stated[1])
    return rules.Production(entry.mean, entry.sd)


def _entry[Entry: BaseModel](record: type[Entry], **stated: str | float | None) -> Entry:
    """Return an entry of a specification with these values; raises InputError for those that it does not allow."""
    # Numbers of NumPy are numbers too.
    given = {key: float(value) if isinstance(value, np.number) else value for key, value in stated.items()}
    try:
        return record.model_validate(given)
    except ValidationError as error:
        issues = [
            Issue(f"{key} = {fault['input']}", f"conformity, {key}", fault["msg"], "correct it")
            for fault in error.errors(include_url=False)
            for key in (".".join(map(str, fault["loc"])),)
        ]
        raise InputError(issues) from error


def _estimate(
    measured: Measured, tolerance: rules.ToleranceInterval, output: str, rule: rules.DecisionRule
) -> rules.MeasuredValue:
    if isinstance(measured, tuple | ReportedEstimate):
        value, u, expanded = _stated(measured)
        if not (math.isfinite(value) and math.isfinite(u) and u > 0):
            allowed = "a finite estimate, and a standard uncertainty above 0"
            raise input_error(f"{value:g} with u = {u:g}", "measured", allowed, "correct it")
        ends = np.array([(tolerance.lower - value) / u, (tolerance.upper - value) / u])
        below = normal_survival(-ends)
        p = float(below[1] - below[0])
        return rules.MeasuredValue(value, u, expanded, rules.compared(p, p, 0.0))
    draws = _draws(measured, output) if isinstance(measured, Propagated) else np.asarray(measured, dtype=float)
    if not np.isfinite(draws).all() or not np.ptp(draws) > 0:
        raise input_error("the draws are not finite or all the same", "measured", "finite draws", "correct it")
    if isinstance(measured, Propagated):
        marginal = Marginal(draws, float(measured.effective))
        p_c = _conformance_of_draws(marginal, tolerance, rule)
    else:
        marginal = Marginal(draws, float(len(draws)))
        p_c = rules.conformance_probability(marginal, tolerance)
    stated = coverage_of(marginal)
    return rules.MeasuredValue(stated.estimate, stated.standard, stated.expanded, p_c)


def _stated(measured: tuple[float, float] | ReportedEstimate) -> tuple[float, float, float]:
    """Return y, u and U; raises InputError for an estimate that a report does not state as y ± U."""
    if isinstance(measured, tuple):
        value, u = (float(each) for each in measured)
        return value, u, NORMAL_FACTOR * u
    y, u, expanded = measured.estimate, measured.standard_uncertainty, measured.expanded_uncertainty
    if y is None or u is None or expanded is None or measured.withheld or measured.interval != "symmetric":
        what = f"the report states no y ± U of '{measured.name}'"
        allowed = "an estimate with a symmetric interval that is not withheld"
        raise input_error(what, "measured", allowed, f"give the draws: result.draws['{measured.name}']")
    return y, u, expanded


def _conformance_of_draws(
    marginal: Marginal, tolerance: rules.ToleranceInterval, rule: rules.DecisionRule
) -> rules.ProbabilityByTwoMethods:
    """Return p_c of a distribution that the draws define, withheld if their error spans the bound of the rule.

    The equation may have any distribution: that a fitted one differs from it shows nothing of the draws.
    """
    p = float(np.mean(tolerance.contains(marginal.draws)))
    error = rules.fraction_error(p, marginal.effective)
    allowed = rules.RISK_ERRORS * error
    bound = rules.least_conformance(rule)
    few = marginal.effective < rules.LEAST_EFFECTIVE or (bound is not None and abs(p - bound) <= allowed)
    return rules.ProbabilityByTwoMethods(p, p, error, allowed, "too_few_draws" if few else None)


def _check_measured(measured: object) -> None:
    """Raise InputError for what is none of the four: two numbers may be (y, u) as well as two draws."""
    if isinstance(measured, Propagated | ReportedEstimate):
        return
    if isinstance(measured, tuple):
        what = "" if len(measured) == 2 else f"{len(measured)} numbers"
    elif isinstance(measured, np.ndarray):
        shape = " × ".join(map(str, measured.shape))
        known = measured.dtype.kind in "biuf" and measured.ndim == 1 and len(measured) >= rules.LEAST_EFFECTIVE
        what = "" if known else f"an array of {shape} draws of the type {measured.dtype}"
    else:
        what = f"a {type(measured).__name__}"
    if what:
        allowed = (
            "a result of propagate; an estimate of a report; (estimate, standard uncertainty); or "
            f"{rules.LEAST_EFFECTIVE:.0f} draws or more"
        )
        raise input_error(f"{what} is not a measured value", "measured", allowed, "give one of these")


def _draws(found: Propagated, output: str) -> np.ndarray:
    names = [each.name for each in found.outputs]
    if not output and len(names) > 1:
        raise input_error("the equation has several outputs", "output", ", ".join(names), "name one of them")
    return found.draws[:, found.outputs.index(found[output]) if output else 0]


def _check(
    measured: object, lower: float, upper: float, rule: str, production: tuple[float, float] | None
) -> None:  # fmt: skip
    _check_measured(measured)
    if rule not in get_args(rules.RuleName):
        allowed = closest_first(rule, get_args(rules.RuleName))
        raise input_error(f"there is no rule '{rule}'", "rule", allowed, "name a rule")
    if (math.isinf(lower) and math.isinf(upper)) or not lower < upper:
        what = "there are no limits" if math.isinf(upper - lower) else f"the limits {lower:g} … {upper:g} are crossed"
        raise input_error(what, "lower, upper", "one of them, or lower < upper", "correct them")
    if rule == "global_risk" and production is None:
        allowed = "(mean, standard deviation) of the units tested"
        raise input_error(
            "a global risk depends on the distribution of the production", "production", allowed, "state it"
        )
