"""From a result, its diagnosis and its history to the record of the report.

Its parts include unit, campaign, site and equipment of the result, and what its numbers come from.
"""

import hashlib
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from imubayes import Diagnosis
from imubayes.campaign.toml_documents import Ledger
from imubayes.foundations.campaign_data import Campaign, Instruments
from imubayes.foundations.covariates import shown
from imubayes.foundations.units import to_si
from imubayes.loop.model_history import Tree
from imubayes.procedures.ambient import starts_of
from imubayes.results.change_records import read_diagnosis
from imubayes.results.fit_file import software
from imubayes.results.folder_files import HISTORY, checked
from imubayes.results.history_tree import read_fit_record, read_tree
from imubayes.results.result import Result, opened
from imubayes.results.stored_tables import draws_of
from imubayes.results.summary import ParameterSummary, is_constant
from imubayes_qualification.budgets.measurement_equation import measurement_model
from imubayes_qualification.budgets.report_budgets import UnitWithBudgets, unit_with_budgets
from imubayes_qualification.budgets.standard_quantities import digital_unit, standard_symbol
from imubayes_qualification.budgets.taken_as_exact import OMITTED, TakenAsExact
from imubayes_qualification.budgets.unit_under_test import TestedUnit
from imubayes_qualification.certificate import report_estimates as estimates
from imubayes_qualification.certificate import report_pictures as pictures
from imubayes_qualification.certificate import report_record as record
from imubayes_qualification.certificate import report_subject as subject
from imubayes_qualification.certificate.capability import AppliedCapability, with_capability
from imubayes_qualification.certificate.certificate import Certificate, Missing, missing_items, read_certificate
from imubayes_qualification.certificate.conformity import Assessment, ConformityOfQuantity, Obstacle, assess, obstacles
from imubayes_qualification.certificate.specification import read_specification
from imubayes_qualification.evaluation.decision_rules import ProbabilityByTwoMethods


def _triple(values: np.ndarray) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in values)
    return x, y, z


def subject_of(campaign: Campaign, result: Result) -> subject.Subject:
    """Return unit, campaign, site and equipment."""
    site = campaign.site
    counted = result.residuals.table.filter(pl.col("kind") != "closure").group_by("run").len()
    used = dict(zip(counted["run"].to_list(), counted["len"].to_list(), strict=True))
    missing = {
        run.name: sum(each.values for each in omitted_values(campaign) if each.run == run.name) for run in campaign.runs
    }
    return subject.Subject(
        serial=campaign.serial,
        grade=campaign.grade,
        campaign=campaign.name,
        latitude_deg=math.degrees(site.latitude),
        height_m=site.height,
        gravity_m_s2=site.gravity,
        gravity_is_normal=site.has_normal_gravity,
        gravity_uncertainty_ug=_in(site.gravity_uncertainty, to_si("ug", site.gravity)),
        channels=tuple(
            subject.ReportedChannel(
                name=channel.name,
                kind=channel.kind,
                input_axis=_triple(channel.axes[0]),
                output_axis=_triple(channel.axes[1]),
                output_unit=channel.output_unit,
                nominal_scale=channel.scale,
                per=channel.per,
                nominal_offset=channel.offset,
            )
            for channel in campaign.channels
        ),
        tables=tuple(
            subject.ReportedTable(
                name=table.name,
                azimuth_deg=math.degrees(table.azimuth) if table.azimuth_known else None,
                elevation_deg=math.degrees(table.elevation),
                axis_uncertainty_arcsec=_in(table.axis_uncertainty, math.radians(1 / 3600)),
                rate_uncertainty_ppm=_in(table.rate_uncertainty, 1e-6),
                angle_uncertainty_arcsec=_in(table.angle_uncertainty, math.radians(1 / 3600)),
                azimuth_uncertainty_arcsec=_in(table.azimuth_uncertainty, math.radians(1 / 3600)),
                elevation_uncertainty_arcsec=_in(table.elevation_uncertainty, math.radians(1 / 3600)),
            )
            for table in campaign.tables.values()
        ),
        mountings=_mountings(campaign),
        runs=tuple(
            subject.ReportedRun(
                name=run.name, procedure=run.procedure, table=run.table, mounting=run.mounting, start=run.start,
                rows=run.rows, values_used=used.get(run.name, 0), values_missing=missing[run.name],
                thermometer=run.thermometer, converter_thermometer=run.converter_thermometer,
            )
            for run in campaign.runs
        ),
        thermometers=_thermometers(campaign),
        instruments=_instruments(campaign.instruments),
    )  # fmt: skip


def _mountings(campaign: Campaign) -> tuple[subject.ReportedMounting, ...]:
    return tuple(
        subject.ReportedMounting(
            name=mounting.name,
            body_to_table=tuple(_triple(row) for row in mounting.body_to_table),
            uncertainty_arcmin=_in(mounting.uncertainty, math.radians(1 / 60)),
        )
        for mounting in campaign.mountings.values()
    )


def _thermometers(campaign: Campaign) -> tuple[subject.ReportedThermometer, ...]:
    return tuple(
        subject.ReportedThermometer(
            name=each.name, offset_uncertainty_degC=each.offset_uncertainty,
            gain_uncertainty_percent=_in(each.gain_uncertainty, to_si("%")),
        )
        for each in campaign.thermometers.values()
    )  # fmt: skip


def _instruments(own: Instruments) -> subject.ReportedInstruments:
    return subject.ReportedInstruments(
        clock_uncertainty_ppm=_in(own.clock, to_si("ppm")),
        vibration_uncertainty_percent=_in(own.vibration, to_si("%")),
        time_base_uncertainty_ppm=_in(own.time_base, to_si("ppm")),
        meter_uncertainty_ppm=_in(own.meter, to_si("ppm")),
    )


def _in(value: float | None, unit: float) -> float | None:
    return None if value is None else value / unit


def omitted_values(campaign: Campaign) -> Iterator[record.OmittedChannel]:
    """Yield missing values of channels that the run recorded at all."""
    for run in campaign.runs:
        gone = np.isnan(run.observed)
        for channel, missing in zip(campaign.channels, gone.T, strict=True):
            if missing.any() and not missing.all():
                yield record.OmittedChannel(run=run.name, channel=channel.name, values=int(missing.sum()))


def provenance_of(result: Result) -> subject.Provenance:
    """Return model, hashes, seed and software."""
    assert result.folder is not None
    fit, model = read_fit_record(result.folder), result.fit.model
    spec, fitted = model.spec, result.summary.provenance
    effects = [each for each in spec.effects if each in model.acting or not each.optional]
    return subject.Provenance(
        model=spec.name,
        effects=tuple(subject.ReportedEffect.model_validate(effect, from_attributes=True) for effect in effects),
        data_sha256=fit.data_hash,
        model_sha256=fit.model_hash,
        seed=fit.seed,
        sampled=result.summary.sampled,
        software=software(),
        fitted=None if fitted is None else fitted.fitted,
        fit_software=() if fitted is None else fitted.software,
    )


# Share of the information below which a quantity is not determined by the data.
_UNDETERMINED = 0.1


def report_of(
    result: Result | str | Path,
    specification: str | Path | None = None,
    certificate: str | Path | None = None,
) -> record.QualificationReport:
    """Return the report of a result folder.

    Parameters
    ----------
    result : a result that has a folder, or the folder; its diagnosis and history are read from there.
    specification : file with limits; None for a report without conformity.
    certificate : file with the certificate block; that of the specification if None.

    Raises
    ------
    InputError
        for a result that cannot be read, one whose campaign is gone or has changed, and a specification that cannot be
        used with it.
    """
    found = opened(result)
    assert found.folder is not None, "a report is made of a result folder"
    diagnosis, tree = read_diagnosis(found.folder), _tree(found.folder)
    campaign = found.fit.model.campaign
    block, ledger = certificate_of(specification, certificate)  # before all that takes long
    evaluated, capability = _evaluated(found, block, ledger)
    unit = None if evaluated is None else evaluated.unit
    exact = TakenAsExact() if evaluated is None else evaluated.exact
    angles, standards = estimates.mounting_angles(found, unit), estimates.standard_estimates(unit)
    missing: tuple[Missing, ...] = ()
    if block is not None:
        invalid = [Missing(item="validity")] if obstacles(found, diagnosis) else []
        missing = (*missing_items(block, campaign, covariates_read(found)), *_omitted(standards, exact), *invalid)
    expired: tuple[Obstacle, ...] = ("expired_standard",) if any(each.item == "expired" for each in missing) else ()
    assessment = assess(found, specification, diagnosis, unit, expired) if specification is not None else None
    scope = scope_of(campaign, found, diagnosis)
    return record.QualificationReport(
        subject=subject_of(campaign, found),
        provenance=provenance_of(found),
        convergence=convergence_of(found),
        adequacy=adequacy_of(found, diagnosis, tree),
        conformity=conformity_of(assessment, specification, campaign.site.gravity),
        results=tuple(estimates.result_lines(found, unit)),
        mounting_angles=angles,
        combinations=estimates.determined_combinations(found, unit),
        standards=tuple(each for each in standards if each.measured),
        not_estimated=estimates.not_estimated(found, unit, standards, diagnosis),
        thermal_linearity=estimates.thermal_linearity(found, unit),
        exact=exact,
        budgets=None if evaluated is None else evaluated.budgets,
        left_out=left_out_of(campaign, found, diagnosis),
        scope=scope,
        measurement=measurement_model(found),
        pictures=pictures_of(found, unit, assessment, angles),
        certificate=block,
        missing=missing,
        floors=capability.floors,
        unused_capabilities=capability.unused,
    )


def covariates_read(result: Result) -> tuple[str, ...]:
    """Return the covariates that the effects of a model read: their errors enter its results."""
    model = result.fit.model
    effects = (model.registry.effects[effect.name] for effect in model.spec.effects)
    return tuple(dict.fromkeys(need for effect in effects for need in effect.needs))


def _evaluated(
    result: Result, block: Certificate | None, ledger: Ledger | None
) -> tuple[UnitWithBudgets | None, AppliedCapability]:
    """Return the unit with budgets, no U below the capability (CMC); None if the fit did not converge."""
    evaluated = unit_with_budgets(result) if result.converged else None
    if evaluated is None or block is None or ledger is None:
        return evaluated, AppliedCapability()
    return with_capability(evaluated, block.cmc, ledger)


def _omitted(standards: Sequence[record.StandardEstimate], exact: TakenAsExact) -> Iterator[Missing]:
    """Yield that known contributions are in no U, if this matters to what is certified."""
    ratios = (
        (each.symbol, max(exact.omitted_ratio(name, each.standard_uncertainty or 0.0) for name in (each.name, *own)))
        for each in standards
        for own in (each.members if len(each.members) == 1 else (),)
        if each.measured and each.withheld is None
    )
    symbols = dict.fromkeys(symbol for symbol, ratio in ratios if ratio > OMITTED)
    if symbols:
        yield Missing(item="omitted", of=", ".join(symbols))


def certificate_of(
    specification: str | Path | None, certificate: str | Path | None
) -> tuple[Certificate | None, Ledger | None]:
    """Return the certificate block of a file of its own, else that of the specification, with the ledger of the file.

    Raises
    ------
    InputError
        with everything that is wrong with the file.
    """
    if certificate is not None:
        return read_certificate(certificate)
    if specification is None:
        return None, None
    file, ledger = read_specification(specification)
    return file.certificate, ledger


def _tree(folder: Path) -> tuple[Tree, str] | None:
    """Return the history with the place of a result in it; None if there is none."""
    return (read_tree([folder]), str(folder.resolve())) if checked(folder).holds(HISTORY) else None


def convergence_of(result: Result) -> record.ReportedConvergence:
    """Return whether fit and sampling converged, and their worst diagnostics."""
    summary = result.summary
    worst: dict[str, Any] = {}
    for name, key, sign in (
        ("worst_r_hat", "r_hat", 1),
        ("least_bulk", "ess_bulk", -1),
        ("least_tail", "ess_tail", -1),
    ):
        worst[name], worst[f"{name}_of"] = _worst(summary.parameters, key, sign)
    return record.ReportedConvergence(
        converged=summary.converged,
        message=summary.message,
        sampled=summary.sampled,
        draws=len(next(iter(result.draws.values()))) if summary.converged else None,
        acceptance=summary.acceptance,
        pareto_k=summary.pareto_k,
        **worst,
    )


def _worst(lines: Sequence[ParameterSummary], key: str, sign: int) -> tuple[float | None, str]:
    known = [line for line in lines if getattr(line, key) is not None]
    found = max(known, key=lambda line: sign * getattr(line, key), default=None)
    return (None, "") if found is None else (getattr(found, key), found.name)


def adequacy_of(result: Result, diagnosis: Diagnosis | None, tree: tuple[Tree, str] | None) -> record.Adequacy:
    """Return whether the model describes the data, and which models were tried."""
    summary = result.summary
    history = _history(tree)
    diagnosed = sum(each.verdict is not None for each in history) + (diagnosis is not None)
    return record.Adequacy(
        **_diagnosed(diagnosis),
        intervals_valid=summary.intervals_valid,
        noise_violations=summary.noise_violations,
        noise_suspected=summary.noise_suspected,
        chi2=summary.chi2,
        dof=summary.dof,
        diagnoses=diagnosed,
        history=history,
        runs=summary.runs,
        prior_conflicts=summary.prior_conflicts,
        set_aside=summary.set_aside,
    )


def _diagnosed(diagnosis: Diagnosis | None) -> dict[str, Any]:
    """Return what a diagnosis says of the adequacy of a model."""
    if diagnosis is None:
        return {"verdict": None, "explanations": None, "candidates": 0, "missing": (), "undetectable": ()}
    return {
        "verdict": diagnosis.verdict,
        "explanations": diagnosis.explanations,
        "candidates": len(diagnosis.ranking),
        "missing": tuple(effect for group in diagnosis.groups for effect in group.effects),
        "undetectable": tuple(dict.fromkeys(each.effect for each in diagnosis.undetectable)),
        "most_biasing": diagnosis.most_biasing,
    }


def _history(tree: tuple[Tree, str] | None) -> tuple[record.ModelTried, ...]:
    if tree is None:
        return ()
    nodes, here = tree
    return tuple(
        record.ModelTried(
            id=node.id, title=node.title, verdict=node.verdict, chi2=node.chi2, dof=node.dof, rms=node.rms,
            depth=depth, taken=node.taken, selected=node.selected, reported=place == here,
        )
        for depth, place in nodes.in_order()
        for node in (nodes.nodes[place],)
    )  # fmt: skip


def conformity_of(
    assessment: Assessment | None, specification: str | Path | None, gravity: float
) -> record.Conformity | None:
    """Return the unit against its specification as a record; None if there is none."""
    if assessment is None or specification is None:
        return None
    return record.Conformity(
        specification=assessment.specification,
        sha256=hashlib.sha256(Path(specification).read_bytes()).hexdigest(),
        outcome=assessment.outcome,
        obstacles=assessment.obstacles,
        limits=tuple(_outcome(found, gravity) for found in assessment.limits),
    )


def _outcome(found: ConformityOfQuantity, gravity: float) -> record.LimitOutcome:
    limit, estimate, rule = found.limit, found.estimate, found.limit.rule
    symbol, label = standard_symbol(limit.quantity.name)
    consumer, producer = (found.overall.consumer, found.overall.producer) if found.overall is not None else (None, None)
    return record.LimitOutcome(
        name=limit.quantity.name,
        unit=limit.quantity.unit,
        d_si=digital_unit(limit.quantity.unit, gravity),
        lower=limit.tolerance.lower if math.isfinite(limit.tolerance.lower) else None,
        upper=limit.tolerance.upper if math.isfinite(limit.tolerance.upper) else None,
        nominal=limit.nominal,
        temperature_range=limit.span,
        temperature=found.temperature,
        estimate=estimate.value,
        standard_uncertainty=estimate.standard,
        expanded_uncertainty=estimate.expanded,
        low=found.stated.low,
        high=found.stated.high,
        interval=found.stated.shape,
        coverage_factor=found.stated.factor,
        symbol=symbol,
        label=label,
        omitted_ratio=found.omitted_ratio,
        conformance=estimates.probability_of(found.conformance),
        rule=rule.name,
        guard_factor=rule.guard_factor,
        guard_width=rule.guard_width,
        rule_probability=rule.probability,
        **vars(found.decision),
        monte_carlo=_errors_of(found),
        consumer_risk=found.consumer,
        producer_risk=found.producer,
        global_consumer_risk=_optional(consumer),
        global_producer_risk=_optional(producer),
    )


def _errors_of(found: ConformityOfQuantity) -> record.MonteCarloError | None:
    """Return the Monte Carlo errors of what is stated; None of a constant."""
    if is_constant(found.marginal.draws):
        return None
    return estimates.monte_carlo_error(found.stated, found.marginal.effective)


def _optional(found: ProbabilityByTwoMethods | None):
    return None if found is None else estimates.probability_of(found)


def left_out_of(campaign: Campaign, result: Result, diagnosis: Diagnosis | None) -> record.Omissions:
    """Return what was left out."""
    return record.Omissions(
        channels=tuple(omitted_values(campaign)),
        notes=result.summary.notes,
        outliers=len(diagnosis.outliers) if diagnosis is not None else 0,
        nuisance_parameters=sum(line.nuisance for line in result.summary.parameters),
    )


def scope_of(campaign: Campaign, result: Result, diagnosis: Diagnosis | None) -> record.StatisticalScope:
    """Return what the statistics rest on."""
    table = result.residuals.table
    ranges = []
    for covariate in shown():
        if covariate.column not in table.columns or covariate.name.endswith("time"):
            continue
        values = table[covariate.column].cast(pl.Float64).drop_nulls().to_numpy()
        values = values[np.isfinite(values)]
        if len(values):
            name, phrase, low, high = covariate.name, covariate.phrase, float(values.min()), float(values.max())
            found = record.CoveredRange(name=name, phrase=phrase, unit=covariate.unit, lowest=low, highest=high)
            ranges.append(found)
    starts = starts_of(campaign.runs)
    undetectable = diagnosis.undetectable if diagnosis is not None else ()
    lines = [*result.summary.parameters, *(each for each in result.summary.derived if not each.repeats_misalignments)]
    return record.StatisticalScope(
        ranges=tuple(ranges),
        first_start=starts[0] if starts else None,
        last_start=starts[-1] if starts else None,
        not_supplied=tuple(
            (each.effect, ", ".join(each.needs)) for each in undetectable if each.reason == "not_supplied"
        ),
        weak_directions=result.summary.weak_directions,
        from_priors=tuple(line.name for line in lines if line.from_data is not None and line.from_data < _UNDETERMINED),
    )


def pictures_of(
    result: Result, unit: TestedUnit | None, assessment: Assessment | None, angles: tuple[record.MountingAngle, ...]
) -> pictures.PictureData:
    """Return what the pictures show; the residuals alone if the fit did not converge."""
    table, campaign = result.residuals.table, result.fit.model.campaign
    covariates = {covariate.column: (covariate.phrase, covariate.unit) for covariate in shown()}
    worst = pictures.worst_residual(table.filter(pl.col("kind") != "closure"), campaign.channels, covariates)
    if unit is None:
        return pictures.PictureData(worst=worst)
    limits = assessment.limits if assessment is not None else ()
    known = [angle for angle in angles if angle.estimate is not None]
    prior = draws_of(result.posterior_file or result.posterior, [angle.name for angle in known], "prior")
    posterior = unit.quantities.draws
    return pictures.PictureData(
        errors=pictures.error_pictures(unit, table, limits),
        worst=worst,
        mountings=pictures.mounting_pictures(
            campaign, {(a.channel, a.mounting): (a.nominal, a.estimate) for a in known if a.estimate is not None}
        ),
        angles=tuple(
            pictures.angle_density(a.channel, a.mounting, prior[a.name], posterior[a.name], a.nominal)
            for a in known
            if a.name in prior
        ),
    )
