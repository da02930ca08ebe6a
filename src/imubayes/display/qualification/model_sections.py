"""Sections on what the numbers rest on: equipment, adequacy, convergence, what was left out, scope, provenance."""

from collections.abc import Sequence

from imubayes.display.fit_cautions import violation_text
from imubayes.display.loop.diagnosis_sentences import bias_clause, evidence_text
from imubayes.display.numbers_and_labels import (
    NO_NUMBER,
    chance_text,
    percent,
    pretty,
    ratio_text,
    significant,
    value_and_sd,
)
from imubayes.display.qualification.document import Block, Heading, Items, Paragraph, ReportTable, Text
from imubayes.display.qualification.words import VERDICTS, enumerated, hash_text
from imubayes.qualification.report_record import (
    Adequacy,
    Omissions,
    Provenance,
    ReportedConvergence,
    StatisticalScope,
    Subject,
)
from imubayes.qualification.report_subject import ReportedTable

_NOISE = {
    "autocorrelation": "residuals are autocorrelated",
    "low_frequency": "residuals drift within runs",
    "scatter_between_runs": "runs scatter more than the noise within them",
    "grows_with_input": "the noise grows with the input",
    "heavy_tails": "the noise has heavy tails or outliers",
    "quantisation": "the output is quantised too coarsely for its noise",
}


def equipment_section(subject: Subject) -> list[Block]:
    """Return site, channels, tables, mountings and runs."""
    site = (
        f"Latitude {subject.latitude_deg:.6g}°, height {subject.height_m:.6g} m, "
        f"gravity {subject.gravity_m_s2:.6f} m/s²; 1 g in this report is the gravity of the site."
    )
    channels = [
        (
            Text(channel.name), Text(channel.kind), Text(_vector(channel.input_axis)),
            Text(_vector(channel.output_axis)),
            Text(f"{channel.nominal_scale:g} {channel.output_unit} per {channel.per}"),
            Text(f"{channel.nominal_offset:g}"),
        )
        for channel in subject.channels
    ]  # fmt: skip
    tables = [
        (
            Text(table.name), Text(f"{table.azimuth_deg:g}"), Text(f"{table.elevation_deg:g}"),
            Text(_axis_known(table)), Text(_known(table.rate_uncertainty_ppm)),
            Text(_known(table.angle_uncertainty_arcsec)),
        )
        for table in subject.tables
    ]  # fmt: skip
    mountings = [(Text(each.name), Text(_known(each.uncertainty_arcmin))) for each in subject.mountings]
    runs = [
        (
            Text(run.name), Text(run.procedure.replace("_", " ")), Text(run.table or NO_NUMBER),
            Text(run.mounting or NO_NUMBER), Text((run.start or NO_NUMBER).replace("T", " ")),
            Text(str(run.rows)), Text(str(run.values_used)),
        )
        for run in subject.runs
    ]  # fmt: skip
    found: list[Block] = [Heading("Unit, site and equipment"), Paragraph(site)]
    head = ("channel", "kind", "input axis", "output axis", "nominal scale factor", "nominal offset")
    found.append(ReportTable("Channels", head, channels, (0, 1, 2, 3), "Axes in the body frame, as designed."))
    if tables:
        head = ("table", "azimuth / deg", "elevation / deg", "axis / arcsec", "rate / ppm", "angle / arcsec")
        found.append(ReportTable("Tables", head, tables, (0,), "Standard uncertainties as stated."))
    if mountings:
        found.append(
            ReportTable(
                "Mountings", ("mounting", "seat / arcmin"), mountings, (0,), "Standard uncertainty, each angle."
            )
        )
    head = ("run", "procedure", "table", "mounting", "start", "rows", "values")
    found.append(ReportTable("Runs", head, runs, (0, 1, 2, 3, 4), "Values: rows times channels that the fit used."))
    return found


def _vector(axis: tuple[float, float, float]) -> str:
    return "(" + ", ".join(f"{value:.4g}" for value in axis) + ")"


def _axis_known(table: ReportedTable) -> str:
    """Return the uncertainty of an axis: one value, or azimuth and elevation."""
    apart = (("azimuth", table.azimuth_uncertainty_arcsec), ("elevation", table.elevation_uncertainty_arcsec))
    own = [f"{name} {value:.4g}" for name, value in apart if value is not None]
    return ", ".join([*own, *([_known(table.axis_uncertainty_arcsec)] if len(own) < 2 else [])])


def _known(value: float | None) -> str:
    return NO_NUMBER if value is None else f"{value:.4g}"


def adequacy_section(adequacy: Adequacy) -> list[Block]:
    """Return the verdict of the diagnosis and the history of models."""
    verdict = adequacy.verdict
    found: list[Block] = [Heading("Model adequacy")]
    if verdict is None:
        found.append(Paragraph("This result was never diagnosed.", "bad"))
    else:
        found.append(
            Paragraph(f"Verdict of the diagnosis: {VERDICTS[verdict]}.", "" if verdict == "adequate" else "bad")
        )
        found.append(Paragraph(_search(adequacy)))
    if adequacy.missing:
        found.append(Paragraph(f"Missing, or indistinguishable from what is: {enumerated(adequacy.missing)}.", "bad"))
    for each in adequacy.noise_violations:
        how = chance_text(each.p) if each.p is not None else ""
        found.append(
            Paragraph(f"Noise: {_NOISE[each.kind]} ({', '.join(each.channels)}{', p = ' + how if how else ''}).", "bad")
        )
    if adequacy.noise_suspected:
        found.append(
            Paragraph(f"Noise, suspected, although it may be chance: {violation_text(adequacy.noise_suspected)}.")
        )
    if adequacy.undetectable:
        found.append(
            Paragraph(
                f"{len(adequacy.undetectable)} effects of the catalogue are undetectable in these runs, which is not "
                f"the same as absent: {enumerated(adequacy.undetectable, 40)}."
            )
        )
    if adequacy.most_biasing is not None:
        found.append(Paragraph(f"No interval includes them: {bias_clause(adequacy.most_biasing)}."))
    if adequacy.chi2 is not None:
        ratio = ratio_text(adequacy.chi2 / adequacy.dof) if adequacy.dof else NO_NUMBER
        found.append(
            Paragraph(
                f"χ² = {adequacy.chi2:.1f} for {adequacy.dof:.0f} degrees of freedom (ratio {ratio}). The noise scales "
                "are fitted, so that the ratio is near 1 by construction; the tests above do not depend on it."
            )
        )
    found += _history(adequacy) + _conflicts(adequacy) + _fit_table(adequacy)
    return found


def _search(adequacy: Adequacy) -> str:
    weighed = "" if adequacy.explanations is None else f" {evidence_text(adequacy.explanations)}"
    times = {0: "never", 1: "once", 2: "twice"}.get(adequacy.diagnoses, f"{adequacy.diagnoses} times")
    return (
        f"The diagnosis weighed {adequacy.candidates} effects that these runs can show.{weighed} A model of this unit "
        f"was diagnosed {times}, this result included."
    )


def _history(adequacy: Adequacy) -> list[Block]:
    if not adequacy.history:
        return []
    rows = []
    for node in adequacy.history:
        state = ", ".join(
            word
            for word, true in (
                ("this report", node.reported), ("selected", node.selected), ("refit not taken", not node.taken)
            )
            if true
        )  # fmt: skip
        ratio = node.chi2 / node.dof if node.chi2 is not None and node.dof else None
        rows.append(
            (
                Text("→ " * node.depth + node.title), Text((node.verdict or NO_NUMBER).replace("_", " ")),
                Text(NO_NUMBER if node.chi2 is None else f"{node.chi2:.1f}"), Text(ratio_text(ratio)), Text(state),
            )
        )  # fmt: skip
    note = (
        "Each model below the one it was made from. Verdict: of the diagnosis that led to it. χ² is at the noise "
        "known beforehand. The more models were tried, the more of the agreement is selection."
    )
    head = ("model", "verdict before", "χ²", "χ²/ν", "")
    return [ReportTable("Models tried", head, rows, (0, 1, 4), note)]


def _conflicts(adequacy: Adequacy) -> list[Block]:
    if not adequacy.prior_conflicts:
        return []
    rows = [
        (
            Text(each.name), Text(" ± ".join(value_and_sd(each.prior_mean, each.prior_sd))),
            Text(" ± ".join(value_and_sd(each.data_value, each.data_sd))), Text(pretty(each.unit)),
            Text(f"{each.distance:.1f}"),
        )
        for each in adequacy.prior_conflicts
    ]  # fmt: skip
    head = ("parameter", "prior", "data alone", "unit", "distance / sd")
    return [
        ReportTable("Priors that disagree with the data", head, rows, (0, 3), "Unit or equipment is worse than stated.")
    ]


def _fit_table(adequacy: Adequacy) -> list[Block]:
    rows = [
        (
            Text(run.name), Text(run.channel), Text(str(run.n)),
            Text(ratio_text(run.chi2 / run.n if run.chi2 is not None and run.n else None)),
            Text(significant(run.rms)), Text(pretty(run.unit)),
        )
        for run in adequacy.runs
    ]  # fmt: skip
    head = ("run", "channel", "values", "χ²/n", "rms residual", "unit")
    note = "χ²/n: mean square of the standardised residuals, near 1 where the noise model holds."
    return [ReportTable("Goodness of fit by run and channel", head, rows, (0, 1, 5), note)]


def convergence_section(found: ReportedConvergence) -> list[Block]:
    """Return whether fit and sampling converged."""
    blocks: list[Block] = [Heading("Convergence")]
    if not found.converged:
        return [*blocks, Paragraph(f"The fit did not converge. {found.message}", "bad")]
    blocks.append(Paragraph("The fit converged." if not found.sampled else "Fit and sampling converged."))
    if not found.sampled:
        blocks.append(
            Paragraph(
                f"The posterior was not sampled: it is the Laplace approximation, {found.draws} independent draws. "
                "Sampled posteriors also contain the curvature that it leaves out (`imubayes fit` without --no-sample)."
            )
        )
        return blocks
    rows = [
        (Text("largest R̂"), Text(_decimals(found.worst_r_hat, 4)), Text("≤ 1.01"), Text(found.worst_r_hat_of)),
        (
            Text("least bulk effective size"),
            Text(_decimals(found.least_bulk, 0)),
            Text("≥ 400"),
            Text(found.least_bulk_of),
        ),
        (
            Text("least tail effective size"),
            Text(_decimals(found.least_tail, 0)),
            Text("≥ 400"),
            Text(found.least_tail_of),
        ),
        (Text("acceptance"), Text(_decimals(found.acceptance, 2)), Text(""), Text("")),
        (Text("Pareto k of the proposal"), Text(_decimals(found.pareto_k, 2)), Text("< 0.7"), Text("")),
        (Text("draws"), Text(str(found.draws)), Text(""), Text("")),
    ]
    note = "R̂ compares independent ensembles. Parameter: the one that has the worst value."
    return [*blocks, ReportTable("Sampling", ("diagnostic", "value", "required", "parameter"), rows, (0, 3), note)]


def _decimals(value: float | None, count: int) -> str:
    return NO_NUMBER if value is None else f"{value:.{count}f}"


def left_out_section(found: Omissions) -> list[Block]:
    """Return what was left out, and why."""
    items = [
        f"{each.run}: {each.values} values of {each.channel} are missing in the record." for each in found.channels
    ]
    items += list(found.notes)
    if found.outliers:
        items.append(
            f"{found.outliers} outliers were found by the diagnosis. Its search excludes them, the fit does not."
        )
    if found.nuisance_parameters:
        items.append(f"{found.nuisance_parameters} nuisance parameters, such as attitudes of poses, are not listed.")
    blocks: list[Block] = [Heading("What was left out")]
    if not items:
        return [
            *blocks,
            Paragraph("Nothing: every recorded value of every run was used, and every parameter is listed."),
        ]
    return [*blocks, Items(items)]


def scope_section(scope: StatisticalScope) -> list[Block]:
    """Return what the statistics do not cover."""
    rows = [
        (Text(each.phrase), Text(f"{each.lowest:.5g}"), Text(f"{each.highest:.5g}"), Text(pretty(each.unit)))
        for each in scope.ranges
    ]
    items = [
        "Other units: every number is of this unit. What is known of a production is no part of it, except where a "
        "limit states one.",
        "Conditions outside the ranges above, and their combinations that no run had.",
        "Change after the last run: ageing, storage, transport, and repeated switching on, unless runs show it.",
        "Errors that the equipment and all runs share and that no prior of the model describes.",
    ]
    if scope.not_supplied:
        named = enumerated([f"{effect} ({needs or 'no run responds'})" for effect, needs in scope.not_supplied], 40)
        items.append(f"Effects that no run could show, with what a run would have to supply: {named}.")
    if scope.from_priors:
        items.append(
            f"{len(scope.from_priors)} quantities are known from their priors alone: "
            f"{enumerated(scope.from_priors, 20)}. Their uncertainty is that of a "
            "certificate or an assumption, and no measurement confirmed it."
        )
    weak = [
        (Text(_combination(each.quantities, each.weights, each.left_out)), Text(percent(each.from_data)))
        for each in scope.weak_directions
    ]
    blocks: list[Block] = [Heading("What the statistics do not cover")]
    if rows:
        blocks.append(ReportTable("Tested ranges", ("covariate", "lowest", "highest", "unit"), rows, (0, 3)))
    blocks.append(Items(items))
    if weak:
        note = "The data determine these combinations hardly or not at all: they rest on the priors of their members."
        blocks.append(ReportTable("Weakly determined combinations", ("combination", "from data"), weak, (0,), note))
    return blocks


def _combination(names: Sequence[str], weights: Sequence[float], left_out: int) -> str:
    """Return a weighted sum in words; the names alone where there are no weights."""
    if not weights:
        return " against ".join(names)
    text = ""
    for name, weight in zip(names, weights, strict=True):
        sign = " − " if weight < 0 else " + "
        size = "" if abs(abs(weight) - 1) < 0.05 else f"{abs(weight):.2g}·"
        text += (sign if text else ("−" if weight < 0 else "")) + size + name
    return text + (f" and {left_out} more" if left_out else "")


def provenance_section(found: Provenance) -> list[Block]:
    """Return model, hashes, seed and software."""
    effects = [
        (
            Text(effect.name), Text(", ".join(effect.channels) if effect.channels else "all that it can act on"),
            Text("; ".join(f"{name} ~ {prior}" for name, prior in effect.prior.items()) or "default"),
            Text("; ".join(f"{name} = {value:g}" for name, value in effect.options.items()) or NO_NUMBER),
        )
        for effect in found.effects
    ]  # fmt: skip
    fitted = {each.package: each.version for each in found.fit_software}
    software = [
        (Text(each.package), Text(fitted.get(each.package, "not recorded")), Text(each.version))
        for each in found.software
    ]
    hashes = [
        (Text("data"), Text(hash_text(found.data_sha256))),
        (Text("model"), Text(hash_text(found.model_sha256))),
        (Text("seed"), Text(str(found.seed))),
        (Text("fitted"), Text(found.fitted or "not recorded")),
    ]
    return [
        Heading("Model, hashes and software"),
        ReportTable("Identification", ("what", "value"), hashes, (0, 1), "SHA-256 of campaign and model."),
        ReportTable("Effects of the model", ("effect", "channels", "priors in the model file", "settings"), effects,
              (0, 1, 2, 3), "Default: of the catalogue, or the uncertainty that the campaign states."),
        ReportTable("Software", ("package", "fit", "report"), software, (0, 1, 2)),
    ]  # fmt: skip
