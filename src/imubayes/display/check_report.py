"""Report of `imubayes check`: the runs and findings of a campaign.

It states what the reduction of each run did, the findings, and the size of a model.  Notes and warnings that many runs
share appear once: the runs are counted and numbers become ranges.
"""

import re
from collections.abc import Sequence
from typing import Literal

import numpy as np

from imubayes.campaign import Inspection
from imubayes.campaign.unit_grade import grade_of
from imubayes.display.fit_cautions import left_out_lines
from imubayes.display.layout import Report, Sheet, cells
from imubayes.display.numbers_and_labels import listed
from imubayes.foundations.campaign_data import Campaign, Grade, Run
from imubayes.foundations.errors import InputError
from imubayes.foundations.records import Record
from imubayes.foundations.wording import counted
from imubayes.foundations.wrong_records import WrongRecord
from imubayes.model.model_file import SingleRunEffect

_CHANGING = re.compile(r"'[^']*'|\"[^\"]*\"|(?<![\w.])\d+(?:\.\d+)?(?:[eE][-+]?\d+)?(?!\w)")
_MOST_NAMES = 4


def grouped(notes: Sequence[tuple[str, str]]) -> list[str]:
    """Return each note once, in the order of first appearance, with the runs it is about.

    Notes that differ in numbers and quoted names only are one note: its numbers are given as a range, its names as a
    list.

    Parameters
    ----------
    notes : pairs of the name of a run, empty for the campaign, and a text.
    """
    groups: dict[tuple[bool, str], list[tuple[str, str]]] = {}
    for run, text in notes:
        groups.setdefault((bool(run), _CHANGING.sub("\0", text)), []).append((run, text))
    return [_said(members) for members in groups.values()]


def _said(members: Sequence[tuple[str, str]]) -> str:
    """Return notes of one form as one line."""
    runs = list(dict.fromkeys(run for run, _ in members if run))
    columns = list(zip(*(_CHANGING.findall(text) for _, text in members), strict=True))
    merged = iter([_merged(list(dict.fromkeys(column))) for column in columns])
    text = _CHANGING.sub(lambda _: next(merged), members[0][1])
    if not runs:
        return text
    who = f"{len(runs)} runs ({listed(runs, _MOST_NAMES)})" if len(runs) > 1 else runs[0]
    return f"{who}: {text}"


def _merged(parts: Sequence[str]) -> str:
    """Return numbers as a range, and quoted names as a list."""
    if len(parts) == 1:
        return parts[0]
    if parts[0][0] in "'\"":
        return listed(parts, _MOST_NAMES)
    ordered = sorted(parts, key=float)
    return f"{ordered[0]} … {ordered[-1]}"


_MOST_RUNS = 8
"""Up to so many runs are listed one by one."""


class CheckedRun(Record):
    """One run as reduced."""

    name: str
    procedure: str
    rows: int
    notes: tuple[str, ...]


class CheckedFinding(Record):
    """One finding, in its full text, with what is wrong in the record of a run if that is known."""

    name: str
    severity: str
    text: str
    record: WrongRecord | None = None


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
    untold: tuple[str, ...] = ()
    left_out: tuple[SingleRunEffect, ...] = ()


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
    """Return the outcome of a check; raises InputError if the campaign cannot be used."""
    campaign = usable(inspection)
    return Check(
        campaign=campaign.name,
        channels=tuple(channel.name for channel in campaign.channels),
        grades=_grades(campaign),
        runs=tuple(CheckedRun.model_validate(run, from_attributes=True) for run in campaign.runs),
        findings=tuple(
            CheckedFinding(name=finding.name, severity=finding.severity, text=str(finding), record=finding.record)
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
    """Return which grade default priors belong to, if it is stated or coarser than tactical."""
    grades = _grades(campaign)
    if all(found.grade == "tactical" and not found.stated for found in grades):
        return []
    each = ", ".join(f"{found.kind}s {found.grade}" for found in grades)
    origin = "as stated" if grades[0].stated else "from the noise of the channels; 'grade' under [unit] overrides it"
    return [f"grade of the default priors: {each} ({origin})"]


def check_report(
    inspection: Inspection, model: CheckedModel | None, command: str = "", verbose: bool = False
) -> Report:
    """Return the outcome of a check as a report; raises InputError if the campaign cannot be used.

    Parameters
    ----------
    command : the next command.
    verbose : list every run and every note; otherwise runs of one table and notes of one form are one line.
    """
    campaign = usable(inspection)
    site, names = campaign.site, [channel.name for channel in campaign.channels]
    warnings = warning_lines(inspection, verbose)
    count = sum(finding.severity == "warning" for finding in inspection.findings)
    lines = [
        f"{campaign.name}: {counted(count, 'warning') if count else 'no findings'}",
        f"{counted(len(campaign.runs), 'run')}, {counted(len(names), 'channel')} ({listed(names, 8)}), "
        f"latitude {np.degrees(site.latitude):.4f} deg, gravity {site.gravity:.5f} m/s²",
    ]
    if model is not None:
        lines.append(
            f"model '{model.name}' can be fitted to this campaign: {counted(model.parameters, 'parameter')} "
            f"and {model.noise_parameters} of the noise, {counted(model.measured_values, 'measured value')}"
        )
        if model.untold:
            lines.append(
                "more parameters than measured values: these runs supply less than 10 % of the information on "
                f"{', '.join(model.untold)}, so that the fit would return the prior. Leave negligible effects out of "
                "the model, or record more runs"
            )
        lines += left_out_lines(model.left_out)
    lines += [*_grade_lines(campaign), *warnings, *([f"next: {command}"] if command else [])]
    every = verbose or len(campaign.runs) <= _MOST_RUNS
    sheet = run_sheet(campaign) if every else table_sheet(campaign)
    closing = [f"note: {note}" for note in _notes(inspection, campaign, verbose)]
    if not every:
        closing.append("--verbose lists every run and every note.")
    return Report(lines, [sheet], closing)


def warning_lines(inspection: Inspection, verbose: bool = False) -> list[str]:
    """Return the warnings about the data of a campaign, one line each; one for those of many runs unless verbose."""
    found = [("", str(finding)) for finding in inspection.findings if finding.severity == "warning"]
    return [text for _, text in found] if verbose else grouped(found)


def _notes(inspection: Inspection, campaign: Campaign, verbose: bool) -> list[str]:
    """Return the notes on the campaign and its runs that are no warnings."""
    said = {str(finding) for finding in inspection.findings}
    said |= {f"{finding.name}: {finding.what}" for finding in inspection.findings}
    notes = [("", note) for note in campaign.notes] + [(run.name, note) for run in campaign.runs for note in run.notes]
    kept = [(run, note) for run, note in notes if note not in said]
    return [f"{run}: {note}" if run else note for run, note in kept] if verbose else grouped(kept)


def run_sheet(campaign: Campaign) -> Sheet:
    """Return the table of the runs."""
    head = ("run", "procedure", "table", "mounting", "rows", "samples", "°C")
    rows = [
        cells(
            run.name, run.procedure, run.table or "–", run.mounting or "–", str(run.rows), f"{np.sum(run.samples):.0f}",
            _span([run]),
        )
        for run in campaign.runs
    ]  # fmt: skip
    return Sheet("Runs", head, rows, (0, 1, 2, 3)).with_few(0, 1, 4, 5, 6)


def table_sheet(campaign: Campaign) -> Sheet:
    """Return the table of the runs of each procedure and table together."""
    groups: dict[tuple[str, str | None], list[Run]] = {}
    for run in campaign.runs:
        groups.setdefault((run.procedure, run.table), []).append(run)
    rows = []
    for (procedure, table), runs in groups.items():
        mountings = list(dict.fromkeys(run.mounting for run in runs if run.mounting))
        count, samples = sum(run.rows for run in runs), sum(np.sum(run.samples) for run in runs)
        seats = listed(mountings, 4) if mountings else "–"
        rows.append(cells(procedure, table or "–", seats, str(len(runs)), str(count), f"{samples:.0f}", _span(runs)))
    head = ("procedure", "table", "mountings", "runs", "rows", "samples", "°C")
    return Sheet("Runs by procedure and table", head, rows, (0, 1, 2))


def _span(runs: Sequence[Run]) -> str:
    """Return the range of the temperature in runs."""
    found = [run.covariates["temperature"] for run in runs if "temperature" in run.covariates]
    values = np.concatenate(found) if found else np.zeros(0)
    ends = [f"{np.min(values):.1f}", f"{np.max(values):.1f}"] if len(values) else []
    return "\u00a0…\u00a0".join(dict.fromkeys(ends)) or "–"  # no line break within


def usable(inspection: Inspection) -> Campaign:
    """Return the campaign of an inspection; raises InputError with every issue if it cannot be used."""
    if inspection.campaign is None:
        raise InputError(inspection.issues)
    return inspection.campaign
