"""The judgement of the set-up as findings: what is wrong, by how much, and what to correct.

The remedy of every kind of mistake stands in one table, beside how the mistake is said.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from imubayes.campaign.findings import Finding, Severity
from imubayes.campaign.setup_gate.mistakes import (
    AngleUnit,
    ChannelGain,
    ChannelsExchanged,
    FilesExchanged,
    Mistake,
    MountingMislabelled,
    MountingWrong,
    RateUnit,
)
from imubayes.campaign.setup_gate.search import DECISIVE, Explanation, Judgement, judge_setup
from imubayes.campaign_data import Campaign


@dataclass(frozen=True)
class _Words:
    """How a mistake is said: what is wrong, where it stands, what would be right, and what to do."""

    what: str
    where: str
    allowed: str
    remedy: str


def setup_findings(
    campaign: Campaign, file: str, tables: Mapping[str, str], accepted: tuple[str, ...]
) -> list[Finding]:
    """Return what the outputs say against the set-up of a campaign.

    Parameters
    ----------
    file : of the campaign.
    tables : run → its table file.
    accepted : names of findings that the campaign accepts; they are warnings.
    """
    judged = judge_setup(campaign)
    if judged.explanations:
        return [_explained(campaign, judged, file, tables, accepted)]
    return [_unexplained(name, misfit, tables.get(name, file)) for name, misfit in judged.unexplained[:_MOST_RUNS]]


_MOST_RUNS = 5


def _explained(
    campaign: Campaign, judged: Judgement, file: str, tables: Mapping[str, str], accepted: tuple[str, ...]
) -> Finding:
    found = [(each, _words(campaign, each, file, tables)) for each in judged.explanations]
    (first, words), others = found[0], found[1:]
    evidence = f"the outputs fit that far better (Δχ² {first.gain:.3g})"
    remedy = words.remedy
    if others:
        evidence += "; equally good: " + "; ".join(each.what for _, each in others[:_MOST_ALTERNATIVES])
        remedy += " (or: " + "; ".join(each.remedy for _, each in others[:_MOST_ALTERNATIVES]) + ")"
    # Weaker evidence is said and stops nothing.
    sure = first.gain > DECISIVE and not {each.mistake.kind for each, _ in found} & {*accepted}
    severity: Severity = "error" if sure else "warning"
    if sure:
        remedy += f'; accepted = ["{first.mistake.kind}"] in campaign.toml lets the campaign pass as it is'
    run = first.mistake.scope.name if first.mistake.scope.section == "run" else ""
    return Finding(
        first.mistake.kind, severity, run, f"{words.what}: {evidence}", words.where, words.allowed, remedy
    )  # fmt: skip


_MOST_ALTERNATIVES = 3


def _unexplained(run: str, misfit: float, where: str) -> Finding:
    what = (
        f"the outputs differ from what the set-up says by about {math.sqrt(misfit):.2g} times as much as errors of "
        "unit and equipment allow; no single mistake in the set-up explains it"
    )
    remedy = "check mounting, table, units and files of the run"
    return Finding("setup_disagrees", "warning", run, what, where, "outputs that follow the nominal input", remedy)


def _words(campaign: Campaign, found: Explanation, file: str, tables: Mapping[str, str]) -> _Words:
    return _WORDS[found.mistake.kind](campaign, found, file, tables)


def _subject(mistake: Mistake, campaign: Campaign) -> str:
    scope = mistake.scope
    if scope.section == "run":
        return f"in run '{scope.name}'"
    if scope.section == "campaign":
        return "in all runs"
    return f"in all runs on table '{scope.name}'" if scope.section == "table" else f"in all runs in '{scope.name}'"


def _place(mistake: Mistake, file: str, tables: Mapping[str, str], column: str) -> str:
    scope = mistake.scope
    if scope.section == "run":
        return f"{tables.get(scope.name, file)}, column '{column}'"
    return f"{file}, {scope.section} '{scope.name}'" if scope.name else file


def _signed(angle: float) -> str:
    """Return an angle in deg within ±180, with its sign."""
    degrees = (math.degrees(angle) + 180) % 360 - 180
    return f"{degrees if degrees != -180 else 180.0:+.4g} deg"


def _zero(campaign: Campaign, found: Explanation, file: str, tables: Mapping[str, str]) -> _Words:
    shift = _signed(found.size)
    return _Words(
        f"the zero of the table angle is off by {_signed(-found.size)} {_subject(found.mistake, campaign)}",
        _place(found.mistake, file, tables, "table_angle_deg"),
        "angles from the stated zero, at which the table axes are as azimuth and elevation say",
        f"add {shift} to 'table_angle_deg' {_subject(found.mistake, campaign)}, or correct the zero",
    )


def _turned(campaign: Campaign, found: Explanation, file: str, tables: Mapping[str, str]) -> _Words:
    name = found.mistake.scope.name
    return _Words(
        f"mounting '{name}' is turned by {_signed(found.size)} about the axis of the table",
        f"{file}, mounting '{name}'",
        "body_to_table of the unit as it was mounted",
        f"turn body_to_table of '{name}' by {_signed(found.size)} about the table axis, or correct the angles",
    )


def _sense(campaign: Campaign, found: Explanation, file: str, tables: Mapping[str, str]) -> _Words:
    where = _subject(found.mistake, campaign)
    return _Words(
        f"the table turns against the stated sense {where}",
        _place(found.mistake, file, tables, "table_angle_deg"),
        "rates and angles right-handed about the axis of the table",
        f"reverse the sign of 'table_rate_deg_s' and 'table_angle_deg' {where}",
    )


def _elevation(campaign: Campaign, found: Explanation, file: str, tables: Mapping[str, str]) -> _Words:
    places = found.mistake.scope.runs
    names = dict.fromkeys(campaign.tables)
    run = next((run for run in campaign.runs if run.name == found.mistake.scope.name), None)
    name = found.mistake.scope.name if found.mistake.scope.section == "table" or run is None else str(run.table)
    stated = math.degrees(campaign.tables[name].elevation) if name in names and places else math.nan
    actual = (stated + math.degrees(found.size) + 180) % 360 - 180
    folded = actual if abs(actual) <= 90 else math.copysign(180, actual) - actual
    return _Words(
        f"the elevation of the axis of table '{name}' is {folded:.4g} deg, not {stated:.4g} deg "
        f"{_subject(found.mistake, campaign)}",
        f"{file}, table '{name}', elevation_deg",
        "the elevation of the axis above the horizontal",
        f"correct elevation_deg of table '{name}' to {folded:.4g}"
        + ("" if abs(actual) <= 90 else ", and turn azimuth_deg and the zero of the angle by 180"),
    )


def _azimuth(campaign: Campaign, found: Explanation, file: str, tables: Mapping[str, str]) -> _Words:
    name = found.mistake.scope.name
    stated = math.degrees(campaign.tables[name].azimuth)
    actual = (stated + math.degrees(found.size)) % 360
    return _Words(
        f"the azimuth of the axis of table '{name}' is about {actual:.3g} deg, not {stated:.4g} deg",
        f"{file}, table '{name}', azimuth_deg",
        "the azimuth of the axis, clockwise from North",
        f"correct azimuth_deg of table '{name}' to {actual:.3g}",
    )


def _label(campaign: Campaign, found: Explanation, file: str, tables: Mapping[str, str]) -> _Words:
    mistake = found.mistake
    assert isinstance(mistake, MountingMislabelled)
    where, name = _subject(mistake, campaign), mistake.scope.name
    single = mistake.scope.section == "run"
    return _Words(
        f"the unit sat in mounting '{mistake.actual}' {where}",
        f"{file}, run '{name}', mounting" if single else f"{file}, mounting '{name}'",
        "the mounting that the run was made in",
        f"name '{mistake.actual}' as 'mounting' {where}" if single else
        f"correct body_to_table of '{name}' to that of '{mistake.actual}'",
    )  # fmt: skip


def _files(campaign: Campaign, found: Explanation, file: str, tables: Mapping[str, str]) -> _Words:
    mistake = found.mistake
    assert isinstance(mistake, FilesExchanged)
    return _Words(
        f"the tables of runs '{mistake.scope.name}' and '{mistake.second}' are exchanged",
        f"{file}, run '{mistake.scope.name}' and run '{mistake.second}', file",
        "the file of the run itself",
        f"exchange 'file' of runs '{mistake.scope.name}' and '{mistake.second}'",
    )


def _matrix(campaign: Campaign, found: Explanation, file: str, tables: Mapping[str, str]) -> _Words:
    mistake = found.mistake
    assert isinstance(mistake, MountingWrong)
    where, rows = _subject(mistake, campaign), np.round(mistake.matrix, 4) + 0.0
    name = mistake.scope.name
    what = "the transpose of body_to_table fits" if mistake.transposed else "the unit sat in another orientation"
    return _Words(
        f"{what} {where}",
        f"{file}, run '{name}', mounting" if mistake.scope.section == "run" else f"{file}, mounting '{name}'",
        "column k of body_to_table is body axis k in the table frame",
        f"correct body_to_table {where} to {rows.tolist()}",
    )


def _latitude(campaign: Campaign, found: Explanation, file: str, tables: Mapping[str, str]) -> _Words:
    latitude = math.degrees(campaign.site.latitude)
    return _Words(
        f"the gyros show the Earth rate at latitude {-latitude:.4g} deg, not {latitude:.4g} deg",
        f"{file}, site, latitude_deg",
        "degrees, positive north of the equator",
        f"correct latitude_deg to {-latitude:.4g}",
    )


def _channels(campaign: Campaign, found: Explanation, file: str, tables: Mapping[str, str]) -> _Words:
    mistake = found.mistake
    assert isinstance(mistake, ChannelsExchanged)
    where = _subject(mistake, campaign)
    pairs = [(campaign.channels[a].name, campaign.channels[b].name) for a, b in
             zip(mistake.places, mistake.order, strict=True)]  # fmt: skip
    columns = ", ".join(f"'{name}'" for name, _ in pairs)
    return _Words(
        f"channels {columns} are exchanged {where}",
        _place(mistake, file, tables, pairs[0][0]),
        "every channel in its own column, with its own input_axis",
        "rename the columns: " + ", ".join(f"'{a}' holds '{b}'" for a, b in pairs),
    )


def _gain(campaign: Campaign, found: Explanation, file: str, tables: Mapping[str, str]) -> _Words:
    mistake = found.mistake
    assert isinstance(mistake, ChannelGain)
    where, names = _subject(mistake, campaign), ", ".join(f"'{name}'" for name in mistake.channels)
    noun = "channel" if len(mistake.channels) == 1 else "channels"
    place = _place(mistake, file, tables, mistake.channels[0])
    if not mistake.units:
        return _Words(
            f"{noun} {names} reversed in sign {where}", place, "outputs that rise with the input along input_axis",
            f"reverse input_axis (and output_axis), or the sign of 'scale', of {names} {where}",
        )  # fmt: skip
    return _Words(
        f"{noun} {names} {mistake.factor:.4g} times too large {where}: {mistake.units}?", place,
        "outputs in 'output_unit', 'scale' of them per 'per'",
        f"correct 'scale' or 'per' of {names}, or convert the column {where}",
    )  # fmt: skip


def _rate(campaign: Campaign, found: Explanation, file: str, tables: Mapping[str, str]) -> _Words:
    return _unit(campaign, found, file, tables, "table_rate_deg_s", "degrees per second")


def _angle(campaign: Campaign, found: Explanation, file: str, tables: Mapping[str, str]) -> _Words:
    return _unit(campaign, found, file, tables, "table_angle_deg", "degrees")


def _unit(
    campaign: Campaign, found: Explanation, file: str, tables: Mapping[str, str], column: str, allowed: str
) -> _Words:
    mistake = found.mistake
    assert isinstance(mistake, RateUnit | AngleUnit)
    unit, where = mistake.unit, _subject(mistake, campaign)
    return _Words(
        f"column '{column}' is in {unit} {where}",
        _place(mistake, file, tables, column),
        allowed,
        f"convert '{column}' from {unit} to {allowed} {where}",
    )


def _time(campaign: Campaign, found: Explanation, file: str, tables: Mapping[str, str]) -> _Words:
    where, runs = _subject(found.mistake, campaign), {run.name: run for run in campaign.runs}
    run = runs.get(found.mistake.scope.name)
    seconds = ""
    if run is not None and "time" in run.covariates and run.rows > 1:
        seconds = f" ({abs(found.size) * float(np.median(np.diff(run.covariates['time']))):.4g} s)"
    sense = "later" if found.size > 0 else "earlier"
    return _Words(
        f"the outputs stand {abs(found.size):.3g} rows{seconds} {sense} than the columns of the table {where}",
        _place(found.mistake, file, tables, "time_s"),
        "outputs and table recorded on one clock",
        f"shift the outputs by {-found.size:+.3g} rows{seconds} against the columns of the table {where}",
    )


_WORDS: dict[str, Callable[[Campaign, Explanation, str, Mapping[str, str]], _Words]] = {
    "latitude_sign": _latitude,
    "files_exchanged": _files,
    "mounting_mislabelled": _label,
    "table_reversed": _sense,
    "table_zero": _zero,
    "mounting_turned": _turned,
    "table_elevation": _elevation,
    "table_azimuth": _azimuth,
    "axes_exchanged": _channels,
    "channel_unit": _gain,
    "rate_unit": _rate,
    "angle_unit": _angle,
    "time_shift": _time,
    "mounting_wrong": _matrix,
}
"""Kind of mistake → how it is said."""

SETUP_FINDINGS = tuple(_WORDS)
"""Names of the findings about the set-up that a campaign can accept."""
