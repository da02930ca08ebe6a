"""Conformity of a unit: each limit of a specification held against the posterior of its quantity.

A limit over a temperature range is met if the quantity is within it at every temperature; its conformance
probability is that of the smallest margin over the range, and its decision is the worst over the range.  Of a quantity
that the data do not determine there is no decision: its posterior is its prior, which the unit was not asked about.

The outcome is given for each limit and for the unit.  It is a statement about the unit only if the posterior is one:
a unit cannot pass on a model that the diagnosis found inadequate or has not seen, nor on intervals that the noise does
not support.
"""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from imubayes import Diagnosis
from imubayes.campaign.toml_documents import Ledger
from imubayes.foundations.errors import InputError, closest_first
from imubayes.foundations.quantity_names import QuantityName, family_of
from imubayes.foundations.units import same_dimension, to_si
from imubayes.results.marginal import Marginal
from imubayes.results.result import Result
from imubayes.results.summary import CombinationSummary, Quantity
from imubayes.results.temperature_range import TEMPERATURES_OF_RANGE
from imubayes_qualification.budgets.unit_under_test import RangeDraws, TestedUnit, is_measured, unit_under_test
from imubayes_qualification.certificate.limits_over_range import (
    branches_over_range,
    scatter_of_next_run,
    shifts_over_range,
)
from imubayes_qualification.certificate.specification import LimitEntry, SpecificationFile, read_specification, rule_of
from imubayes_qualification.evaluation import decision_rules as rules
from imubayes_qualification.evaluation.coverage import Coverage, coverage_of

WORST_FIRST: tuple[rules.Outcome, ...] = ("fail", "withheld", "conditional_fail", "conditional_pass", "pass")
# Temperatures of a chamber are not those of its plan: a range is covered if runs came this close to its ends, °C.
_NEAR = 2.0


@dataclass(frozen=True)
class ResolvedLimit:
    """A limit of one quantity in the quantity's unit."""

    quantity: Quantity
    tolerance: rules.ToleranceInterval
    rule: rules.DecisionRule
    span: tuple[float, float] | None
    production: rules.Production | None
    nominal: float | None


@dataclass(frozen=True)
class ConformityOfQuantity:
    """The outcome for one limit.

    Attributes
    ----------
    limit : in the unit of the quantity.
    estimate, stated, marginal : at the worst temperature of the range.
    temperature : that temperature, °C; None without a range or without dependence on it.
    conformance : p_c over the whole range.
    decision : outcome with the guard band.
    consumer, producer : specific risks: of delivering a unit that does not conform if it is accepted, of rejecting
        one that does if it is not; None if it does not apply or is withheld.
    overall : global risks, if the production is known.
    omitted_ratio : factor on U, at the temperature of `stated`, by what the model takes as exact and no U contains.
    """

    limit: ResolvedLimit
    estimate: rules.MeasuredValue
    stated: Coverage
    marginal: Marginal
    temperature: float | None
    conformance: rules.ProbabilityByTwoMethods
    decision: rules.Decision
    consumer: float | None
    producer: float | None
    overall: rules.GlobalRisks | None
    omitted_ratio: float = 1.0


def resolved_limits(
    file: SpecificationFile, ledger: Ledger, unit: TestedUnit, path: tuple[str, ...] = ("limit",),
    left_out: Collection[int] = (),
) -> tuple[ResolvedLimit, ...]:  # fmt: skip
    """Return the limits of a specification, one per quantity, in the units of the quantities.

    Parameters
    ----------
    path : of the list of limits in its file.
    left_out : places of limits in the list that are not looked at.

    Raises
    ------
    InputError
        with every unknown quantity, unit of another dimension, and temperature range that the runs do not cover.
    """
    found: list[ResolvedLimit] = []
    for place, entry in enumerate(file.limit):
        if place in left_out:
            continue
        names = members_of(entry.quantity, unit.quantities.entries)
        if not names:
            families = dict.fromkeys(family_of(name) for name in unit.quantities.entries)
            options = unit.quantities.entries if QuantityName.of(entry.quantity).labels else families
            ledger.add(
                f"the result has no quantity '{entry.quantity}'",
                (*path, place, "quantity"),
                closest_first(entry.quantity, options),
                "name a quantity that the model estimates; `imubayes fit` lists them",
            )
            continue
        _check_temperatures(entry, place, ledger, unit)
        found += [
            limit
            for name in names
            if (limit := _resolved(entry, file, unit.quantities.entries[name], (*path, place), ledger, unit))
        ]
    ledger.stop_if_any()
    return tuple(found)


def members_of(asked: str, entries: Mapping[str, Quantity]) -> list[str]:
    """Return the quantities of a name, or of a family.

    A sum of several quantities is of no family, though it begins with the name of one: it may hold errors of the
    equipment, and has limits if it is named in full.
    """
    sums = {name for name, line in entries.items() if isinstance(line, CombinationSummary) and not line.standard}
    return [name for name in entries if asked == name or (asked == family_of(name) and name not in sums)]


def _check_temperatures(entry: LimitEntry, place: int, ledger: Ledger, unit: TestedUnit) -> None:
    if entry.temperature_degC is None:
        return
    low, high = entry.temperature_degC
    known = unit.temperatures
    if known is None or low < known[0] - _NEAR or high > known[1] + _NEAR:
        tested = "no run recorded one" if known is None else f"the runs cover {known[0]:.4g} … {known[1]:.4g} degC"
        ledger.add(
            f"the limit of '{entry.quantity}' holds from {low:g} to {high:g} degC, where there are no data",
            ("limit", place, "temperature_degC"),
            tested,
            "test the unit over the range, or state the range that was tested",
        )


def _resolved(
    entry: LimitEntry,
    file: SpecificationFile,
    quantity: Quantity,
    path: tuple[str | int, ...],
    ledger: Ledger,
    unit: TestedUnit,
) -> ResolvedLimit | None:
    where = (*path, "unit")
    try:
        factor, shift = _conversion(entry, quantity, ledger.where(*where), unit.gravity)
    except InputError as error:
        if not any(issue == known for issue in error.issues for known in ledger.issues):
            ledger.issues.extend(error.issues)
        return None
    if factor is None and any(issue.where == ledger.where(*where) for issue in ledger.issues):
        return None
    if factor is None:
        own = " (the output unit of the channel)" if quantity.unit == "output" else ""
        relative = "; ppm and % if the limit states 'nominal'" if entry.nominal is None else ", ppm, %"
        allowed = f"{quantity.unit}{own}{relative}"
        ledger.add(
            f"{quantity.name} cannot be stated in the unit '{entry.unit}'",
            where,
            allowed,
            "write the limits in one of these units",
        )
        return None
    lower, upper = _ends(entry, factor, shift)
    if _below_all_values(quantity.name, upper, unit, path, ledger):
        return None
    made = entry.production
    return ResolvedLimit(
        quantity=quantity,
        tolerance=rules.ToleranceInterval(lower, upper),
        rule=rule_of(entry.rule or file.rule, abs(factor)),
        span=(entry.temperature_degC[0], entry.temperature_degC[1]) if entry.temperature_degC else None,
        production=None if made is None else rules.Production(shift + factor * made.mean, abs(factor) * made.sd),
        nominal=entry.nominal,
    )


def _below_all_values(name: str, upper: float, unit: TestedUnit, path: tuple[str | int, ...], ledger: Ledger) -> bool:
    """Return whether no value of a quantity could meet its upper limit, which is then an issue."""
    impossible = name in unit.nonnegative and upper < 0
    if impossible:
        ledger.add(
            f"the upper limit of {name} is below 0, but this quantity cannot be negative",
            (*path, "upper"),
            "an upper limit of 0 or more",
            "correct the sign or the quantity",
        )
    return impossible


def _ends(entry: LimitEntry, factor: float, shift: float) -> tuple[float, float]:
    """Return the limits in the unit of the quantity; a negative factor, of a negative nominal value, exchanges them."""
    lower = -math.inf if entry.lower is None else entry.lower
    upper = math.inf if entry.upper is None else entry.upper
    low, high = sorted((shift + factor * lower, shift + factor * upper))
    return low, high


def _conversion(entry: LimitEntry, quantity: Quantity, where: str, gravity: float) -> tuple[float | None, float]:
    """Return factor and shift from the unit of a limit to that of its quantity; no factor if it has no such unit."""
    if entry.nominal is not None and entry.unit != quantity.unit and same_dimension(entry.unit, "1", where):
        return entry.nominal * to_si(entry.unit, gravity, where), entry.nominal
    shift = entry.nominal or 0.0
    if entry.unit == quantity.unit:
        return 1.0, shift
    if " per " in quantity.unit or not same_dimension(entry.unit, quantity.unit, where):
        return None, shift
    return to_si(entry.unit, gravity, where) / to_si(quantity.unit, gravity), shift


def conformity(limit: ResolvedLimit, unit: TestedUnit) -> ConformityOfQuantity:
    """Return the outcome for one limit."""
    name, effective = limit.quantity.name, unit.quantities.effective[limit.quantity.name]
    drawn = _drawn(limit, unit)
    values, omitted = drawn.values, _omitted(limit, unit, drawn.values.shape[1])
    over = _conformance_over(values, limit.tolerance, effective)
    marginals = [Marginal(column, effective) for column in values.T]
    stated = [unit.coverage(name)] if limit.span is None else unit.coverage_at(name, drawn)
    estimates = [_estimate(each, over) for each in stated]
    decisions = _decisions(limit, unit, values, omitted, estimates)
    worst = min(range(len(estimates)), key=lambda place: _rank(decisions[place], estimates[place], limit.tolerance))
    estimate, decision = estimates[worst], decisions[worst]
    consumer, producer = rules.specific_risks(over.value, decision.outcome)
    production = limit.production
    return ConformityOfQuantity(
        limit=limit,
        estimate=estimate,
        stated=stated[worst],
        marginal=marginals[worst],
        temperature=_temperature(limit, worst, len(estimates)),
        conformance=over,
        decision=decision,
        consumer=consumer,
        producer=producer,
        overall=None if production is None else _overall(production, estimate.standard, limit, decision),
        omitted_ratio=_ratio(float(np.linalg.norm(omitted[:, worst])), estimate.standard),
    )


def _ratio(omitted: float, own: float) -> float:
    return math.hypot(1.0, omitted / own) if own > 0 else 1.0


def _drawn(limit: ResolvedLimit, unit: TestedUnit) -> RangeDraws:
    """Return the draws of the quantity of a limit at the temperatures of its range, or at one."""
    name, draws = limit.quantity.name, unit.quantities.draws
    centre, scatter = draws[name][:, None], np.zeros(len(draws[name]))
    if limit.span is not None:
        centre = branches_over_range(name, limit.quantity.unit, draws, unit.thermal, limit.span)
        scatter = scatter_of_next_run(name, limit.quantity.unit, draws, unit.thermal)
    known = np.isfinite(centre).all(axis=1) & np.isfinite(scatter)
    made = RangeDraws(centre[known], np.repeat(scatter[known][:, None], centre.shape[1], axis=1))
    return made if limit.span is None else unit.with_floor(name, made)


def _omitted(limit: ResolvedLimit, unit: TestedUnit, count: int) -> np.ndarray:
    """Return what independent causes that no U contains do to the quantity at its T temperatures, (r, T)."""
    name = limit.quantity.name
    if limit.span is None or count == 1 or not unit.jointly:
        return np.full((1, count), unit.unstated.get(name, 0.0))
    draws = unit.quantities.draws
    found = shifts_over_range(name, limit.quantity.unit, draws, unit.thermal, limit.span, unit.jointly)
    return np.tile(found, (1, count // found.shape[1]))  # the same on both branches


def _decisions(
    limit: ResolvedLimit,
    unit: TestedUnit,
    values: np.ndarray,
    omitted: np.ndarray,
    estimates: Sequence[rules.MeasuredValue],
) -> list[rules.Decision]:
    """Return the decision at each temperature; none on what was not measured, or could fail by equipment."""
    name = limit.quantity.name
    decisions = [rules.applied(limit.rule, each, limit.tolerance, limit.production) for each in estimates]
    if not is_measured(limit.quantity, unit.quantities.draws[name]):
        return [replace(decision, outcome="withheld", withheld="not_determined") for decision in decisions]
    if not any(each.outcome in rules.ACCEPTED for each in decisions):
        return decisions
    if _passes_with_exact(limit, values, omitted, unit.quantities.effective[name]):
        return decisions
    return [_without_pass(each, "taken_as_exact") for each in decisions]


def _overall(
    production: rules.Production, standard: float, limit: ResolvedLimit, decision: rules.Decision
) -> rules.GlobalRisks:
    """Return the global risks of the rule as it is applied."""
    accepted = rules.acceptance_interval(limit.rule, standard, limit.tolerance, decision)
    return rules.global_risks(production, standard, limit.tolerance, accepted)


def _without_pass(decision: rules.Decision, reason: rules.NoDecision) -> rules.Decision:
    """Return a decision that is none if it would pass, for a reason."""
    accepted = decision.outcome in rules.ACCEPTED
    return replace(decision, outcome="withheld", withheld=reason) if accepted else decision


def _passes_with_exact(limit: ResolvedLimit, values: np.ndarray, omitted: np.ndarray, effective: float) -> bool:
    """Return whether draws (S, T) would be accepted with what is taken as exact at its plausible size, (r, T)."""
    if not omitted.any():
        return True
    moved = values + np.random.default_rng(20260502).standard_normal((len(values), len(omitted))) @ omitted
    over = _conformance_over(moved, limit.tolerance, effective)
    estimates = [_estimate(coverage_of(Marginal(column, effective)), over) for column in moved.T]
    decisions = [rules.applied(limit.rule, each, limit.tolerance, limit.production) for each in estimates]
    return all(each.outcome in rules.ACCEPTED for each in decisions)


def _temperature(limit: ResolvedLimit, worst: int, count: int) -> float | None:
    if limit.span is None or count == 1:
        return None
    return float(np.linspace(*limit.span, TEMPERATURES_OF_RANGE)[worst % TEMPERATURES_OF_RANGE])


def _rank(
    decision: rules.Decision, estimate: rules.MeasuredValue, tolerance: rules.ToleranceInterval
) -> tuple[int, float]:
    margin = min(estimate.value - tolerance.lower, tolerance.upper - estimate.value)
    return WORST_FIRST.index(decision.outcome), margin


def _conformance_over(
    values: np.ndarray, tolerance: rules.ToleranceInterval, effective: float
) -> rules.ProbabilityByTwoMethods:
    """Return p_c of a quantity over a range, (S, T): of the smallest margin; of the quantity if there is one T."""
    if values.shape[1] == 1:
        return rules.conformance_probability(Marginal(values[:, 0], effective), tolerance)
    margin = np.minimum(values - tolerance.lower, tolerance.upper - values).min(axis=1)
    return rules.conformance_probability(Marginal(margin, effective), rules.ToleranceInterval(lower=0.0))


def _estimate(stated: Coverage, conformance: rules.ProbabilityByTwoMethods) -> rules.MeasuredValue:
    return rules.MeasuredValue(stated.estimate, stated.standard, stated.expanded, conformance)


def overall_outcome(found: Sequence[ConformityOfQuantity]) -> rules.Outcome:
    """Return the worst outcome of all limits."""
    outcomes: list[rules.Outcome] = ["pass", *(each.decision.outcome for each in found)]
    return min(outcomes, key=WORST_FIRST.index)


Obstacle = Literal["not_converged", "not_diagnosed", "inadequate_model", "invalid_intervals", "expired_standard"]


@dataclass(frozen=True)
class Assessment:
    """What a specification says of a unit.

    Attributes
    ----------
    specification : its name.
    limits : outcome for each limit.
    obstacles : why the unit cannot pass, whatever the limits say; empty if nothing stands against it.
    """

    specification: str
    limits: tuple[ConformityOfQuantity, ...]
    obstacles: tuple[Obstacle, ...]

    @property
    def outcome(self) -> rules.Outcome:
        """The worst outcome of all limits, and no better than `withheld` if there is an obstacle."""
        found = overall_outcome(self.limits)
        better = WORST_FIRST.index(found) > WORST_FIRST.index("withheld")
        return "withheld" if self.obstacles and better else found


def assess(
    result: Result,
    specification: str | Path,
    diagnosis: Diagnosis | None,
    unit: TestedUnit | None = None,
    others: tuple[Obstacle, ...] = (),
) -> Assessment:
    """Return the conformity of a unit to a specification.

    Parameters
    ----------
    result : a fit of the unit, with its campaign in place.
    specification : the file.
    diagnosis : of the result; None if it was not diagnosed, which a unit cannot pass with.
    unit : the quantities of the result if they are known already.
    others : obstacles that are known already.

    Raises
    ------
    InputError
        with everything in the specification that cannot be used with this result.
    """
    file, ledger = read_specification(specification)
    limits: tuple[ConformityOfQuantity, ...] = ()
    if result.summary.converged:
        unit = unit or unit_under_test(result)
        limits = tuple(conformity(limit, unit) for limit in resolved_limits(file, ledger, unit))
    against = (*obstacles(result, diagnosis), *others)
    if against:
        limits = tuple(_undecided(each) for each in limits)
    return Assessment(file.name, limits, against)


def _undecided(found: ConformityOfQuantity) -> ConformityOfQuantity:
    """Return the outcome for a limit that nothing can pass on what stands against the unit."""
    decision = _without_pass(found.decision, "obstacle")
    return found if decision is found.decision else replace(found, decision=decision, consumer=None)


def obstacles(result: Result, diagnosis: Diagnosis | None) -> tuple[Obstacle, ...]:
    """Return why a unit cannot pass on a result, whatever its specification says."""
    if not result.summary.converged:
        return ("not_converged",)
    found: list[Obstacle] = []
    if diagnosis is None:
        found.append("not_diagnosed")
    elif diagnosis.verdict != "adequate":
        found.append("inadequate_model")
    if not result.summary.intervals_valid:
        found.append("invalid_intervals")
    return tuple(found)
