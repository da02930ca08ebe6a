"""The outcome of `imubayes check`: the runs, what the reduction did, the findings, and the size of a model."""

from typing import Literal

import numpy as np

from imubayes.campaign import Inspection
from imubayes.campaign.unit_grade import grade_of
from imubayes.campaign_data import Campaign, Run
from imubayes.display.report_layout import Report
from imubayes.display.table_layout import Cell, Sheet
from imubayes.errors import InputError
from imubayes.json_record import Record
from imubayes.parameters.unit_grades import Grade


class CheckedRun(Record):
    """One run as reduced."""

    name: str
    procedure: str
    rows: int
    notes: tuple[str, ...]


class CheckedFinding(Record):
    """One finding, in its full text."""

    name: str
    severity: str
    text: str


class CheckedGrade(Record):
    """Grade of the channels of one kind, to which default priors belong; whether the campaign states it."""

    kind: str
    grade: Grade
    stated: bool


class CheckedModel(Record):
    """Size of a model bound to the campaign."""

    name: str
    parameters: int
    noise_parameters: int
    measured_values: int


class Check(Record):
    """What `imubayes check --json` prints."""

    format: Literal[1] = 1
    campaign: str
    channels: tuple[str, ...]
    grades: tuple[CheckedGrade, ...]
    runs: tuple[CheckedRun, ...]
    findings: tuple[CheckedFinding, ...]
    notes: tuple[str, ...]
    model: CheckedModel | None


def check_record(inspection: Inspection, model: CheckedModel | None) -> Check:
    """Return the outcome of a check; raises InputError where the campaign cannot be used."""
    campaign = usable(inspection)
    return Check(
        campaign=campaign.name,
        channels=tuple(channel.name for channel in campaign.channels),
        grades=_grades(campaign),
        runs=tuple(
            CheckedRun(name=run.name, procedure=run.procedure, rows=run.rows, notes=run.notes) for run in campaign.runs
        ),
        findings=tuple(
            CheckedFinding(name=finding.name, severity=finding.severity, text=str(finding))
            for finding in inspection.findings
        ),
        notes=campaign.notes,
        model=model,
    )


def _grades(campaign: Campaign) -> tuple[CheckedGrade, ...]:
    kinds = dict.fromkeys(channel.kind for channel in campaign.channels if channel.kind != "angle")
    stated = campaign.grade is not None
    return tuple(CheckedGrade(kind=kind, grade=grade_of(campaign, kind), stated=stated) for kind in kinds)


def _grade_lines(campaign: Campaign) -> list[str]:
    """Return which grade default priors belong to, where it is stated or coarser than tactical."""
    grades = _grades(campaign)
    if all(found.grade == "tactical" and not found.stated for found in grades):
        return []
    each = ", ".join(f"{found.kind}s {found.grade}" for found in grades)
    origin = "as stated" if grades[0].stated else "from the noise of the channels; 'grade' under [unit] states it"
    return [f"grade of the default priors: {each} ({origin})"]


def check_report(inspection: Inspection, model: CheckedModel | None) -> Report:
    """Return the outcome of a check as a report; raises InputError where the campaign cannot be used."""
    campaign = usable(inspection)
    site = campaign.site
    heading = (
        f"{campaign.name}  {len(campaign.channels)} channels, {len(campaign.runs)} runs, "
        f"latitude {np.degrees(site.latitude):.4f} deg, gravity {site.gravity:.5f} m/s²"
    )
    head = ("run", "procedure", "table", "mounting", "rows", "samples", "°C")
    rows = [_run_row(run) for run in campaign.runs]
    narrow = Sheet("Runs", (*head[:2], *head[4:]), [[*row[:2], *row[4:]] for row in rows], (0, 1))
    sheet = Sheet("Runs", head, rows, (0, 1, 2, 3), narrow=narrow)
    closing = [f"note: {note}" for note in campaign.notes]
    closing += [f"note: {run.name}: {note}" for run in campaign.runs for note in run.notes]
    closing += _grade_lines(campaign)
    if model is not None:
        closing.append(
            f"model '{model.name}' fits this campaign: {model.parameters} parameters, "
            f"{model.noise_parameters} of noise, {model.measured_values} measured values"
        )
    warnings = sum(finding.severity == "warning" for finding in inspection.findings)
    return Report([heading], [sheet], [*closing, f"{warnings} warnings" if warnings else "no findings"])


def warning_lines(inspection: Inspection) -> list[str]:
    """Return the warnings about the data of a campaign, one line each."""
    return [f"warning: {finding}" for finding in inspection.findings if finding.severity == "warning"]


def _run_row(run: Run) -> list[Cell]:
    temperature = run.covariates.get("temperature")
    ends = [] if temperature is None else [f"{np.min(temperature):.1f}", f"{np.max(temperature):.1f}"]
    span = "\u00a0…\u00a0".join(dict.fromkeys(ends)) or "–"  # no line break within
    texts = (
        run.name,
        run.procedure,
        run.table or "–",
        run.mounting or "–",
        str(run.rows),
        f"{np.sum(run.samples):.0f}",
    )
    return [Cell(text) for text in (*texts, span)]


def usable(inspection: Inspection) -> Campaign:
    """Return the campaign of an inspection; raises InputError with every issue where it cannot be used."""
    if inspection.campaign is None:
        raise InputError(inspection.issues)
    return inspection.campaign
