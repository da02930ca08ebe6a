"""A change of a model in words: predicted and observed, cross-validation, what the data do not distinguish."""

import math
from collections.abc import Sequence

from imubayes.criticism.verdict import RmsChange
from imubayes.display.change_tables import LEAST_PERCENT, change_sheets, leading_sheets_of, share, size_of
from imubayes.display.diagnosis_report import add_command
from imubayes.display.history_table import offsets_moved_text
from imubayes.display.prior_conflicts import conflict_line
from imubayes.display.report_layout import Report
from imubayes.display.rounding import significant
from imubayes.loop.held_out_record import CrossValidation
from imubayes.loop.not_distinguished import NotDistinguished
from imubayes.results.model_change import ModelChange, RunRmsChange

_MOST_CHANGES = 3
_LEAST_CHANGE = math.log(1 + LEAST_PERCENT / 100)

_ONE_OF_SEVERAL = "The posterior with the first of them alone leaves out what the others may explain."

_VERDICTS = {
    "helps": "the addition improves the prediction of {by}s that were left out",
    "unclear": "whether the {step} the prediction of {by}s that were left out is unclear",
    "not": "THE ADDITION DOES NOT IMPROVE the prediction of {by}s that were left out",
    "costs": "THE REMOVAL WORSENS the prediction of {by}s that were left out",
    "spares": "the removal does not worsen the prediction of {by}s that were left out",
}


def change_report(change: ModelChange, verbose: bool = False) -> Report:
    """Return what a change of a model brought; tables where the refit is taken.

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
        return [f"By run and channel, none of {count} residual rms changed by {LEAST_PERCENT} % or more."]
    each = ", ".join(f"{one.name} {one.channel} {share(one)}" for one in changed[:_MOST_CHANGES])
    return [
        f"By run and channel, {len(changed)} of {count} changed by {LEAST_PERCENT} % or more: {each}"
        f"{', …' if len(changed) > _MOST_CHANGES else ''} (all: --verbose)."
    ]


def next_command(change: ModelChange) -> str:
    """Return the command to run next; where several effects were not taken, the first of them alone."""
    result = (change.folder if change.taken else change.parent) or "RESULT"
    first, *others = change.added or (None,)
    if change.taken or first is None or not others:
        return f"imubayes diagnose {result}"
    return add_command([first.effect], first.channels, result, f"{change.folder or result}-alone")


def change_lines(change: ModelChange) -> list[str]:
    """Return the outcome in a few lines: what was changed, predicted and observed, and cross-validation."""
    step = "addition" if change.added else "removal"
    return [
        *_named_lines(change),
        *(
            f"Prior widened: {name} ~ {prior}; the estimate lies outside the typical range."
            for name, prior in change.widened.items()
        ),
        *(conflict_line(conflict) for conflict in change.prior_conflicts),
        *([change.message] if change.message else []),
        *([_ONE_OF_SEVERAL] if not change.taken and change.added[1:] else []),
        *_chi2_lines(change),
        *_odds_lines(change),
        *held_out_lines(change.held_out, step),
        *(_undistinguished_line(each, change.folder or "RESULT") for each in change.undistinguished),
    ]


def _named_lines(change: ModelChange) -> list[str]:
    lines = []
    for word, choices in (("Added", change.added), ("Removed", change.removed)):
        names = [each.effect + (f" on {', '.join(each.channels)}" if each.channels else "") for each in choices]
        lines += [f"{word}: {', '.join(names)}."] if names else []
    return lines


def _chi2_lines(change: ModelChange) -> list[str]:
    """Return Δχ² predicted and observed, and why the residual of a channel rose all the same."""
    noise = "" if change.predicted.delta_chi2 is None else " at the noise known beforehand"
    predicted, observed = (
        significant(each).replace("-", "−") for each in (change.predicted.delta_chi2, change.observed.delta_chi2)
    )
    risen = [offsets_moved_text(change.offsets_moved)] if change.offsets_moved and change.added else []
    return [f"Δχ²{noise}: predicted {predicted}, observed {observed}.", *risen]


def _odds_lines(change: ModelChange) -> list[str]:
    """Return the odds of the effects that were removed, where a diagnosis told them."""
    if change.log_odds is None:
        return []
    side, size = "for" if change.log_odds > 0 else "against", significant(abs(change.log_odds))
    return [f"Log odds {side} what was removed, by the diagnosis before it was added: {size}."]


def _undistinguished_line(found: NotDistinguished, folder: str) -> str:
    """Return that the data do not distinguish effects, and the command that keeps the first alone."""
    first, *others = found.effects
    names = f"{', '.join([first, *others[:-1]])} and {others[-1]}"
    size = f"{found.correlation:.2f}".replace("-", "−")
    of = "correlation" if len(others) == 1 else "correlation of each with the others together"
    command = f"imubayes remove {' '.join(others)} --from {folder} --out {folder}-{first}"
    return f"Not distinguished: {names}, {of} {size}; `{command}` keeps {first} alone."


def held_out_lines(held_out: CrossValidation | None, step: str = "addition") -> list[str]:
    """Return the outcome of cross-validation."""
    if held_out is None:
        return ["No cross-validation."]
    doubt = "addition improves" if step == "addition" else "removal worsens"
    verdict = _VERDICTS[held_out.verdict].format(by=held_out.by, step=doubt)
    gain = f"{held_out.delta:+.1f}".replace("-", "−")
    lines = [
        f"Leave-one-{held_out.by}-out: Δ elpd {gain} ± {significant(held_out.se, 2)}, better in "
        f"{held_out.helped} of {held_out.of} {held_out.by}s: {verdict}."
    ]
    if held_out.rates:
        each = ", ".join(
            f"{rate.channel} {significant(rate.before)} → {significant(rate.after)}" for rate in held_out.rates
        )
        lines.append(f"Rate at rest in poses that were left out, rms error, {held_out.rates[0].unit}: {each}.")
    return lines
