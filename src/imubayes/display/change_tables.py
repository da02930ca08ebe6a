"""A change of a model in tables: coefficients, estimates that moved, residual rms before and after."""

import math
from collections.abc import Sequence
from dataclasses import replace

from imubayes.criticism.verdict import RmsChange
from imubayes.display.labels import pretty, readable
from imubayes.display.rounding import significant, value_and_sd
from imubayes.display.table_layout import Cell, Sheet
from imubayes.results.model_change import ModelChange, RunRmsChange

LEAST_PERCENT = 5
"""Change of a residual rms that is worth a line, per cent."""
_MOST_ROWS = 6
# An estimate that moved by less than a tenth of its standard uncertainty stayed where it was.
_STAYED = 0.1


def change_sheets(change: ModelChange) -> list[Sheet]:
    """Return every table of a change."""
    own = [coefficient_sheet(change)] if change.added else []
    return [*own, moved_sheet(change), channel_sheet(change), run_change_sheet(change)]


def leading_sheets_of(change: ModelChange, channels: Sequence[RmsChange]) -> list[Sheet]:
    """Return the first rows of what a change is about, and the residual rms of some channels."""
    return [
        first_rows(coefficient_sheet(change) if change.added else moved_sheet(change)),
        channel_sheet(change.model_copy(update={"channels": tuple(channels)})),
    ]


def first_rows(sheet: Sheet) -> Sheet:
    """Return the first rows of a table, with a note of how many there are."""
    left = len(sheet.rows) - _MOST_ROWS
    if left <= 0:
        return sheet
    narrow = first_rows(sheet.narrow) if sheet.narrow is not None else None
    note = f"{left} more with --verbose." + (f" {sheet.note}" if sheet.note else "")
    return replace(sheet, rows=sheet.rows[:_MOST_ROWS], note=note, narrow=narrow)


def moved_sheet(change: ModelChange) -> Sheet:
    """Return the estimates that moved by a tenth of their standard uncertainty or more."""
    rows, slim = [], []
    for each in change.moved:
        if abs(each.in_sd) >= _STAYED:
            pairs = ((each.before, each.sd_before), (each.after, each.sd_after))
            before, after = (" ± ".join(value_and_sd(*pair)) for pair in pairs)
            moved = significant(each.in_sd, 2).replace("-", "−")
            rows.append(tuple(map(Cell, (each.name, before, after, pretty(each.unit), moved))))
            slim.append(tuple(map(Cell, (each.name, after, pretty(each.unit), moved))))
    note = "Change in the smaller of the two standard uncertainties, before and after." if rows else ""
    narrow = Sheet("Estimates that moved", ("estimate", "after", "unit", "change / sd"), slim, (0, 2), note=note)
    head = ("estimate", "before", "after", "unit", "change / sd")
    return Sheet("Estimates that moved", head, rows, (0, 3), note=note, narrow=narrow)


def ratio_of(change: RmsChange | RunRmsChange) -> float | None:
    """Return the residual rms after over that before; None where either is zero or unknown."""
    return change.after / change.before if change.before and change.after else None


def size_of(change: RmsChange | RunRmsChange) -> float:
    """Return the size of the logarithm of the ratio of two residual rms."""
    ratio = ratio_of(change)
    return 0.0 if ratio is None else abs(math.log(ratio))


def coefficient_sheet(change: ModelChange) -> Sheet:
    """Return the table of coefficients, predicted and estimated."""
    predicted = {each.name: each for each in change.predicted.coefficients}
    rows, slim = [], []
    for estimate in change.observed.coefficients:
        before = predicted.get(estimate.name)
        value, sd = value_and_sd(estimate.value, estimate.sd)
        guess, width = value_and_sd(before.value, before.sd) if before is not None else value_and_sd(None, None)
        unit = pretty(estimate.unit)
        rows.append(tuple(map(Cell, (estimate.name, guess, width, value, sd, unit))))
        name = estimate.name.partition(".")[2] if len(change.added) == 1 else estimate.name
        slim.append(tuple(map(Cell, (name or estimate.name, f"{guess} ± {width}", f"{value} ± {sd}", unit))))
    title = "Predicted and estimated"
    narrow = Sheet(title, ("new parameter", "predicted", "estimated", "unit"), slim, (0, 3))
    head = ("new parameter", "predicted", "± ", "estimated", "±", "unit")
    return Sheet(title, head, rows, (0, 5), narrow=narrow)


def channel_sheet(change: ModelChange) -> Sheet:
    """Return the table of the residual rms before and after, per channel."""
    rows = [(Cell(each.channel), *_change_cells(each)) for each in change.channels]
    note = "At the noise known beforehand, offsets of runs included." if rows else ""
    head = ("channel", "before", "after", "unit", "change")
    return Sheet("Residual rms before and after, per channel", head, rows, (0, 1, 3), note=note)


def run_change_sheet(change: ModelChange) -> Sheet:
    """Return the table of the residual rms before and after, per run and channel."""
    rows, dividers, last = [], set(), None
    for place, each in enumerate(change.runs):
        same = each.name == last
        dividers |= {place} if last is not None and not same else set()
        rows.append((Cell("" if same else each.name), Cell(each.channel), *_change_cells(each)))
        last = each.name
    head = ("run", "channel", "before", "after", "unit", "change")
    title = "Residual rms before and after, per run and channel"
    return Sheet(title, head, rows, (0, 1, 2, 4), dividers=frozenset(dividers))


def _change_cells(change: RmsChange | RunRmsChange) -> Sequence[Cell]:
    before, after, unit = _sizes(change)
    return (*map(Cell, (before, after, unit)), Cell(share(change), "bad" if _rose(change) else ""))


def _sizes(change: RmsChange | RunRmsChange) -> tuple[str, str, str]:
    """Return before and after in a unit of plain numbers, and the unit."""
    both = (change.before, change.after)
    factor, unit = readable(change.unit, max((size for size in both if size is not None), default=0.0))
    before, after = (significant(None if size is None else size * factor) for size in both)
    return before, after, pretty(unit)


def _rose(change: RmsChange | RunRmsChange) -> bool:
    """Tell whether a residual rms rose by what is worth a line."""
    ratio = ratio_of(change)
    return ratio is not None and ratio > 1 + LEAST_PERCENT / 100


def share(change: RmsChange | RunRmsChange) -> str:
    """Return a change in per cent."""
    ratio = ratio_of(change)
    return "–" if ratio is None else f"{100 * (ratio - 1):+.0f} %".replace("-", "−")
