"""A change of a model in words and tables, and injection recovery: which injected effects the diagnosis would find.

The words state the change as predicted and as observed, cross-validation, and what the data do not distinguish.  The
tables give the coefficients, the estimates that moved, and residual rms before and after.
"""

import math
from collections.abc import Iterator, Sequence
from typing import Any

from imubayes.criticism.explanation_records import RmsChange
from imubayes.display import numbers_and_labels as numbers
from imubayes.display.fit_cautions import conflict_line, set_aside_text
from imubayes.display.layout import Cell, Report, Sheet, cells
from imubayes.display.loop.diagnosis_report import add_command
from imubayes.display.loop.diagnosis_sentences import probability, sentence
from imubayes.display.loop.history import elpd_text, offsets_moved_text
from imubayes.foundations.quantity_names import QuantityName
from imubayes.foundations.wording import counted
from imubayes.loop.injection_recovery import Trial, Trials
from imubayes.loop.model_history import CrossValidation
from imubayes.loop.refit import NotDistinguished
from imubayes.results.change_records import ModelChange, RunRmsChange

LEAST_PERCENT = 5
"""Change of a residual rms that is worth a line, per cent."""
_MOST_ROWS = 6
# An estimate that moved by less than a tenth of its standard uncertainty stayed where it was.
_STAYED = 0.1
# A smaller Δχ² is the rounding of the arithmetic.
_NO_DROP = 1e-6


def change_sheets(change: ModelChange) -> list[Sheet]:
    """Return every table of a change."""
    own = [coefficient_sheet(change)] if change.added else []
    return [*own, moved_sheet(change), channel_sheet(change), run_change_sheet(change)]


def leading_sheets_of(change: ModelChange, channels: Sequence[RmsChange]) -> list[Sheet]:
    """Return the first rows of what a change is about, and the residual rms of some channels."""
    return [
        (coefficient_sheet(change) if change.added else moved_sheet(change)).few(_MOST_ROWS),
        channel_sheet(change.model_copy(update={"channels": tuple(channels)})),
    ]


def moved_sheet(change: ModelChange) -> Sheet:
    """Return the estimates that moved by a tenth of their standard uncertainty or more."""
    rows = []
    for each in change.moved:
        if abs(each.in_sd) >= _STAYED:
            pairs = ((each.before, each.sd_before), (each.after, each.sd_after))
            before, after = (" ± ".join(numbers.value_and_sd(*pair)) for pair in pairs)
            moved = numbers.with_minus(numbers.significant(each.in_sd, 2))
            rows.append(cells(each.name, before, after, numbers.pretty(each.unit), moved))
    note = "Change: in units of the smaller of the standard uncertainties before and after." if rows else ""
    head = ("estimate", "before", "after", "unit", "change / sd")
    return Sheet("Estimates that moved", head, rows, (0, 3), note=note).with_few(0, 2, 3, 4)


def ratio_of(change: RmsChange | RunRmsChange) -> float | None:
    """Return the residual rms after over that before; None if either is zero or unknown."""
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
        value, sd = numbers.value_and_sd(estimate.value, estimate.sd)
        guess, width = (
            numbers.value_and_sd(before.value, before.sd) if before is not None else numbers.value_and_sd(None, None)
        )
        unit = numbers.pretty(estimate.unit)
        rows.append(cells(estimate.name, guess, width, value, sd, unit))
        name = QuantityName.of(estimate.name).parts[1] if len(change.added) == 1 else estimate.name
        slim.append(cells(name or estimate.name, f"{guess} ± {width}", f"{value} ± {sd}", unit))
    head = ("new parameter", "predicted", "± ", "estimated", "±", "unit")
    sheet = Sheet("Predicted and estimated", head, rows, (0, 5))
    return sheet.with_narrow(("new parameter", "predicted", "estimated", "unit"), slim, (0, 3))


def channel_sheet(change: ModelChange) -> Sheet:
    """Return the table of the residual rms before and after, per channel."""
    rows = [cells(each.channel, *_change_cells(each)) for each in change.channels]
    note = "The rms values are at the noise known beforehand and include the offsets of runs." if rows else ""
    head = ("channel", "before", "after", "unit", "change")
    return Sheet("Residual rms before and after, per channel", head, rows, (0, 1, 3), note=note)


def run_change_sheet(change: ModelChange) -> Sheet:
    """Return the table of the residual rms before and after, per run and channel."""
    rows, dividers, last = [], set(), None
    for place, each in enumerate(change.runs):
        same = each.name == last
        dividers |= {place} if last is not None and not same else set()
        rows.append(cells("" if same else each.name, each.channel, *_change_cells(each)))
        last = each.name
    head = ("run", "channel", "before", "after", "unit", "change")
    title = "Residual rms before and after, per run and channel"
    return Sheet(title, head, rows, (0, 1, 2, 4), dividers=frozenset(dividers))


def _change_cells(change: RmsChange | RunRmsChange) -> Sequence[Cell]:
    before, after, unit = _sizes(change)
    return cells(before, after, unit, Cell(share(change), "bad" if _rose(change) else ""))


def _sizes(change: RmsChange | RunRmsChange) -> tuple[str, str, str]:
    """Return before and after in a unit of plain numbers, and the unit."""
    both = (change.before, change.after)
    factor, unit = numbers.readable(change.unit, max((size for size in both if size is not None), default=0.0))
    before, after = (numbers.significant(None if size is None else size * factor) for size in both)
    return before, after, numbers.pretty(unit)


def _rose(change: RmsChange | RunRmsChange) -> bool:
    """Return whether a residual rms rose by what is worth a line."""
    ratio = ratio_of(change)
    return ratio is not None and ratio > 1 + LEAST_PERCENT / 100


def share(change: RmsChange | RunRmsChange) -> str:
    """Return a change in per cent."""
    ratio = ratio_of(change)
    return "–" if ratio is None else numbers.with_minus(f"{100 * (ratio - 1):+.0f} %")


_MOST_CHANGES = 3
_LEAST_CHANGE = math.log(1 + LEAST_PERCENT / 100)

_VERDICTS = {
    "helps": "the addition improves the prediction of {by}s that were left out",
    "unclear": "it is unclear whether the {step} the prediction of {by}s that were left out",
    "not": "THE ADDITION DOES NOT IMPROVE the prediction of {by}s that were left out",
    "costs": "THE REMOVAL WORSENS the prediction of {by}s that were left out",
    "spares": "the removal does not worsen the prediction of {by}s that were left out",
}


def change_report(change: ModelChange, verbose: bool = False) -> Report:
    """Return what a change of a model brought; tables if the refit is taken.

    Parameters
    ----------
    verbose : whether the tables list all channels, runs and parameters, or only what changed most.
    """
    command = f"next: {next_command(change)}"
    if verbose or not change.taken:
        return Report(change_lines(change), change_sheets(change) if change.taken else (), [command])
    named = {each.channel for each in _changed(change.channels)}
    shown = sorted((each for each in change.channels if each.channel in named), key=size_of, reverse=True)
    return Report(change_lines(change), leading_sheets_of(change, shown), [*_run_lines(change), command])


def _changed[Change: (RmsChange, RunRmsChange)](changes: Sequence[Change]) -> tuple[Change, ...]:
    """Return the changes that are worth a line, the largest first."""
    return tuple(each for each in sorted(changes, key=size_of, reverse=True) if size_of(each) >= _LEAST_CHANGE)


def _run_lines(change: ModelChange) -> list[str]:
    """Return how many runs and channels changed, and the largest changes."""
    changed, count = _changed(change.runs), len(change.runs)
    if not changed:
        return [f"None of the {count} residual rms values by run and channel changed by {LEAST_PERCENT} % or more."]
    each = ", ".join(f"{one.name} {one.channel} {share(one)}" for one in changed[:_MOST_CHANGES])
    return [
        f"{len(changed)} of {count} residual rms values by run and channel changed by {LEAST_PERCENT} % or "
        f"more: {each}{', …' if len(changed) > _MOST_CHANGES else ''} (all: --verbose)."
    ]


def next_command(change: ModelChange) -> str:
    """Return the command to run next; if several effects were not taken, the first of them alone."""
    result = (change.folder if change.taken else change.parent) or "RESULT"
    first, *others = change.added or (None,)
    if change.taken or first is None or not others:
        return numbers.command_line("diagnose", result)
    return add_command([first.effect], first.channels, result, f"{change.folder or result}-alone")


def change_lines(change: ModelChange) -> list[str]:
    """Return the outcome in a few lines: what was changed, predicted and observed, and cross-validation."""
    return [*_what_was_changed(change), *_what_it_brought(change)]


def _what_was_changed(change: ModelChange) -> Iterator[str]:
    for word, choices in (("Added", change.added), ("Removed", change.removed)):
        names = [each.effect + (f" on {', '.join(each.channels)}" if each.channels else "") for each in choices]
        if names:
            yield f"{word}: {', '.join(names)}."
    yield from (f"Prior of {name}: {text or 'the default'}." for name, text in change.priors.items())
    yield from (f"Set aside: {set_aside_text(each)}." for each in change.set_aside)
    yield from (f"Taken back: {set_aside_text(each)}." for each in change.taken_back)
    for name, prior in change.widened.items():
        yield f"Prior widened: {name} ~ {prior}; the estimate lies outside the typical range."
    yield from map(conflict_line, change.prior_conflicts)
    if change.message:
        yield change.message
    if not change.taken and change.added[1:]:
        yield "The posterior with the first of them alone ignores that the others may explain the residual instead."


def _what_it_brought(change: ModelChange) -> Iterator[str]:
    """Yield Δχ² predicted and observed, why the residual of a channel rose all the same, odds, cross-validation."""
    if change.set_aside or change.taken_back:
        yield "The readings differ: χ² and predictions are not compared."
    else:
        noise = "" if change.predicted.delta_chi2 is None else " at the noise known beforehand"
        predicted, observed = map(_drop_text, (change.predicted.delta_chi2, change.observed.delta_chi2))
        yield f"Δχ²{noise}: predicted {predicted}, observed {observed}."
        if change.offsets_moved and change.added:
            yield offsets_moved_text(change.offsets_moved)
    if change.log_odds is not None:
        side, size = "for" if change.log_odds > 0 else "against", numbers.significant(abs(change.log_odds))
        yield f"Log odds {side} the removed effects, from the diagnosis before they were added: {size}."
    if change.added or change.removed:
        yield from held_out_lines(change.held_out, "addition" if change.added else "removal")
    yield from (_undistinguished_line(each, change.folder or "RESULT") for each in change.undistinguished)


def _drop_text(drop: float | None) -> str:
    """Return Δχ²; 0 if only the rounding of the arithmetic changed it."""
    return numbers.with_minus(numbers.significant(0.0 if drop is not None and abs(drop) < _NO_DROP else drop))


def _undistinguished_line(found: NotDistinguished, folder: str) -> str:
    """Return that the data do not distinguish effects, and the command that keeps the first alone."""
    first, *others = found.effects
    names = f"{', '.join([first, *others[:-1]])} and {others[-1]}"
    size = numbers.with_minus(f"{found.correlation:.2f}")
    of = "correlation" if len(others) == 1 else "correlation of each with the others together"
    command = numbers.command_line("remove", *others, "--from", folder, "--out", f"{folder}-{first}")
    return f"Not distinguished: {names}, {of} {size}; `{command}` keeps {first} alone."


def held_out_lines(held_out: CrossValidation | None, step: str = "addition") -> list[str]:
    """Return the outcome of cross-validation."""
    if held_out is None:
        return ["No cross-validation."]
    doubt = "addition improves" if step == "addition" else "removal worsens"
    verdict = _VERDICTS[held_out.verdict].format(by=held_out.by, step=doubt)
    lines = [
        f"Leave-one-{held_out.by}-out: Δ elpd {elpd_text(held_out)}, better in "
        f"{held_out.helped} of {held_out.of} {held_out.by}s: {verdict}."
    ]
    if held_out.rates:
        each = ", ".join(
            f"{rate.channel} {numbers.significant(rate.before)} → {numbers.significant(rate.after)}"
            for rate in held_out.rates
        )
        lines.append(f"Rate at rest in poses that were left out, rms error, {held_out.rates[0].unit}: {each}.")
    return lines


_MOOD = {"first": "", "other name": "weak", "missed": "bad"}


def injection_report(trials: Trials) -> Report:
    """Return what was injected and what was recovered."""
    return Report(injection_lines(trials), [injection_sheet(trials)])


def injection_lines(trials: Trials) -> list[str]:
    """Return the outcome in sentences."""
    lines = [
        f"{counted(len(trials.trials), 'effect')} injected one by one into simulated data of "
        f"'{trials.campaign}', {_size(trials)}: {trials.detected} detected, {trials.group_first} of them with the "
        "right group ranked first."
    ]
    if trials.nulls:
        rate, count = trials.false_alarms / len(trials.nulls), counted(len(trials.nulls), "draw")
        rate, low, high = map(numbers.percent, (rate, *trials.false_alarm_interval))
        lines.append(
            f"Without injection: {counted(trials.false_alarms, 'false alarm')} in {count}, a rate of {rate} "
            f"(95 % interval {low} to {high})."
        )
    missed = [trial.effect for trial in trials.trials if not trial.detected]
    if missed:
        lines.append(f"Missed: {', '.join(missed)}.")
    if trials.skipped:
        lines.append(f"Not injected, undetectable in these runs: {numbers.listed(list(trials.skipped), 12)}.")
    return lines


def _size(trials: Trials) -> str:
    typical = trials.size.typical
    if typical is None:
        return f"at the size with Δχ² = {numbers.significant(trials.size.delta_chi2)}"
    return f"at {numbers.significant(typical)} times the largest typical size"


def injection_sheet(trials: Trials) -> Sheet:
    """Return a line for each effect injected."""
    rows = []
    for trial in trials.trials:
        outcome = "first" if trial.group_first else ("other name" if trial.detected else "missed")
        first = numbers.listed(trial.effects, 2) or trial.diagnosis.verdict
        found, likely = Cell(outcome, _MOOD[outcome]), probability(trial.diagnosis.probability(trial.effect))
        rows.append(cells(trial.effect, _injected(trial), numbers.significant(trial.delta_chi2), found, first, likely))
    head = ("effect", "injected", "Δχ²", "found", "first group", "probability")
    return Sheet("Injection recovery", head, rows, (0, 1, 3, 4))


def _injected(trial: Trial) -> str:
    if not trial.planted:
        return "–"
    first, count = trial.planted[0], len(trial.planted)
    text = f"{QuantityName.of(first.name).parts[1]} {numbers.significant(first.value)} {numbers.pretty(first.unit)}"
    return text + (f", {count - 1} more" if count > 1 else "")


def injection_json(trials: Trials) -> dict[str, Any]:
    """Return the outcome as `imubayes plant --json` prints it."""
    size, count = trials.size, len(trials.nulls)
    return {
        "format": 1,
        "campaign": trials.campaign,
        "model": trials.model,
        "size": {"delta_chi2": size.delta_chi2} if size.typical is None else {"typical": size.typical},
        "seed": trials.seed,
        "effects": [
            {
                "effect": trial.effect,
                "planted": [vars(parameter) for parameter in trial.planted],
                "delta_chi2": trial.delta_chi2,
                "verdict": trial.diagnosis.verdict,
                "detected": trial.detected,
                "group_first": trial.group_first,
                "first_group": list(trial.effects),
                "probability": trial.diagnosis.probability(trial.effect),
                "sentence": sentence(trial.diagnosis),
            }
            for trial in trials.trials
        ],
        "detected": trials.detected,
        "group_first": trials.group_first,
        "skipped": [{"effect": name, "reason": reason} for name, reason in trials.skipped.items()],
        "null": {
            "draws": count,
            "false_alarms": trials.false_alarms,
            "rate": trials.false_alarms / count if count else None,
            "interval_95": list(trials.false_alarm_interval) if count else None,
        },
    }
