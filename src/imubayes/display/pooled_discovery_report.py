"""What the units of a batch show together: findings, the units for and against them, and the candidates."""

import math
from collections.abc import Sequence
from dataclasses import replace

from imubayes.batch.pooled_discovery import EquipmentEvidence, PooledCandidate, PooledDiscovery, PooledFinding
from imubayes.display.archive_report import counted
from imubayes.display.report_layout import Report
from imubayes.display.rounding import chance_text, concise
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
    lines = lines or ["No effect is missing that these units show together."]
    lines += [_equipment_line(each) for each in found.equipment]
    lines.append(f"{looked}; false discovery rate {100 * found.rate:g} %")
    sheets = [_sides(each) for each in found.findings]
    head = ("effect", "law", "Δχ² common", "Δχ² own", "log10 p adjusted", "acts on", "units")
    leading = list({each.effect: each for each in reversed(found.ranking)}.values())[::-1][:_MOST_CANDIDATES]
    ranking = Sheet("Candidates", head, [_candidate_row(each) for each in leading], left=(0, 1, 5))
    ranking = replace(ranking, narrow=of_columns(ranking, (0, 1, 3, 4)))
    return Report(lines, [*sheets, ranking], [*map(str, issues), *_next(found)])


def _finding_lines(each: PooledFinding) -> list[str]:
    evidence = each.evidence
    chance = f"adjusted p = 1e{math.floor(evidence.log10_adjusted)}"
    lines = [f"{each.effects[0]} is missing ({evidence.scope}), {_LAWS[evidence.law]}: {chance}{_size(each)}."]
    if each.effects[1:]:
        lines.append(f"These units do not distinguish it from {' or '.join(each.effects[1:])}.")
    if each.named:
        shown = ", ".join(each.named[:_MOST_NAMED]) + (", …" if len(each.named) > _MOST_NAMED else "")
        lines.append(f"It is significant in {counted(len(each.named), 'unit')} alone: {shown}.")
    return lines


def _size(each: PooledFinding) -> str:
    """Return the coefficients where they are common to all units."""
    known = [
        f", {c.name} = {concise(c.value, c.sd)} {c.unit}"
        for c in each.coefficients
        if c.value is not None and c.sd is not None
    ]
    return "".join(known) if each.evidence.law == "common" else ""


def _equipment_line(each: EquipmentEvidence) -> str:
    return (
        f"{each.kind} {each.name}: {' or '.join(each.effects)} in its {counted(each.inside, 'campaign')} "
        f"(log10 p = {each.log10_p:.1f}); in the {each.outside} others log10 p = {each.log10_p_outside:.1f}"
    )


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
    common = each.evidence.law == "common"
    rows = [
        [Cell(word), Cell(unit.unit), Cell(f"{unit.contribution if common else unit.chi2:.1f}"),
         Cell(chance_text(unit.p))]
        for word, listed in (("for", each.supporting), ("against", each.opposing))
        for unit in listed[:_MOST_SIDE]
    ]  # fmt: skip
    return Sheet(f"Units for and against {each.effects[0]}", ("", "unit", "Δχ²", "p alone"), rows, left=(0, 1))


def _candidate_row(each: PooledCandidate) -> list[Cell]:
    name = each.effect + (f" ({each.shape})" if each.shape else "")
    own = f"{each.chi2_own:.1f} ({each.dof_own})"
    return [
        Cell(name), Cell(each.law), Cell(f"{each.chi2:.1f} ({each.dof})"), Cell(own),
        Cell(f"{each.log10_adjusted:.1f}"), Cell(each.scope), Cell(str(each.units)),
    ]  # fmt: skip
