"""The tables of estimates of a report: results, mounting angles, quantities of the standards, Δk."""

from typing import Any, Literal

import numpy as np

from imubayes.criticism.diagnosis_record import Diagnosis
from imubayes.foundations.campaign_data import Campaign
from imubayes.parameters.priors import Normal
from imubayes.qualification import report_record as record
from imubayes.qualification.conformity import TestedUnit, standards_input
from imubayes.qualification.decision_rules import (
    ProbabilityByTwoMethods,
    ToleranceInterval,
    conformance_probability,
)
from imubayes.qualification.marginal import Marginal, digits_deserved, draws_needed
from imubayes.qualification.standard_quantities import (
    STANDARD_QUANTITIES,
    StandardDraws,
    StandardQuantity,
    digital_unit,
    draws_of_standard,
)
from imubayes.results.result import Result
from imubayes.results.summary import DerivedSummary, ParameterSummary, in_output_units, is_constant

_MOST_SCREENED = 4


def probability_of(found: ProbabilityByTwoMethods) -> record.Probability:
    """Return a probability by two methods as a record."""
    return record.Probability(
        value=found.value,
        from_draws=found.from_draws,
        from_quadrature=found.from_quadrature,
        monte_carlo_error=found.error,
        allowed=found.allowed,
        withheld=found.withheld,
    )


def _numbers(marginal: Marginal) -> dict[str, Any]:
    """Return estimate, uncertainty, interval and Monte Carlo errors of draws, as the fields of an estimate."""
    if is_constant(marginal.draws):
        value = float(marginal.draws[0])
        return {"estimate": value, "standard_uncertainty": 0.0, "low": value, "high": value, "exact": True}
    low, high = marginal.interval
    error = monte_carlo_error(marginal)
    return {
        "estimate": marginal.mean,
        "standard_uncertainty": marginal.sd,
        "low": low,
        "high": high,
        "monte_carlo": error,
        "withheld": None if error.digits else "monte_carlo_error",
    }


def monte_carlo_error(marginal: Marginal) -> record.MonteCarloError:
    """Return the Monte Carlo errors of draws that vary, and the digits that they leave."""
    deserved, errors = digits_deserved(marginal), marginal.errors
    return record.MonteCarloError(
        estimate=errors.mean,
        standard_uncertainty=errors.sd,
        low=errors.low,
        high=errors.high,
        effective=marginal.effective,
        digits=deserved.digits,
        tolerance=deserved.tolerance,
        worst=deserved.worst,
        draws_needed=draws_needed(marginal, 1),
    )


def _output_units(campaign: Campaign) -> dict[str, str]:
    return {channel.name: channel.output_unit for channel in campaign.channels}


def _estimate(unit: TestedUnit | None, name: str) -> dict[str, Any]:
    if unit is None:
        return {"withheld": "not_converged"}
    return _numbers(unit.quantities.marginal(name)) if name in unit.quantities.draws else {"withheld": "no_draws"}


def result_lines(result: Result, unit: TestedUnit | None) -> tuple[record.ResultLine, ...]:
    """Return the result table: parameters without those of single poses, and derived quantities."""
    model = result.fit.model
    gravity, outputs = model.campaign.site.gravity, _output_units(model.campaign)
    means = {
        parameter.name: float(np.asarray(parameter.prior.mean)) / parameter.factor
        for parameter in (*model.layout.parameters, *model.hyper_layout.parameters)
        if isinstance(parameter.prior, Normal)
    }
    shown = {line.name: line.unit for line in in_output_units(result.summary).parameters}
    found = []
    for line in (*result.summary.parameters, *result.summary.derived):
        if isinstance(line, ParameterSummary) and line.nuisance:
            continue
        diagnostics: dict[str, Any] = (
            {"kind": "parameter", "r_hat": line.r_hat, "ess_bulk": line.ess_bulk, "ess_tail": line.ess_tail}
            if isinstance(line, ParameterSummary)
            else {"kind": "derived"}
        )
        channel = line.name.partition("[")[2].removesuffix("]").partition(",")[0]
        found.append(
            record.ResultLine(
                name=line.name,
                unit=shown.get(line.name, line.unit),
                d_si=digital_unit(line.unit, gravity, outputs.get(channel, "")),
                prior_mean=means.get(line.name),
                prior_sd=line.prior_sd,
                from_data=line.from_data,
                **diagnostics,
                **_estimate(unit, line.name),
            )
        )
    return tuple(found)


def mounting_angles(result: Result, unit: TestedUnit | None) -> tuple[record.MountingAngle, ...]:
    """Return the true mounting angles, and the uncertainty that each procedure alone would leave."""
    campaign, found = result.fit.model.campaign, []
    evidence = _evidence(result)
    lines = {line.name: line for line in result.summary.derived}
    for channel in campaign.channels:
        for mounting in campaign.mountings.values():
            name = f"mounting_angle[{channel.name},{mounting.name}]"
            line: DerivedSummary | None = lines.get(name)
            if line is None:
                continue
            along = float((mounting.body_to_table @ channel.axes[0])[2])
            nominal = float(np.degrees(np.arccos(np.clip(along, -1, 1))))
            found.append(
                record.MountingAngle(
                    name=name,
                    unit=line.unit,
                    d_si=digital_unit(line.unit, campaign.site.gravity),
                    prior_sd=line.prior_sd,
                    from_data=line.from_data,
                    channel=channel.name,
                    mounting=mounting.name,
                    nominal=nominal,
                    deviation=None if line.mean is None else line.mean - nominal,
                    evidence=evidence.get(name, ()),
                    runs=tuple(run.name for run in campaign.runs if run.mounting == mounting.name),
                    **_estimate(unit, name),
                )
            )
    return tuple(found)


def _evidence(result: Result) -> dict[str, tuple[record.ProcedureEvidence, ...]]:
    """Return quantity → its uncertainty by procedure."""
    return {
        found.quantity: tuple(
            record.ProcedureEvidence(procedure=each.procedure, alone=each.alone, without=each.without)
            for each in found.by
        )
        for found in result.summary.contributions
    }


def determined_combinations(result: Result, unit: TestedUnit | None) -> tuple[record.ReportedCombination, ...]:
    """Return what the data determine of quantities that they do not determine by themselves."""
    campaign, evidence = result.fit.model.campaign, _evidence(result)
    outputs = _output_units(campaign)
    found = []
    for line, shown in zip(result.summary.combinations, in_output_units(result.summary).combinations, strict=True):
        channel = line.quantities[0].partition("[")[2].removesuffix("]").partition(",")[0]
        found.append(
            record.ReportedCombination(
                name=line.name,
                unit=shown.unit,
                d_si=digital_unit(line.unit, campaign.site.gravity, outputs.get(channel, "")),
                prior_sd=line.prior_sd,
                from_data=line.from_data,
                standard=line.standard,
                quantities=line.quantities,
                weights=line.weights,
                constant=line.constant,
                middle_of=line.middle_of,
                evidence=evidence.get(line.name, ()),
                procedures=tuple(dict.fromkeys(run.procedure for run in campaign.runs)),
                **_estimate(unit, line.name),
            )
        )
    return tuple(found)


def standard_estimates(result: Result, unit: TestedUnit | None) -> tuple[record.StandardEstimate, ...]:
    """Return the quantities of the standards that the result has; none where the fit did not converge."""
    if unit is None:
        return ()
    under_test = standards_input(result, unit)
    return tuple(
        _of_standard(quantity, draws, unit)
        for quantity in STANDARD_QUANTITIES
        for draws in draws_of_standard(quantity, under_test)
    )


def _of_standard(quantity: StandardQuantity, found: StandardDraws, unit: TestedUnit) -> record.StandardEstimate:
    effective = min(unit.quantities.effective[name] for name in found.members)
    entries = [unit.quantities.entries[name] for name in found.members]
    share = entries[0].from_data if len(entries) == 1 else None
    return record.StandardEstimate(
        name=f"{quantity.key}[{found.label}]",
        unit=found.unit,
        d_si=digital_unit(found.unit, unit.gravity),
        from_data=share,
        key=quantity.key,
        symbol=quantity.symbol,
        quantity=quantity.name,
        standard=quantity.standard,
        term=quantity.term,
        label=found.label,
        members=found.members,
        **_numbers(Marginal(found.draws[np.isfinite(found.draws)], effective)),
    )


def not_estimated(
    result: Result, unit: TestedUnit | None, diagnosis: Diagnosis | None
) -> tuple[record.NotEstimated, ...]:
    """Return the quantities of the standards that the result lacks, and what the diagnosis says of each.

    None where the fit did not converge, which lacks all of them.
    """
    if unit is None:
        return ()
    campaign = result.fit.model.campaign
    kinds = {channel.kind for channel in campaign.channels}
    in_model = {effect.name for effect in result.fit.model.spec.effects}
    under_test = standards_input(result, unit)
    found = []
    for quantity in STANDARD_QUANTITIES:
        if quantity.kind not in kinds or draws_of_standard(quantity, under_test):
            continue
        reason, needs = _why_missing(quantity, in_model, diagnosis)
        found.append(
            record.NotEstimated(
                key=quantity.key,
                symbol=quantity.symbol,
                quantity=quantity.name,
                standard=quantity.standard,
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
    if diagnosis is None:
        return ()
    found: dict[str, record.ScreenedCoefficient] = {}
    for line in diagnosis.ranking:
        for each in line.coefficients if line.effect in quantity.effects else ():
            if each.value is not None and each.sd is not None and each.name not in found:
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
        channel, _, run = line.name.removeprefix("delta_k[").removesuffix("]").partition(",")
        within = None
        if unit is not None and line.name in unit.quantities.draws:
            marginal = unit.quantities.marginal(line.name)
            within = probability_of(conformance_probability(marginal, ToleranceInterval(upper=line.within.threshold)))
        found.append(
            record.ThermalLinearity(
                name=line.name,
                unit=line.unit,
                d_si=digital_unit(line.unit, result.fit.model.campaign.site.gravity),
                prior_sd=line.prior_sd,
                from_data=line.from_data,
                channel=channel,
                run=run,
                threshold=line.within.threshold,
                within=within,
                **_estimate(unit, line.name),
            )
        )
    return tuple(found)
