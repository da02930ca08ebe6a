"""The textbook beside the joint fit: what each gives, and what the mounting angle explains of the difference.

Works on the estimates and, where there is one, on the summary of a fit of the same campaign.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from imubayes.display.fit_tables import Cell, Sheet
from imubayes.display.labels import pretty
from imubayes.display.rounding import significant, value_and_sd
from imubayes.procedures.textbook import Estimate, TextbookResult, Undetermined
from imubayes.records import finite

Facts = Mapping[str, Any]
# A difference beyond this many of the textbook's own standard deviations is one that it does not own up to.
_BEYOND = 3.0
_MOST_BESIDE = 8


def textbook_json(findings: Sequence[TextbookResult], summary: Facts | None = None) -> dict[str, Any]:
    """Return the estimates as `imubayes classical --json` prints them, each with the joint fit's where it has one."""
    joint = _joint(summary)
    return {
        "format": 1,
        "estimates": [_line(one, joint) for one in findings if isinstance(one, Estimate)],
        "undetermined": [vars(one) for one in findings if isinstance(one, Undetermined)],
    }


def _joint(summary: Facts | None) -> dict[str, Facts]:
    lines = [] if summary is None else [*summary["derived"], *summary["parameters"]]
    return {line["name"]: line for line in lines}


def _line(one: Estimate, joint: Mapping[str, Facts]) -> dict[str, Any]:
    line: dict[str, Any] = {
        "name": one.name,
        "run": one.run,
        "value": one.value,
        "sd": finite(one.sd),
        "unit": one.unit,
        "method": one.method,
        "decision": one.decision,
    }
    found = joint.get(one.name)
    if found is None or found["unit"] != one.unit:
        return line | {"joint": None, "difference": None, "of_angle": None}
    return line | {
        "joint": {"value": found["mean"], "sd": found["sd"], "within": found.get("within")},
        "difference": one.value - found["mean"],
        "of_angle": _of_angle(one, joint),
    }


def _of_angle(one: Estimate, joint: Mapping[str, Facts]) -> dict[str, float] | None:
    """Return the error of the mounting angle, and what it does to the textbook's value: k′/cos θ with the wrong θ."""
    angle = joint.get(one.angle)
    if angle is None or not one.value:
        return None
    ratio = math.cos(math.radians(angle["mean"])) / math.cos(math.radians(one.nominal))
    return {"arcsec": (angle["mean"] - one.nominal) * 3600, "ppm": (ratio - 1) * 1e6}


def textbook_sheet(facts: Facts) -> Sheet:
    """Return the table: textbook, joint fit, difference and what explains it."""
    compared = any(one["joint"] for one in facts["estimates"])
    rows = []
    for one in facts["estimates"]:
        value, sd = value_and_sd(one["value"], one["sd"])
        cells = [Cell(one["name"]), Cell(one["run"]), Cell(value), Cell(sd)]
        rows.append((*cells, *(_compared(one) if compared else ()), Cell(pretty(one["unit"]))))
    head = ["quantity", "run", "textbook", "sd", *(("joint", "sd", "differs", "because") if compared else ()), "unit"]
    note = (
        "The sd of the textbook is the scatter about its fitted curve; what is wrong with its assumptions it does not "
        "contain."
    )
    sheet = Sheet("Textbook estimates, each run by itself", head, rows, (0, 1, 7) if compared else (0, 1), "", note)
    if not compared:
        return sheet
    lines = [(row[0], row[1], _with_sd(row[2], row[3], row[-1]), _with_sd(row[4], row[5])) for row in rows]
    few = ("quantity", "run", "textbook ± sd", "joint ± sd")
    return replace(sheet, narrow=replace(sheet, head=few, rows=lines, left=(0, 1)))


def _with_sd(value: Cell, sd: Cell, unit: Cell | None = None) -> Cell:
    known = f"{value.text} ± {sd.text}" if sd.text not in ("", "–") else value.text
    return Cell(f"{known} {unit.text}" if unit is not None else known, value.mood)


def _is_beyond(one: Facts) -> bool:
    return one["sd"] is not None and abs(one["difference"]) > _BEYOND * math.hypot(one["sd"], one["joint"]["sd"])


def _compared(one: Facts) -> tuple[Cell, Cell, Cell, Cell]:
    if not one["joint"]:
        return Cell(""), Cell(""), Cell(""), Cell("")
    value, sd = value_and_sd(one["joint"]["value"], one["joint"]["sd"])
    relative = one["name"].startswith("scale_factor[")
    size = one["difference"] / one["joint"]["value"] * 1e6 if relative else one["difference"]
    beyond = _is_beyond(one)
    why = one["of_angle"]
    because = (
        f"angle {significant(why['arcsec'])} arcsec off: {significant(why['ppm'])} ppm"
        if why and abs(why["ppm"]) >= 1
        else ""
    )
    text = significant(size) + (" ppm" if relative else "")
    return Cell(value), Cell(sd), Cell(text, "bad" if beyond else ""), Cell(because)


def beside_sheet(facts: Facts) -> Sheet:
    """Return the estimates that lie beyond their own uncertainties from the joint fit, the furthest first."""
    compared = [one for one in facts["estimates"] if one["joint"] and one["sd"]]
    far = sorted(compared, key=lambda one: -abs(one["difference"]) / math.hypot(one["sd"], one["joint"]["sd"]))
    beyond = [one for one in far if _is_beyond(one)]
    sheet = textbook_sheet({"estimates": beyond[:_MOST_BESIDE]})
    note = (
        f"{len(beyond)} of {len(compared)} textbook estimates lie more than {_BEYOND:g} of their own standard "
        "uncertainties from the joint fit: their assumptions do not hold. All of them: imubayes classical CAMPAIGN "
        "--result RESULT."
    )
    words = {"title": "The textbook beside the joint fit, where they differ", "note": note}
    narrow = replace(sheet.narrow, **words) if sheet.narrow is not None else None
    return replace(sheet, **words, narrow=narrow)


def decision_sheet(facts: Facts) -> Sheet:
    """Return what the textbook concludes."""
    decided = [one for one in facts["estimates"] if one["decision"]]
    rows = [(Cell(one["name"]), Cell(one["decision"]), Cell(_within(one))) for one in decided]
    note = "Joint: the probability that the quantity is at or below the threshold, all runs and effects together."
    return Sheet("What the textbook decides", ("quantity", "decision", "joint"), rows, (0, 1, 2), "", note)


def _within(one: Facts) -> str:
    within = (one["joint"] or {}).get("within")
    if not within or within["probability"] is None:
        return ""
    return f"P(≤ {within['threshold']:g} {pretty(within['unit'])}) = {within['probability']:.2g}"


def undetermined_sheet(facts: Facts) -> Sheet:
    """Return what the textbook cannot determine from these runs."""
    rows = [(Cell(one["run"]), Cell(one["sentence"])) for one in facts["undetermined"]]
    return Sheet("What the textbook leaves open", ("run", "because"), rows, (0, 1))
