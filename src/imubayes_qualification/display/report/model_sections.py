"""Sections on what the numbers rest on: equipment, adequacy, convergence, what was left out, scope, provenance."""

from collections.abc import Iterator
from dataclasses import replace

from imubayes.display import numbers_and_labels as numbers
from imubayes.display.fit_cautions import NOISE_WORDS, conflict_sheet, set_aside_text, violation_text
from imubayes.display.fit_quality_tables import weak_text
from imubayes.display.layout import Sheet, cells, of_columns
from imubayes.display.loop.diagnosis_sentences import bias_clause, evidence_text
from imubayes.foundations.covariates import effects_by_need
from imubayes.foundations.wording import agreeing, counted
from imubayes_qualification.certificate import report_record as record
from imubayes_qualification.certificate.report_subject import ReportedRun, ReportedTable
from imubayes_qualification.display.report.document import Block, Heading, Items, Paragraph, without_empty_columns
from imubayes_qualification.display.report.words import VERDICTS, enumerated, hash_text


def equipment_section(subject: record.Subject) -> Iterator[Block]:
    """Return site, channels, tables, mountings, instruments and runs."""
    site = (
        f"Latitude {subject.latitude_deg:.6g}°, height {subject.height_m:.6g} m, "
        f"gravity {subject.gravity_m_s2:.6f} m/s²; 1 g in this report is the gravity of the site."
    )
    channels = [
        cells(
            channel.name, channel.kind, _vector(channel.input_axis),
            _vector(channel.output_axis),
            f"{channel.nominal_scale:g} {channel.output_unit} per {channel.per}",
            f"{channel.nominal_offset:g}"
        )
        for channel in subject.channels
    ]  # fmt: skip
    tables = [
        cells(
            table.name, "unknown" if table.azimuth_deg is None else f"{table.azimuth_deg:g}",
            f"{table.elevation_deg:g}",
            _axis_known(table), _known(table.rate_uncertainty_ppm),
            _known(table.angle_uncertainty_arcsec)
        )
        for table in subject.tables
    ]  # fmt: skip
    mountings = [cells(each.name, _known(each.uncertainty_arcmin)) for each in subject.mountings]
    runs = [
        cells(
            run.name, run.procedure.replace("_", " "), run.table or numbers.NO_NUMBER,
            run.mounting or numbers.NO_NUMBER, _read_by(run), (run.start or numbers.NO_NUMBER).replace("T", " "),
            str(run.rows), str(run.values_used)
        )
        for run in subject.runs
    ]  # fmt: skip
    yield Heading("Unit, site and equipment")
    yield Paragraph(site)
    head = ("channel", "kind", "input axis", "output axis", "nominal scale factor", "nominal offset")
    yield Sheet("Channels", head, channels, (0, 1, 2, 3), note="Axes in the body frame, as designed.")
    if tables:
        head = ("table", "azimuth / deg", "elevation / deg", "axis / arcsec", "rate / ppm", "angle / arcsec")
        yield Sheet("Tables", head, tables, (0,), note="Standard uncertainties as stated.")
    if mountings:
        head = ("mounting", "seat / arcmin")
        yield Sheet("Mountings", head, mountings, (0,), note="Standard uncertainty, each angle.")
    yield from _instruments(subject)
    head = ("run", "procedure", "table", "mounting", "thermometer", "start", "rows", "values")
    note = "Values: rows times channels that the fit used."
    yield without_empty_columns(Sheet("Runs", head, runs, (0, 1, 2, 3, 4, 5), note=note))


def _instruments(subject: record.Subject) -> Iterator[Block]:
    """Yield the thermometers that runs share, and the uncertainties of the other instruments."""
    thermometers = [
        cells(each.name, _known(each.offset_uncertainty_degC), _known(each.gain_uncertainty_percent))
        for each in subject.thermometers
    ]
    if thermometers:
        head = ("thermometer", "at 25 °C / °C", "gain / %")
        note = "Standard uncertainties as stated, of an error that is common to all runs of the thermometer."
        yield Sheet("Thermometers", head, thermometers, (0,), note=note)
    own = subject.instruments
    stated = [
        ("clock of the runs", own.clock_uncertainty_ppm, "ppm"),
        ("vibration sensor", own.vibration_uncertainty_percent, "%"),
        ("time base of the outputs", own.time_base_uncertainty_ppm, "ppm"),
        ("meter of the outputs", own.meter_uncertainty_ppm, "ppm"),
    ]
    rows = [cells(name, _known(value), unit) for name, value, unit in stated if value is not None]
    if rows:
        head = ("instrument", "standard uncertainty", "unit")
        yield Sheet("Other instruments", head, rows, (0, 2), note="Of the reading, as stated.")


def _read_by(run: ReportedRun) -> str:
    """Return the thermometers of a run."""
    names = (run.thermometer or "", f"converter: {run.converter_thermometer}" if run.converter_thermometer else "")
    return ", ".join(filter(None, names))


def _vector(axis: tuple[float, float, float]) -> str:
    return "(" + ", ".join(f"{value:.4g}" for value in axis) + ")"


def _axis_known(table: ReportedTable) -> str:
    """Return the uncertainty of an axis: one value, or azimuth and elevation."""
    apart = (("azimuth", table.azimuth_uncertainty_arcsec), ("elevation", table.elevation_uncertainty_arcsec))
    own = [f"{name} {value:.4g}" for name, value in apart if value is not None]
    return ", ".join([*own, *([_known(table.axis_uncertainty_arcsec)] if len(own) < 2 else [])])


def _known(value: float | None) -> str:
    return numbers.NO_NUMBER if value is None else f"{value:.4g}"


def adequacy_section(adequacy: record.Adequacy) -> Iterator[Block]:
    """Return the verdict of the diagnosis and the history of models."""
    verdict = adequacy.verdict
    yield Heading("Model adequacy")
    if verdict is None:
        yield Paragraph("This result was never diagnosed.", "bad")
    else:
        yield Paragraph(f"Verdict of the diagnosis: {VERDICTS[verdict]}.", "" if verdict == "adequate" else "bad")
        yield Paragraph(_search(adequacy))
    for left in adequacy.set_aside:
        yield Paragraph(f"Readings set aside: {set_aside_text(left)}.", "bad")
    if adequacy.missing:
        yield Paragraph(f"Missing, or indistinguishable from a missing effect: {enumerated(adequacy.missing)}.", "bad")
    for each in adequacy.noise_violations:
        how = numbers.chance_text(each.p) if each.p is not None else ""
        yield Paragraph(
            f"Noise: {NOISE_WORDS[each.kind]} ({', '.join(each.channels)}{', p = ' + how if how else ''}).", "bad"
        )
    if adequacy.noise_suspected:
        yield Paragraph(f"Noise, suspected, although it may be chance: {violation_text(adequacy.noise_suspected)}.")
    if adequacy.undetectable:
        yield Paragraph(
            f"{counted(len(adequacy.undetectable), 'effect')} of the catalogue "
            f"{agreeing(len(adequacy.undetectable), 'is', 'are')} undetectable in these runs, which is not "
            f"the same as absent: {enumerated(adequacy.undetectable, 40)}."
        )
    if adequacy.most_biasing is not None:
        yield Paragraph(f"No interval includes any of them. Worst case: {bias_clause(adequacy.most_biasing)}.")
    if adequacy.chi2 is not None:
        ratio = numbers.ratio_text(adequacy.chi2 / adequacy.dof) if adequacy.dof else numbers.NO_NUMBER
        yield Paragraph(
            f"χ² = {adequacy.chi2:.1f} for {adequacy.dof:.0f} degrees of freedom (ratio {ratio}). The noise scales "
            "are fitted, so that the ratio is near 1 by construction; the tests above do not depend on it."
        )
    yield from _history(adequacy)
    yield from _conflicts(adequacy)
    yield _fit_table(adequacy)


def _search(adequacy: record.Adequacy) -> str:
    weighed = "" if adequacy.explanations is None else f" {evidence_text(adequacy.explanations)}"
    times = {0: "never", 1: "once", 2: "twice"}.get(adequacy.diagnoses, f"{adequacy.diagnoses} times")
    return (
        f"The diagnosis weighed {counted(adequacy.candidates, 'effect')} that these runs can show.{weighed} "
        f"A model of this unit was diagnosed {times}, this result included."
    )


def _history(adequacy: record.Adequacy) -> Iterator[Block]:
    if not adequacy.history:
        return
    rows = []
    for node in adequacy.history:
        states = {"this report": node.reported, "selected": node.selected, "refit not taken": not node.taken}
        state = ", ".join(word for word, true in states.items() if true)
        ratio = node.chi2 / node.dof if node.chi2 is not None and node.dof else None
        rows.append(
            cells(
                "→ " * node.depth + node.title, (node.verdict or numbers.NO_NUMBER).replace("_", " "),
                numbers.NO_NUMBER if node.chi2 is None else f"{node.chi2:.1f}",
                numbers.ratio_text(ratio), state
            )
        )  # fmt: skip
    note = (
        "Each model is below the one from which it was made. Verdict: that of the diagnosis which led to it. χ² is at "
        "the noise known beforehand. The more models were tried, the more the agreement is due to selection."
    )
    head = ("model", "verdict before", "χ²", "χ²/ν", "")
    yield Sheet("Models tried", head, rows, (0, 1, 4), note=note)


def _conflicts(adequacy: record.Adequacy) -> Iterator[Block]:
    if not adequacy.prior_conflicts:
        return
    table = of_columns(conflict_sheet(adequacy.prior_conflicts), (0, 1, 2, 4, 5))
    yield replace(table, title="Priors that disagree with the data", note="Unit or equipment is worse than stated.")


def _fit_table(adequacy: record.Adequacy) -> Sheet:
    rows = [
        cells(
            run.name, run.channel, str(run.n),
            numbers.ratio_text(run.chi2 / run.n if run.chi2 is not None and run.n else None),
            numbers.significant(run.rms), numbers.pretty(run.unit)
        )
        for run in adequacy.runs
    ]  # fmt: skip
    head = ("run", "channel", "values", "χ²/n", "rms residual", "unit")
    note = "χ²/n: mean square of the standardised residuals, near 1 if the noise model holds."
    return Sheet("Goodness of fit by run and channel", head, rows, (0, 1, 5), note=note)


def convergence_section(found: record.ReportedConvergence) -> Iterator[Block]:
    """Return whether fit and sampling converged."""
    yield Heading("Convergence")
    if not found.converged:
        yield Paragraph(f"The fit did not converge. {found.message}", "bad")
        return
    yield Paragraph("The fit converged." if not found.sampled else "Fit and sampling converged.")
    if not found.sampled:
        yield Paragraph(
            f"The posterior was not sampled: it is the Laplace approximation, {found.draws} independent draws. "
            "Sampled posteriors also contain the curvature that it leaves out (`imubayes fit` without --no-sample)."
        )
        return
    rows = [
        cells("largest R̂", _decimals(found.worst_r_hat, 4), "≤ 1.01", found.worst_r_hat_of),
        cells("least bulk effective size", _decimals(found.least_bulk, 0), "≥ 400", found.least_bulk_of),
        cells("least tail effective size", _decimals(found.least_tail, 0), "≥ 400", found.least_tail_of),
        cells("acceptance", _decimals(found.acceptance, 2), "", ""),
        cells("Pareto k of the proposal", _decimals(found.pareto_k, 2), "< 0.7", ""),
        cells("draws", str(found.draws), "", ""),
    ]
    note = "R̂ compares independent ensembles. Parameter: the one that has the worst value."
    yield Sheet("Sampling", ("diagnostic", "value", "required", "parameter"), rows, (0, 3), note=note)


def _decimals(value: float | None, count: int) -> str:
    return numbers.NO_NUMBER if value is None else f"{value:.{count}f}"


def left_out_section(found: record.Omissions) -> Iterator[Block]:
    """Return what was left out, and why."""
    items = [
        f"{each.run}: {counted(each.values, 'value')} of {each.channel} missing in the record."
        for each in found.channels
    ]
    items += list(found.notes)
    if found.outliers:
        items.append(
            f"The diagnosis found {counted(found.outliers, 'outlier')}. Its search excludes "
            f"{agreeing(found.outliers, 'it', 'them')}; the fit does not."
        )
    if found.nuisance_parameters:
        items.append(
            f"Not listed: {counted(found.nuisance_parameters, 'nuisance parameter')}, such as attitudes of poses."
        )
    yield Heading("What was left out")
    if not items:
        yield Paragraph("Nothing: every recorded value of every run was used, and every parameter is listed.")
        return
    yield Items(items)


def scope_section(scope: record.StatisticalScope) -> Iterator[Block]:
    """Return what the statistics do not cover."""
    rows = [
        cells(each.phrase, f"{each.lowest:.5g}", f"{each.highest:.5g}", numbers.pretty(each.unit))
        for each in scope.ranges
    ]
    items = [
        "Other units: every number refers to this unit. A number includes knowledge of a production only if a limit "
        "states it.",
        "Conditions outside the ranges above, and combinations of them that occurred in no run.",
        "Change after the last run: ageing, storage, transport, and repeated switching on, unless runs show it.",
        "Errors that the equipment and all runs share and that no prior of the model describes.",
    ]
    if scope.not_supplied:
        named = effects_by_need((effect, filter(None, needs.split(", "))) for effect, needs in scope.not_supplied)
        items.append(f"Effects that no run could show, by the input that a run would have to supply: {named}.")
    if scope.from_priors:
        items.append(
            f"Known from priors alone: {counted(len(scope.from_priors), 'quantity')}, "
            f"{enumerated(scope.from_priors, 20)}. The uncertainty is that of a "
            "certificate or an assumption, and no measurement confirmed it."
        )
    weak = [cells(weak_text(each), numbers.percent(each.from_data)) for each in scope.weak_directions]
    yield Heading("What the statistics do not cover")
    if rows:
        yield Sheet("Tested ranges", ("covariate", "lowest", "highest", "unit"), rows, (0, 3))
    yield Items(items)
    if weak:
        note = (
            "The data hardly determine these combinations, or not at all: they depend on the priors of their members."
        )
        yield Sheet("Weakly determined combinations", ("combination", "from data"), weak, (0,), note=note)


def provenance_section(found: record.Provenance) -> Iterator[Block]:
    """Return model, hashes, seed and software."""
    effects = [
        cells(
            effect.name, ", ".join(effect.channels) if effect.channels else "all that it can act on",
            "; ".join(f"{name} ~ {prior}" for name, prior in effect.prior.items()) or "default",
            "; ".join(f"{name} = {value:g}" for name, value in effect.options.items()) or numbers.NO_NUMBER
        )
        for effect in found.effects
    ]  # fmt: skip
    fitted = {each.package: each.version for each in found.fit_software}
    software = [cells(each.package, fitted.get(each.package, "not recorded"), each.version) for each in found.software]
    hashes = [
        cells("data", hash_text(found.data_sha256)),
        cells("model", hash_text(found.model_sha256)),
        cells("seed", str(found.seed)),
        cells("fitted", found.fitted or "not recorded"),
    ]
    yield Heading("Model, hashes and software")
    yield Sheet("Identification", ("what", "value"), hashes, (0, 1), note="SHA-256 of campaign and model.")
    yield Sheet(
        "Effects of the model",
        ("effect", "channels", "priors in the model file", "settings"),
        effects,
        (0, 1, 2, 3),
        note="Default: of the catalogue, or the uncertainty that the campaign states.",
    )
    yield Sheet("Software", ("package", "fit", "report"), software, (0, 1, 2))  # fmt: skip
