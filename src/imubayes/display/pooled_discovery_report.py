"""What the units of a batch show together: findings, the units for and against them, and other candidates."""

from collections.abc import Sequence
from dataclasses import replace

from imubayes.batch.discovery_record import PooledCandidate, PooledDiscovery, PooledFinding
from imubayes.display.archive_report import counted
from imubayes.display.evidence_text import probability
from imubayes.display.report_layout import Report
from imubayes.display.rounding import concise
from imubayes.display.table_layout import Cell, Sheet, of_columns
from imubayes.errors import Issue

_MOST_NAMED, _MOST_SIDE, _MOST_CANDIDATES = 15, 5, 6
_LAWS = {
    "common": "the same in all units",
    "own": "of its own size in each unit",
    "some": "in some units only",
}


def discovery_report(found: PooledDiscovery, issues: Sequence[Issue] = ()) -> Report:
    """Return what the units show together, and the units that speak for it and against it."""
    looked = f"{counted(found.campaigns, 'campaign')} of {counted(found.units, 'unit')}, {found.candidates} candidates"
    lines = [text for each in found.findings for text in _finding_lines(each)]
    lines.append(_nothing_line(found))
    lines.append(f"{looked}; {found.expected:g} missing effect expected before the data")
    head = ("effect", "acts on", "units", "law", "probability", "log odds", "coefficient", "for / against")
    beside = {(each.effect, each.equipment): each for each in reversed(found.ranking)}
    rows = [_row(each.evidence, each) for each in found.findings]
    rows += [_row(each) for each in list(beside.values())[::-1][:_MOST_CANDIDATES]]
    effects = Sheet("Effects, and candidates beside them", head, rows, left=(0, 1, 2, 3, 6))
    effects = replace(effects, narrow=of_columns(effects, (0, 3, 4, 5)))
    return Report(lines, [*map(_sides, found.findings), effects], [*map(str, issues), *_next(found)])


def _nothing_line(found: PooledDiscovery) -> str:
    if found.findings:
        return f"Nothing else is missing with probability {probability(found.nothing_else)}."
    return f"No effect is missing that these units show together: probability {probability(found.nothing)}."


def _finding_lines(each: PooledFinding) -> list[str]:
    first, *others = each.place
    where = f" of {each.equipment.kind} {each.equipment.name}" if each.equipment else ""
    law = _LAWS[each.evidence.law].replace("units", f"campaigns{where}") if where else _LAWS[each.evidence.law]
    chance = f"probability {probability(each.probability)}, log odds {each.evidence.log_odds:.1f}"
    lines = [f"{first.effect} is missing ({first.scope}), {law}: {chance}{_size(each)}."]
    if each.equipment is not None and each.equipment.log_bayes_outside is not None:
        said = f"is {each.equipment.log_bayes_outside:.1f}"
        lines.append(f"The log evidence of the {counted(each.equipment.outside, 'other campaign')} {said}.")
    if others:
        told = [
            f"{one.effect}{f' ({one.equipment})' if one.equipment else ''} {probability(one.probability)}"
            for one in each.place
        ]
        lines.append(f"In its place: {' or '.join(told)}.")
    if each.named:
        shown = ", ".join(each.named[:_MOST_NAMED]) + (", …" if len(each.named) > _MOST_NAMED else "")
        lines.append(f"{counted(len(each.named), 'unit')} show it alone: {shown}.")
    return lines


def _size(each: PooledFinding) -> str:
    """Return the coefficients where they are common to all units."""
    known = [f", {c.name} = {concise(c.value, c.sd)} {c.unit}" for c in each.coefficients]
    return "".join(known) if each.evidence.law == "common" else ""


def _next(found: PooledDiscovery) -> list[str]:
    """Return what to do with the first finding."""
    if not found.findings:
        return []
    # All that the units do not distinguish: the posterior then holds each explanation.
    entries = " and ".join(f'[[effect]] name = "{effect}"' for effect in found.findings[0].effects)
    return [
        f"next: write {entries} in a copy of the model, run imubayes batch with it and --out of another folder, then "
        "imubayes batch compare OLD NEW"
    ]


def _sides(each: PooledFinding) -> Sheet:
    """Return the units for and against a finding."""
    rows = [
        [Cell(word), Cell(unit.unit), Cell(f"{unit.gain:+.1f}"), Cell(probability(unit.probability))]
        for word, listed in (("for", each.supporting), ("against", each.opposing))
        for unit in listed[:_MOST_SIDE]
    ]
    return Sheet(
        f"Units for and against {each.place[0].effect}", ("", "unit", "log evidence", "has it"), rows, left=(0, 1)
    )


def _row(each: PooledCandidate, found: PooledFinding | None = None) -> list[Cell]:
    name = each.effect + (f" ({each.shape})" if each.shape else "")
    scope = each.scope + (f": {each.part}" if each.part else "")
    size, sides = "", ""
    if found is not None:
        size = ", ".join(f"{concise(one.value, one.sd)} {one.unit}" for one in found.coefficients[:2])
        gains = [unit.gain for unit in found.every_unit]
        sides = f"{sum(gain > 0 for gain in gains)} / {sum(gain < 0 for gain in gains)}"
    chance = found.probability if found is not None else each.probability
    return [
        Cell(name), Cell(scope), Cell(each.equipment or str(each.units)), Cell(each.law), Cell(probability(chance)),
        Cell(f"{each.log_odds:.1f}"), Cell(size), Cell(sides),
    ]  # fmt: skip
