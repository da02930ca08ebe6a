"""The tables of estimates of a report: results, mounting angles, quantities of the standards, Δk."""

from collections.abc import Iterator, Sequence
from typing import Any, Literal

import numpy as np

from imubayes import Diagnosis
from imubayes.foundations.quantity_names import MOUNTING_ANGLE, QuantityName, family_of, name_of
from imubayes.parameters.priors import Normal
from imubayes.results import summary as records
from imubayes.results.marginal import draws_needed
from imubayes.results.result import Result
from imubayes_qualification.budgets.standard_quantities import (
    STANDARD_QUANTITIES,
    StandardDraws,
    StandardQuantity,
    digital_unit,
    draws_of_standard,
)
from imubayes_qualification.budgets.unit_under_test import TestedUnit, is_measured
from imubayes_qualification.certificate import report_record as record
from imubayes_qualification.evaluation.coverage import Coverage
from imubayes_qualification.evaluation.decision_rules import (
    ProbabilityByTwoMethods,
    ToleranceInterval,
    conformance_probability,
)
from imubayes_qualification.evaluation.stated_digits import digits_deserved, digits_stated

_MOST_SCREENED = 4


def probability_of(found: ProbabilityByTwoMethods) -> record.Probability:
    """Return a probability by two methods as a record."""
    return record.Probability.model_validate(found, from_attributes=True)


def _numbers(unit: TestedUnit, name: str) -> dict[str, Any]:
    """Return estimate, uncertainty, interval and Monte Carlo errors of a quantity, as the fields of an estimate."""
    marginal = unit.quantities.marginal(name)
    if records.is_constant(marginal.draws):
        value = float(marginal.draws[0])
        constant = {"estimate": value, "standard_uncertainty": 0.0, "low": value, "high": value}
        return constant | {"exact": True, "measured": False}
    stated = unit.coverage(name)
    error = monte_carlo_error(stated, marginal.effective)
    return {
        "estimate": stated.estimate,
        "standard_uncertainty": stated.standard,
        "low": stated.low,
        "high": stated.high,
        "interval": stated.shape,
        "coverage_factor": stated.factor,
        "expanded_uncertainty": stated.expanded,
        "measured": is_measured(unit.quantities.entries[name], marginal.draws),
        "monte_carlo": error,
        "withheld": None if error.digits else "monte_carlo_error",
    }


def monte_carlo_error(stated: Coverage, effective: float) -> record.MonteCarloError:
    """Return the Monte Carlo errors of what is stated of a quantity that varies, and the digits that they leave."""
    deserved, errors = digits_deserved(stated.errors, stated.standard), stated.errors
    return record.MonteCarloError(
        estimate=errors.mean,
        standard_uncertainty=errors.sd,
        low=errors.low,
        high=errors.high,
        effective=effective,
        digits=digits_stated(errors, stated.standard, stated.expanded),
        tolerance=deserved.tolerance,
        worst=deserved.worst,
        draws_needed=draws_needed(errors, stated.standard, 1),
    )


def _estimate(result: Result, unit: TestedUnit | None, line: records.Quantity, shown: str = "") -> dict[str, Any]:
    """Return what the report states of a quantity, as the fields of an estimate, in its unit as it is shown."""
    campaign, member = (
        result.fit.model.campaign,
        line.quantities[0] if isinstance(line, records.CombinationSummary) else line.name,
    )
    outputs = {channel.name: channel.output_unit for channel in campaign.channels}
    channel = QuantityName.of(member).first
    if unit is None:
        numbers: dict[str, Any] = {"withheld": "not_converged"}
    elif line.name in unit.quantities.draws:
        # The share of the information is that of the draws with all that is included.
        line, numbers = unit.quantities.entries[line.name], _numbers(unit, line.name)
    else:
        numbers = {"withheld": "no_draws"}
    return numbers | {
        "name": line.name,
        "unit": shown or line.unit,
        "d_si": digital_unit(line.unit, campaign.site.gravity, outputs.get(channel, "")),
        "prior_sd": line.prior_sd,
        "from_data": line.from_data,
    }


def result_lines(result: Result, unit: TestedUnit | None) -> Iterator[record.ResultLine]:
    """Yield the result table: parameters without those of single poses, and derived quantities."""
    model = result.fit.model
    means = {
        parameter.name: float(np.asarray(parameter.prior.mean)) / parameter.factor
        for parameter in (*model.layout.parameters, *model.hyper_layout.parameters)
        if isinstance(parameter.prior, Normal)
    }
    shown = {line.name: line.unit for line in records.in_output_units(result.summary).parameters}
    for line in (*result.summary.parameters, *result.summary.derived):
        if isinstance(line, records.ParameterSummary) and line.nuisance:
            continue
        diagnostics: dict[str, Any] = (
            {"kind": "parameter", "r_hat": line.r_hat, "ess_bulk": line.ess_bulk, "ess_tail": line.ess_tail}
            if isinstance(line, records.ParameterSummary)
            else {"kind": "derived"}
        )
        estimate = _estimate(result, unit, line, shown.get(line.name, ""))
        yield record.ResultLine(prior_mean=means.get(line.name), **diagnostics, **estimate)


def mounting_angles(result: Result, unit: TestedUnit | None) -> tuple[record.MountingAngle, ...]:
    """Return the true mounting angles, and the uncertainty that each procedure alone would leave."""
    campaign, found = result.fit.model.campaign, []
    evidence = {each.quantity: each.by for each in result.summary.contributions}
    lines = {line.name: line for line in result.summary.derived}
    for channel in campaign.channels:
        for mounting in campaign.mountings.values():
            name = name_of(MOUNTING_ANGLE, channel.name, mounting.name)
            line = lines.get(name)
            if line is None:
                continue
            along = float((mounting.body_to_table @ channel.axes[0])[2])
            nominal = float(np.degrees(np.arccos(np.clip(along, -1, 1))))
            found.append(
                record.MountingAngle(
                    channel=channel.name,
                    mounting=mounting.name,
                    nominal=nominal,
                    deviation=None if line.mean is None else line.mean - nominal,
                    evidence=evidence.get(name, ()),
                    runs=tuple(run.name for run in campaign.runs if run.mounting == mounting.name),
                    **_estimate(result, unit, line),
                )
            )
    return tuple(found)


def determined_combinations(result: Result, unit: TestedUnit | None) -> tuple[record.ReportedCombination, ...]:
    """Return what the data determine of quantities that they do not determine by themselves."""
    procedures = tuple(dict.fromkeys(run.procedure for run in result.fit.model.campaign.runs))
    evidence = {each.quantity: each.by for each in result.summary.contributions}
    return tuple(
        record.ReportedCombination(
            standard=line.standard,
            quantities=line.quantities,
            weights=line.weights,
            constant=line.constant,
            middle_of=line.middle_of,
            evidence=evidence.get(line.name, ()),
            procedures=procedures,
            **_estimate(result, unit, line, shown.unit),
        )
        for line, shown in zip(
            result.summary.combinations, records.in_output_units(result.summary).combinations, strict=True
        )
    )


def standard_estimates(unit: TestedUnit | None) -> tuple[record.StandardEstimate, ...]:
    """Return the quantities of the standards that the result has, measured or not; none without convergence."""
    if unit is None:
        return ()
    return tuple(
        _of_standard(quantity, draws, unit)
        for quantity in STANDARD_QUANTITIES
        for draws in draws_of_standard(quantity, unit)
    )


def _named(quantity: StandardQuantity) -> dict[str, Any]:
    """Return how the standards call a quantity, as the fields of a line."""
    return {"key": quantity.key, "symbol": quantity.symbol, "quantity": quantity.name, "standard": quantity.standard}


def _of_standard(quantity: StandardQuantity, found: StandardDraws, unit: TestedUnit) -> record.StandardEstimate:
    own = name_of(quantity.key, found.label)
    known = own if own in unit.quantities.draws else found.members[0]
    return record.StandardEstimate(
        name=own,
        unit=found.unit,
        d_si=digital_unit(found.unit, unit.gravity),
        from_data=unit.quantities.entries[known].from_data,
        **_named(quantity),
        term=quantity.term,
        label=found.label,
        members=found.members,
        vector=found.length,
        **_numbers(unit, known),
    )


def _not_measured(standards: Sequence[record.StandardEstimate]) -> Iterator[record.NotEstimated]:
    """Yield the quantities of the standards that the data do not determine, each with its channels."""
    for quantity in STANDARD_QUANTITIES:
        own = [each for each in standards if each.key == quantity.key and not each.measured]
        if own:
            shares = [each.from_data for each in own if each.from_data is not None and not each.exact]
            yield record.NotEstimated(
                **_named(quantity),
                effects=quantity.effects,
                labels=tuple(each.label for each in own),
                reason="not_measured",
                from_data=max(shares, default=None),
            )


def not_estimated(
    result: Result,
    unit: TestedUnit | None,
    standards: Sequence[record.StandardEstimate],
    diagnosis: Diagnosis | None,
) -> tuple[record.NotEstimated, ...]:
    """Return the quantities of the standards that the result does not measure, and what the diagnosis says of each.

    None if the fit did not converge, which lacks all of them.
    """
    if unit is None:
        return ()
    campaign = result.fit.model.campaign
    kinds = {channel.kind for channel in campaign.channels}
    in_model = {effect.name for effect in result.fit.model.spec.effects}
    found, known = list(_not_measured(standards)), {each.key for each in standards}
    for quantity in STANDARD_QUANTITIES:
        if quantity.kind not in kinds or quantity.key in known:
            continue
        reason, needs = _why_missing(quantity, in_model, diagnosis)
        found.append(
            record.NotEstimated(
                **_named(quantity),
                effects=quantity.effects,
                reason=reason,
                needs=needs,
                screened=_screened(quantity, diagnosis) if reason == "not_in_model" else (),
            )
        )
    return tuple(found)


def _why_missing(
    quantity: StandardQuantity, in_model: set[str], diagnosis: Diagnosis | None
) -> tuple[Literal["not_in_model", "undetectable", "not_defined"], tuple[str, ...]]:
    """Return why a result lacks a quantity, and what runs would have to supply."""
    if in_model.intersection(quantity.effects):
        return "not_defined", ()
    hidden = [] if diagnosis is None else [e for e in diagnosis.undetectable if e.effect in quantity.effects]
    if hidden and len({each.effect for each in hidden}) == len(quantity.effects):
        return "undetectable", tuple(dict.fromkeys(need for each in hidden for need in each.needs))
    return "not_in_model", ()


def _screened(quantity: StandardQuantity, diagnosis: Diagnosis | None) -> tuple[record.ScreenedCoefficient, ...]:
    """Return what the diagnosis estimated of the coefficient that the quantity is; nothing for what it is not alone."""
    if diagnosis is None or not quantity.family:
        return ()
    found: dict[str, record.ScreenedCoefficient] = {}
    for line in diagnosis.ranking:
        for each in line.coefficients if line.effect in quantity.effects else ():
            own = family_of(each.name) == quantity.family and each.name not in found
            if own and each.value is not None and each.sd is not None:
                found[each.name] = record.ScreenedCoefficient(
                    name=each.name, value=each.value, standard_uncertainty=each.sd, unit=each.unit
                )
    return tuple(list(found.values())[:_MOST_SCREENED])


def thermal_linearity(result: Result, unit: TestedUnit | None) -> tuple[record.ThermalLinearity, ...]:
    """Return Δk of each converter input with P(Δk ≤ threshold) by two methods."""
    found = []
    for line in result.summary.derived:
        if line.within is None:
            continue
        channel, run = QuantityName.of(line.name).labels
        within = None
        if unit is not None and line.name in unit.quantities.draws:
            marginal = unit.quantities.marginal(line.name)
            within = probability_of(conformance_probability(marginal, ToleranceInterval(upper=line.within.threshold)))
        found.append(
            record.ThermalLinearity(
                channel=channel,
                run=run,
                threshold=line.within.threshold,
                within=within,
                **_estimate(result, unit, line),
            )
        )
    return tuple(found)
