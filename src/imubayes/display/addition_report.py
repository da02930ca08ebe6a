"""An addition in words and tables: predicted and observed, cross-validation, residual rms before and after."""

import math
from collections.abc import Sequence
from dataclasses import replace

from imubayes.criticism.held_out_record import CrossValidation
from imubayes.criticism.verdict import RmsChange
from imubayes.display.diagnosis_report import add_command
from imubayes.display.history_table import offsets_moved_text
from imubayes.display.labels import pretty, readable
from imubayes.display.prior_conflicts import conflict_line
from imubayes.display.report_layout import Report
from imubayes.display.rounding import significant, value_and_sd
from imubayes.display.table_layout import Cell, Sheet
from imubayes.results.addition import Addition, RunRmsChange

_PERCENT, _MOST_ROWS, _MOST_CHANGES = 5, 6, 3
_LEAST_CHANGE = math.log(1 + _PERCENT / 100)

_ONE_OF_SEVERAL = "The posterior with the first of them alone leaves out what the others may explain."

_VERDICTS = {
    "helps": "the addition improves the prediction of {by}s that were left out",
    "unclear": "whether the addition improves the prediction of {by}s that were left out is unclear",
    "not": "THE ADDITION DOES NOT IMPROVE the prediction of {by}s that were left out",
}


def addition_report(addition: Addition, verbose: bool = False) -> Report:
    """Return what an addition brought; tables where the refit is taken.

    Parameters
    ----------
    verbose : whether the tables list all channels, runs and parameters, or only what changed most.
    """
    command = f"next: {next_command(addition)}"
    if verbose or not addition.taken:
        sheets = [coefficient_sheet(addition), channel_sheet(addition), run_change_sheet(addition)]
        return Report(addition_lines(addition), sheets if addition.taken else (), [command])
    named = {change.channel for change in _changed(addition.channels)}
    changed = tuple(sorted((each for each in addition.channels if each.channel in named), key=_size, reverse=True))
    shown = addition.model_copy(update={"channels": changed})
    sheets = [_head(coefficient_sheet(addition)), channel_sheet(shown)]
    return Report(addition_lines(addition), sheets, [*_run_lines(addition), command])


def _changed[Change: (RmsChange, RunRmsChange)](changes: Sequence[Change]) -> tuple[Change, ...]:
    """Return the changes that are worth a line, the largest first."""
    return tuple(each for each in sorted(changes, key=_size, reverse=True) if _size(each) >= _LEAST_CHANGE)


def _size(change: RmsChange | RunRmsChange) -> float:
    ratio = _ratio(change)
    return 0.0 if ratio is None else abs(math.log(ratio))


def _ratio(change: RmsChange | RunRmsChange) -> float | None:
    return change.after / change.before if change.before and change.after else None


def _run_lines(addition: Addition) -> list[str]:
    """Return how many runs and channels changed, and the largest changes."""
    changed, count = _changed(addition.runs), len(addition.runs)
    if not changed:
        return [f"By run and channel, none of {count} residual rms changed by {_PERCENT} % or more."]
    each = ", ".join(f"{change.name} {change.channel} {_share(change)}" for change in changed[:_MOST_CHANGES])
    return [
        f"By run and channel, {len(changed)} of {count} changed by {_PERCENT} % or more: {each}"
        f"{', …' if len(changed) > _MOST_CHANGES else ''} (all: --verbose)."
    ]


def _head(sheet: Sheet) -> Sheet:
    """Return the first rows of a table, with a note of how many there are."""
    left = len(sheet.rows) - _MOST_ROWS
    if left <= 0:
        return sheet
    narrow = _head(sheet.narrow) if sheet.narrow is not None else None
    return replace(sheet, rows=sheet.rows[:_MOST_ROWS], note=f"{left} more with --verbose.", narrow=narrow)


def next_command(addition: Addition) -> str:
    """Return the command to run next; where several effects were not taken, the first of them alone."""
    result = (addition.folder if addition.taken else addition.parent) or "RESULT"
    first, *others = addition.added
    if addition.taken or not others:
        return f"imubayes diagnose {result}"
    return add_command([first.effect], first.channels, result, f"{addition.folder or result}-alone")


def addition_lines(addition: Addition) -> list[str]:
    """Return the outcome in a few lines: what was added, predicted and observed, and cross-validation."""
    names = ", ".join(
        choice.effect + (f" on {', '.join(choice.channels)}" if choice.channels else "") for choice in addition.added
    )
    return [
        f"Added: {names}.",
        *(
            f"Prior widened: {name} ~ {prior}; the estimate lies outside the typical range."
            for name, prior in addition.widened.items()
        ),
        *(conflict_line(conflict) for conflict in addition.prior_conflicts),
        *([addition.message] if addition.message else []),
        *([_ONE_OF_SEVERAL] if not addition.taken and addition.added[1:] else []),
        *_chi2_lines(addition),
        *held_out_lines(addition.held_out),
    ]


def _chi2_lines(addition: Addition) -> list[str]:
    """Return Δχ² predicted and observed, and why the residual of a channel rose all the same."""
    noise = "" if addition.predicted.delta_chi2 is None else " at the noise known beforehand"
    predicted, observed = map(significant, (addition.predicted.delta_chi2, addition.observed.delta_chi2))
    risen = [offsets_moved_text(addition.offsets_moved)] if addition.offsets_moved else []
    return [f"Δχ²{noise}: predicted {predicted}, observed {observed}.", *risen]


def held_out_lines(held_out: CrossValidation | None) -> list[str]:
    """Return the outcome of cross-validation."""
    if held_out is None:
        return ["No cross-validation."]
    verdict = _VERDICTS[held_out.verdict].format(by=held_out.by)
    lines = [
        f"Leave-one-{held_out.by}-out: Δ elpd {held_out.delta:+.1f} ± {significant(held_out.se, 2)}, better in "
        f"{held_out.helped} of {held_out.of} {held_out.by}s: {verdict}."
    ]
    if held_out.rates:
        each = ", ".join(
            f"{rate.channel} {significant(rate.before)} → {significant(rate.after)}" for rate in held_out.rates
        )
        lines.append(f"Rate at rest in poses that were left out, rms error, {held_out.rates[0].unit}: {each}.")
    return lines


def coefficient_sheet(addition: Addition) -> Sheet:
    """Return the table of coefficients, predicted and estimated."""
    predicted = {each.name: each for each in addition.predicted.coefficients}
    rows, slim = [], []
    for estimate in addition.observed.coefficients:
        before = predicted.get(estimate.name)
        value, sd = value_and_sd(estimate.value, estimate.sd)
        guess, width = value_and_sd(before.value, before.sd) if before is not None else value_and_sd(None, None)
        unit = pretty(estimate.unit)
        rows.append(tuple(map(Cell, (estimate.name, guess, width, value, sd, unit))))
        name = estimate.name.partition(".")[2] if len(addition.added) == 1 else estimate.name
        slim.append(tuple(map(Cell, (name or estimate.name, f"{guess} ± {width}", f"{value} ± {sd}", unit))))
    title = "Predicted and estimated"
    narrow = Sheet(title, ("new parameter", "predicted", "estimated", "unit"), slim, (0, 3))
    head = ("new parameter", "predicted", "± ", "estimated", "±", "unit")
    return Sheet(title, head, rows, (0, 5), narrow=narrow)


def channel_sheet(addition: Addition) -> Sheet:
    """Return the table of the residual rms before and after, per channel."""
    rows = [(Cell(change.channel), *_change_cells(change)) for change in addition.channels]
    note = "At the noise known beforehand, offsets of runs included." if rows else ""
    head = ("channel", "before", "after", "unit", "change")
    return Sheet("Residual rms before and after, per channel", head, rows, (0, 1, 3), note=note)


def run_change_sheet(addition: Addition) -> Sheet:
    """Return the table of the residual rms before and after, per run and channel."""
    rows, dividers, last = [], set(), None
    for place, change in enumerate(addition.runs):
        same = change.name == last
        dividers |= {place} if last is not None and not same else set()
        rows.append((Cell("" if same else change.name), Cell(change.channel), *_change_cells(change)))
        last = change.name
    head = ("run", "channel", "before", "after", "unit", "change")
    title = "Residual rms before and after, per run and channel"
    return Sheet(title, head, rows, (0, 1, 2, 4), dividers=frozenset(dividers))


def _change_cells(change: RmsChange | RunRmsChange) -> Sequence[Cell]:
    before, after, unit = _sizes(change)
    return (*map(Cell, (before, after, unit)), Cell(_share(change), "bad" if _rose(change) else ""))


def _sizes(change: RmsChange | RunRmsChange) -> tuple[str, str, str]:
    """Return before and after in a unit of plain numbers, and the unit."""
    both = (change.before, change.after)
    factor, unit = readable(change.unit, max((size for size in both if size is not None), default=0.0))
    before, after = (significant(None if size is None else size * factor) for size in both)
    return before, after, pretty(unit)


def _rose(change: RmsChange | RunRmsChange) -> bool:
    """Tell whether a residual rms rose by what is worth a line."""
    ratio = _ratio(change)
    return ratio is not None and ratio > 1 + _PERCENT / 100


def _share(change: RmsChange | RunRmsChange) -> str:
    """Return a change in per cent."""
    ratio = _ratio(change)
    return "–" if ratio is None else f"{100 * (ratio - 1):+.0f} %".replace("-", "−")
