"""An addition in words and tables: predicted and observed, cross-validation, residual rms before and after."""

from collections.abc import Sequence

from imubayes.criticism.cross_validation import CrossValidation
from imubayes.criticism.diagnosis_record import RmsChange
from imubayes.display.labels import pretty, readable
from imubayes.display.prior_conflicts import conflict_line
from imubayes.display.report_layout import Report
from imubayes.display.rounding import significant, value_and_sd
from imubayes.display.table_layout import Cell, Sheet
from imubayes.results.addition import Addition, RunRmsChange

_VERDICTS = {
    "helps": "the addition improves the prediction of {by}s that were left out",
    "unclear": "whether the addition improves the prediction of {by}s that were left out is unclear",
    "not": "THE ADDITION DOES NOT IMPROVE the prediction of {by}s that were left out",
}


def addition_report(addition: Addition) -> Report:
    """Return what an addition brought; tables where the refit is taken."""
    sheets = [coefficient_sheet(addition), channel_sheet(addition), run_change_sheet(addition)]
    return Report(addition_lines(addition), sheets if addition.taken else (), [f"next: {next_command(addition)}"])


def next_command(addition: Addition) -> str:
    """Return the command to run next."""
    return f"imubayes diagnose {(addition.folder if addition.taken else addition.parent) or 'RESULT'}"


def addition_lines(addition: Addition) -> list[str]:
    """Return the outcome in a few lines: what was added, predicted and observed, and cross-validation."""
    names = ", ".join(
        choice.effect + (f" on {', '.join(choice.channels)}" if choice.channels else "") for choice in addition.added
    )
    predicted, observed = addition.predicted.delta_chi2, addition.observed.delta_chi2
    return [
        f"Added: {names}.",
        *(
            f"Prior widened: {name} ~ {prior}; the estimate lies outside the typical range."
            for name, prior in addition.widened.items()
        ),
        *(conflict_line(conflict) for conflict in addition.prior_conflicts),
        *([addition.message] if addition.message else []),
        f"Δχ² predicted {significant(predicted)}, observed {significant(observed)}, at the noise scales of the model "
        "before.",
        *held_out_lines(addition.held_out),
    ]


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
    rows = []
    for estimate in addition.observed.coefficients:
        before = predicted.get(estimate.name)
        value, sd = value_and_sd(estimate.value, estimate.sd)
        guess, width = value_and_sd(before.value, before.sd) if before is not None else value_and_sd(None, None)
        rows.append(tuple(map(Cell, (estimate.name, guess, width, value, sd, pretty(estimate.unit)))))
    head = ("new parameter", "predicted", "± ", "estimated", "±", "unit")
    return Sheet("Predicted and estimated", head, rows, (0, 5))


def channel_sheet(addition: Addition) -> Sheet:
    """Return the table of the residual rms before and after, per channel."""
    rows = [(Cell(change.channel), *_change_cells(change)) for change in addition.channels]
    head = ("channel", "before", "after", "unit", "change")
    return Sheet("Residual rms before and after, per channel", head, rows, (0, 1, 3))


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
    before, after = change.before, change.after
    factor, unit = readable(change.unit, max((size for size in (before, after) if size is not None), default=0.0))
    texts = [significant(None if size is None else size * factor) for size in (before, after)]
    ratio = after / before if before and after is not None else None
    share = "–" if ratio is None else f"{100 * (ratio - 1):+.0f} %".replace("-", "−")
    return (*map(Cell, texts), Cell(pretty(unit)), Cell(share, "bad" if ratio is not None and ratio > 1.05 else ""))
