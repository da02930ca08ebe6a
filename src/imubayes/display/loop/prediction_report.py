"""A later calibration held against an earlier one: its runs against their prediction, or both results compared.

Runs against their prediction are shown in words, tables and pictures; the pictures and the page are those of `compare`.
Two calibrations of one unit are compared in words and a table.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from markupsafe import Markup

from imubayes.display.compare_report import comparison_page, draw_figures
from imubayes.display.figure_selection import most_telling_first, plan, runs_shown
from imubayes.display.fit_cautions import alarm_of
from imubayes.display.fit_quality_tables import fit_sheet, run_sheet
from imubayes.display.layout import Cell, Report, Sheet, cells, report_html
from imubayes.display.numbers_and_labels import (
    listed,
    pretty,
    ratio_text,
    relation,
    rounded,
    significant,
    value_and_sd,
    with_minus,
)
from imubayes.foundations.files import refuse_occupied, write_text
from imubayes.foundations.progress import Tell
from imubayes.foundations.quantity_names import family_of
from imubayes.foundations.units import DAYS_PER_YEAR
from imubayes.foundations.wording import counted
from imubayes.loop.predicted_runs import ShiftedEstimate
from imubayes.results.folder_files import RESIDUALS
from imubayes.results.prediction import LEAST_CHANCE, RunPrediction
from imubayes.results.repeatability import MOST_INTERVALS, ComparedQuantity, Repeatability
from imubayes.results.summary import Summary

PREDICTION, PREDICTION_PAGE = "prediction.json", "prediction.html"
_MOST_SHIFTS, _MOST_CHANNELS = 8, 9
# If the runs fail, a pull beyond this is named, even if few runs leave its chance open.
_FAR = 4.0


def prediction_report(prediction: RunPrediction, verbose: bool = False) -> Report:
    """Return verdict, goodness of prediction by run and channel, and the estimates that the new runs would move."""
    summary = _as_fit(prediction)
    few = len({run.channel for run in summary.runs}) <= _MOST_CHANNELS
    quality = (fit_sheet if few and not verbose else run_sheet)(summary)
    return Report(
        list(_predicted_lines(prediction)),
        [_predictive(quality), shift_sheet(prediction, verbose)],
        alarm=_alarm(prediction),
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


def _predicted_lines(prediction: RunPrediction) -> Iterator[str]:
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
            f"The new runs test {counted(found.directions, 'combination')} better than the fit knows "
            f"{'it' if found.directions == 1 else 'them'}: χ² {significant(found.calibration_chi2)} for "
            f"{found.directions} (p {relation(found.calibration_p or 0.0)})."
        )
    if not prediction.holds:
        yield from _failures(prediction)
    if found.fitted:
        yield f"Left out, because the fit contains them: {listed(found.fitted)}."
    if found.changed:
        yield f"Different equipment under the same name: {listed(found.changed)}."
    if found.elsewhere:
        yield "The site is different: its gravity, level and heading have their priors."
    own = list(dict.fromkeys(family_of(name) for name in found.unknowns))
    if own:
        yield (
            f"Fitted to the new runs alone, with their priors: {listed(own)} ({counted(len(found.unknowns), 'value')})."
        )


def _failures(prediction: RunPrediction) -> Iterator[str]:
    found, least = prediction.summary, LEAST_CHANCE / 3
    worst = next(iter(found.shifts), None)
    if worst is not None and ((found.worst_shift_p or 0.0) < least or abs(worst.pull) > _FAR):
        shift, sd = value_and_sd(worst.shift, abs(worst.shift / worst.pull))
        yield (
            f"They would move {worst.name} by {shift} {pretty(worst.unit)}; ±{sd} is expected: "
            f"{significant(abs(worst.pull), 2)} standard deviations. Either it has changed, or the model lacks an "
            "effect that the new runs show."
        )
    elif found.worst_run_p is not None and found.worst_run_p < least:
        yield "No change of an estimate explains this. Look at the residuals of the runs and channels in red."


def shift_sheet(prediction: RunPrediction, verbose: bool = False) -> Sheet:
    """Return what the new runs would make of the estimates, largest pull first."""
    shifts = prediction.summary.shifts
    rows = [_shift_row(shift) for shift in shifts]
    note = (
        "pull: shift divided by its standard deviation, if the model describes the new runs; p: probability of a "
        "larger one by chance."
    )
    head = ("estimate", "fit", "shift", "unit", "pull", "p")
    sheet = Sheet("Estimates with the new runs included", head, rows, (0, 3), note=note)
    return sheet if verbose else sheet.few(_MOST_SHIFTS)


def _shift_row(each: ShiftedEstimate):
    value, sd = value_and_sd(each.before, each.sd)
    shift, _ = value_and_sd(each.shift, each.sd)
    pull = with_minus(f"{each.pull:.1f}")
    chance = relation(each.p).removeprefix("= ")
    return cells(each.name, f"{value} ± {sd}", shift, pretty(each.unit), pull, chance)


def save_prediction(prediction: RunPrediction, folder: Path, tell: Tell) -> Path:
    """Write summary, residuals, pictures and their page into a folder; return the page.

    Raises
    ------
    InputError
        if the folder holds something else than an earlier prediction.
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
    report = prediction_report(prediction, verbose=True)
    tables = Markup(report_html(replace(report, alarm="")))
    write_text(page, comparison_page(title, tables, [f"{name}.png" for name in ranked], captions, (), report.alarm))
    write_text(folder / PREDICTION, prediction.summary.json_text())
    return page


_MOST_ROWS = 20
# Share of the variance in common that is worth a sentence.
_MUCH_IN_COMMON = 0.5


def repeatability_report(found: Repeatability, verbose: bool = False) -> Report:
    """Return the verdict, what moved, whether both may be pooled, and the table of differences."""
    return Report(list(_compared_lines(found)), [difference_sheet(found, verbose)])


def _compared_lines(found: Repeatability) -> Iterator[str]:
    unit = f" of unit {found.serial}" if found.serial else ""
    if not found.quantities:
        yield f"Nothing can be compared: there is no quantity that both calibrations{unit} determine."
    else:
        said = "agree" if found.verdict == "agree" else "DO NOT agree"
        yield (
            f"The two calibrations{unit} {said} within their uncertainties: χ² {significant(found.chi2)} for "
            f"{found.freedom} differences of parameters (p {relation(found.p)}); |E_n| ≤ 1 for "
            f"{sum(abs(each.e_n) <= 1 for each in found.quantities)} of {len(found.quantities)} quantities."
        )
    for each in [each for each in found.quantities if each.moved][:3]:
        yield _moved(each, found.days)
    if found.verdict == "differ" and not any(each.moved for each in found.quantities):
        yield "No single quantity moved significantly, but together they did."
    yield from _common(found.quantities)
    yield _pooling(found)
    yield from _due(found)
    if found.other_priors:
        yield (
            f"The priors of the two models differ: {listed(found.other_priors)}. They are compared as if they were "
            "independent; a prior made from the first calibration pulls the second towards it."
        )
    if found.changed:
        yield f"Different equipment under the same name: {listed(found.changed)}."
    if found.elsewhere:
        yield "The sites are different: gravity, level and heading have separate errors."
    if found.not_determined:
        yield f"Not compared, because one of the two does not determine it: {listed(found.not_determined)}."


def _moved(each: ComparedQuantity, days: float | None) -> str:
    apart, sd = value_and_sd(each.difference, each.difference_sd)
    text = f"{each.name} moved by {apart} ± {sd} {pretty(each.unit)} (E_n {significant(each.e_n, 2)})"
    if days:
        rate = significant(each.difference * DAYS_PER_YEAR / abs(days), 2)
        text += f", {rate} {pretty(each.unit)} per year if the drift is linear"
    return f"{text}."


def _common(quantities: Sequence[ComparedQuantity]) -> Iterator[str]:
    shared = [each for each in quantities if each.common > _MUCH_IN_COMMON]
    if shared:
        most = max(shared, key=lambda each: each.common)
        apart = (most.first_sd**2 + most.second_sd**2) ** 0.5
        _, alone = value_and_sd(apart, apart)
        _, sd = value_and_sd(most.difference, most.difference_sd)
        yield (
            f"Most of the uncertainty of {listed([each.name for each in shared], 3)} is common to both calibrations "
            f"(unchanged equipment, or a prior) and does not show in a difference: {most.name} may differ by ±{sd}, "
            f"not by ±{alone}. Both may be wrong by the same ±{value_and_sd(most.first, most.first_sd)[1]} "
            f"{pretty(most.unit)}."
        )


def _due(found: Repeatability) -> Iterator[str]:
    """Yield when the next calibration is due, by the quantity that reaches its limit first."""
    if not found.due:
        return
    for each in found.due[:3]:
        rate, sd = value_and_sd(each.rate, each.rate_sd)
        drift = f"{each.name} drifts by {rate} ± {sd} {pretty(each.unit)} per year"
        if each.days is None:
            yield f"{drift} and stays within its limits for {MOST_INTERVALS:g} times the time between the two."
        elif each.days == 0:
            yield f"{drift} and is not within its limits now, with k = 2: calibration is due."
        else:
            yield f"{drift} and may reach a limit (k = 2) {significant(each.days, 3)} days after the second one."
    yield (
        "This assumes a linear drift, which two calibrations cannot test. `imubayes batch drift` tests it with several."
    )


def _pooling(found: Repeatability) -> str:
    if found.pooled:
        return (
            "They may be pooled. The last column is the estimate from both, with priors and common equipment counted "
            "once."
        )
    if found.verdict == "differ":
        return "They may not be pooled: fit the later one alone, or find the change."
    return "They are not pooled: their priors differ." if found.other_priors else "They are not pooled."


def difference_sheet(found: Repeatability, verbose: bool = False) -> Sheet:
    """Return both estimates, their difference with U (k = 2), E_n and the pooled value, largest |E_n| first.

    The earlier of two dated calibrations is headed as left, the later as found.
    """
    rows = [_row(each, found.pooled) for each in found.quantities]
    head = ["quantity", *_heads(found), "difference", "U", "E_n", *(["pooled"] if found.pooled else []), "unit"]
    note = (
        "U: expanded uncertainty of the difference, k = 2, without the part common to both; E_n: difference "
        "divided by U."
    )
    sheet = Sheet("Differences of both calibrations", head, rows, (0, len(head) - 1), note=note)
    return (sheet if verbose else sheet.few(_MOST_ROWS)).with_few(0, 3, 4, 5, len(head) - 1)


def _heads(found: Repeatability) -> tuple[str, str]:
    if not found.days:
        return "first", "second"
    dates = [date[:10] for date in found.dates if date]
    words = ("as left", "as found") if found.days > 0 else ("as found", "as left")
    return f"{words[0]} {dates[0]}", f"{words[1]} {dates[1]}"


def _row(each: ComparedQuantity, pooled: bool) -> tuple[Cell, ...]:
    first, second = (" ± ".join(value_and_sd(*pair)) for pair in (
        (each.first, each.first_sd), (each.second, each.second_sd)
    ))  # fmt: skip
    apart, width = rounded((each.difference, 2 * each.difference_sd), each.difference_sd)
    e_n = Cell(with_minus(f"{each.e_n:.2f}"), "bad" if each.moved else "weak" if abs(each.e_n) > 1 else "")
    both = [" ± ".join(value_and_sd(each.pooled, each.pooled_sd))] if pooled else []
    return cells(each.name, first, second, apart, width, e_n, *both, pretty(each.unit))
