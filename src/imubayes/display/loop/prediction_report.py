"""Runs against their prediction in words, tables and pictures; the pictures and the page are those of `compare`."""

from collections.abc import Iterator
from pathlib import Path

from markupsafe import Markup

from imubayes.display.figure_selection import most_telling_first, plan, runs_shown
from imubayes.display.fit_cautions import alarm_of
from imubayes.display.fit_quality_tables import fit_sheet, run_sheet
from imubayes.display.layout import Report, Sheet, cells, report_html
from imubayes.display.model_against_measurement import comparison_page, draw_figures
from imubayes.display.numbers_and_labels import counted, listed, pretty, ratio_text, relation, significant, value_and_sd
from imubayes.foundations.files import refuse_occupied, write_text
from imubayes.foundations.progress import Tell
from imubayes.loop.predicted_runs import ShiftedEstimate
from imubayes.results.folder_files import RESIDUALS
from imubayes.results.prediction import LEAST_CHANCE, RunPrediction
from imubayes.results.summary import Summary

PREDICTION, PREDICTION_PAGE = "prediction.json", "prediction.html"
_MOST_ROWS, _MOST_CHANNELS = 8, 9
# Where the runs fail, a pull beyond this is named, even where few runs leave its chance open.
_FAR = 4.0


def prediction_report(prediction: RunPrediction, verbose: bool = False) -> Report:
    """Return verdict, goodness of prediction by run and channel, and the estimates that the new runs would move."""
    summary = _as_fit(prediction)
    few = len({run.channel for run in summary.runs}) <= _MOST_CHANNELS
    quality = (fit_sheet if few and not verbose else run_sheet)(summary)
    return Report(
        list(_lines(prediction)), [_predictive(quality), shift_sheet(prediction, verbose)], alarm=_alarm(prediction)
    )


def _predictive(quality: Sheet) -> Sheet:
    note = quality.note.replace("noise explains", "noise and calibration explain")
    return quality.changed(title=quality.title.replace("fit", "prediction"), note=note, alarm="")


def _alarm(prediction: RunPrediction) -> str:
    """Return the warning of the fit that predicts: what rests on it is as doubtful."""
    found = alarm_of(prediction.fit)
    return f"The fit: {found}" if found else ""


def _as_fit(prediction: RunPrediction) -> Summary:
    """Return the prediction as tables and pictures of a fit take it: no estimates, each reading a degree of freedom."""
    found = prediction.summary
    return prediction.fit.model_copy(
        update={
            "campaign": found.campaign, "runs": found.runs, "chi2": found.chi2, "dof": float(found.n),
            "known_noise": None, "parameters": (), "derived": (), "combinations": (),
        }
    )  # fmt: skip


def _lines(prediction: RunPrediction) -> Iterator[str]:
    found = prediction.summary
    ratio = ratio_text(None if found.chi2 is None else found.chi2 / max(found.n, 1))
    names = list(dict.fromkeys(run.name for run in found.runs))
    said = "as predicted" if prediction.holds else "NOT as predicted"
    p = "–" if found.p is None else relation(found.p)
    yield (
        f"{counted(len(names), 'run')} of {found.campaign} {'is' if len(names) == 1 else 'are'} {said} by model "
        f"{found.model} fitted to {found.result_campaign}: χ²/n {ratio} for n = {found.n} (p {p})."
    )
    if found.directions:
        yield (
            f"Of the estimates, the new runs test {counted(found.directions, 'combination')} better than the fit knows "
            f"{'it' if found.directions == 1 else 'them'}: χ² {significant(found.calibration_chi2)} for "
            f"{found.directions} (p {relation(found.calibration_p or 0.0)})."
        )
    if not prediction.holds:
        yield from _failures(prediction)
    if found.fitted:
        yield f"Left out, as they were fitted: {listed(found.fitted)}."
    if found.changed:
        yield f"Not the equipment of the fit, although named alike: {listed(found.changed)}."
    if found.elsewhere:
        yield "The site is another one: its gravity, level and heading have their priors."
    own = list(dict.fromkeys(name.partition("[")[0] for name in found.unknowns))
    if own:
        yield f"Fitted of the new runs alone, by their priors: {listed(own)} ({counted(len(found.unknowns), 'value')})."


def _failures(prediction: RunPrediction) -> Iterator[str]:
    found, least = prediction.summary, LEAST_CHANCE / 3
    worst = next(iter(found.shifts), None)
    if worst is not None and ((found.worst_shift_p or 0.0) < least or abs(worst.pull) > _FAR):
        shift, sd = value_and_sd(worst.shift, abs(worst.shift / worst.pull))
        yield (
            f"They would move {worst.name} by {shift} {pretty(worst.unit)}, where ±{sd} is to be expected: "
            f"{significant(abs(worst.pull), 2)} standard deviations. Either it has changed, or the model lacks what "
            "the new runs show of it."
        )
    elif found.worst_run_p is not None and found.worst_run_p < least:
        yield "No estimate explains it: look at the residuals of the runs and channels in red."


def shift_sheet(prediction: RunPrediction, verbose: bool = False) -> Sheet:
    """Return what the new runs would make of the estimates, largest pull first."""
    shifts = prediction.summary.shifts
    rows = [_shift_row(shift) for shift in shifts]
    note = "pull: shift over its standard deviation where the model describes the new runs; p: of so large a one."
    head = ("estimate", "fit", "shift", "unit", "pull", "p")
    sheet = Sheet("What the new runs would make of the estimates", head, rows, (0, 3), note=note)
    left = len(rows) - _MOST_ROWS
    return sheet if verbose or left <= 0 else sheet.first(_MOST_ROWS, f"{left} more with --verbose. {note}")


def _shift_row(each: ShiftedEstimate):
    value, sd = value_and_sd(each.before, each.sd)
    shift, _ = value_and_sd(each.shift, each.sd)
    pull = f"{each.pull:.1f}".replace("-", "−")
    chance = relation(each.p).removeprefix("= ")
    return cells(each.name, f"{value} ± {sd}", shift, pretty(each.unit), pull, chance)


def save_prediction(prediction: RunPrediction, folder: Path, tell: Tell) -> Path:
    """Write summary, residuals, pictures and their page into a folder; return the page.

    Raises
    ------
    InputError
        where the folder holds something else than an earlier prediction.
    """
    if not (folder / PREDICTION).is_file():
        refuse_occupied(folder)
    folder.mkdir(parents=True, exist_ok=True)
    summary, table = _as_fit(prediction), prediction.residuals.table
    chosen = runs_shown(summary, table)
    figures = dict(plan(summary, table, [], {}, chosen))
    ranked = most_telling_first(list(figures), summary, table, chosen)
    _, captions = draw_figures({name: figures[name] for name in ranked}, folder, tell)
    prediction.residuals.table.write_parquet(folder / RESIDUALS)
    page = folder / PREDICTION_PAGE
    title = f"{summary.campaign}, predicted by model {summary.model} of {prediction.summary.result_campaign}"
    tables = Markup(report_html(prediction_report(prediction, verbose=True)))
    write_text(page, comparison_page(title, tables, [f"{name}.png" for name in ranked], captions, ()))
    write_text(folder / PREDICTION, prediction.summary.json_text())
    return page
