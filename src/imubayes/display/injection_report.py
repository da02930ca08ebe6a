"""What was planted, and what would have been found of it: lines and a table out of the JSON of `imubayes plant`."""

from collections.abc import Mapping
from typing import Any

from imubayes.display.diagnosis_report import chance_text
from imubayes.display.fit_tables import Cell, Sheet
from imubayes.display.labels import listed, pretty
from imubayes.display.rounding import percent, significant

Facts = Mapping[str, Any]


def planting_lines(facts: Facts) -> list[str]:
    """Return the answer in sentences."""
    count, null = len(facts["effects"]), facts["null"]
    size = facts["size"]
    how = (
        f"so large that adding it would lower chi2 by {significant(size['delta_chi2'])}"
        if "delta_chi2" in size
        else f"at {significant(size['typical'])} times the largest size met in practice"
    )
    lines = [
        f"{count} effects planted one by one into simulated data of '{facts['campaign']}', each {how}: "
        f"{facts['detected']} detected, the right group first for {facts['group_first']}."
    ]
    if null["draws"]:
        low, high = null["interval_95"]
        lines.append(
            f"With nothing planted: {null['false_alarms']} false alarms in {null['draws']} draws, a rate of "
            f"{percent(null['rate'])} (95 % interval {percent(low)} to {percent(high)}; "
            f"{percent(null['allowed'])} are allowed)."
        )
    missed = [one["effect"] for one in facts["effects"] if not one["detected"]]
    if missed:
        lines.append(f"You would have missed: {', '.join(missed)}.")
    hidden = [one["effect"] for one in facts["skipped"]]
    if hidden:
        lines.append(f"Not planted, because no run shows it or the model takes it up: {listed(hidden, 12)}.")
    return lines


def planting_sheet(facts: Facts) -> Sheet:
    """Return a line for each effect planted."""
    rows = []
    for one in facts["effects"]:
        first = listed(one["first_group"], 2) or one["verdict"]
        right = "first" if one["group_first"] else ("other name" if one["detected"] else "missed")
        mood = {"first": "", "other name": "weak", "missed": "bad"}[right]
        rows.append(
            (
                Cell(one["effect"]),
                Cell(_planted(one["planted"])),
                Cell(significant(one["delta_chi2"])),
                Cell(right, mood),
                Cell(first),
                Cell(chance_text(one["p_global"])),
            )
        )
    head = ("effect", "planted", "Δχ²", "found", "what came first", "chance")
    return Sheet("Would I have found it?", head, rows, (0, 1, 3, 4))


def _planted(planted: list[Facts]) -> str:
    if not planted:
        return "–"
    first = planted[0]
    text = f"{first['name'].partition('.')[2]} {significant(first['value'])} {pretty(first['unit'])}"
    return text + (f", {len(planted) - 1} more" if len(planted) > 1 else "")
