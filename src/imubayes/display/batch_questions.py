"""What the questions asked of a batch answer: populations, priors, comparisons, trends."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from imubayes.batch.compare_models import ModelComparison, ParameterChange
from imubayes.batch.next_prior import ReplacedPrior
from imubayes.batch.parameter_population import ParameterPopulation, Populations
from imubayes.batch.trends import Drift, Trend, Trends
from imubayes.display.archive_report import counted
from imubayes.display.report_layout import Report
from imubayes.display.rounding import chance_text, concise, significant
from imubayes.display.table_layout import Cell, Sheet, of_columns

_MOST_OUTLYING = 15
# Trends and drifts that are not significant, shown beside those that are.
_MOST_OTHERS = 5


def population_report(found: Populations) -> Report:
    """Return mean and spread of every parameter, and the outlying units."""
    said = f"{counted(found.units, 'unit')}, {counted(found.campaigns, 'campaign')}, {found.left_out} without estimates"
    known = [each for each in found.parameters if each.mean is not None]
    head = ("parameter", "unit", "units", "mean", "spread", "law", "error / bit")
    sheet = Sheet("Population", head, [_population_row(each) for each in known], left=(0, 1, 5), note=_NOTE)
    sheet = replace(sheet, narrow=of_columns(sheet, (0, 3, 4, 1)))
    rows = [
        [Cell(each.parameter), Cell(unit.unit), Cell(concise(unit.value, unit.sd)), Cell(f"{unit.distance:+.1f} sd")]
        for each in known
        for unit in each.outlying[:_MOST_OUTLYING]
    ]
    outlying = Sheet("Outlying units", ("parameter", "unit", "estimate", "distance"), rows, left=(0, 1))
    unknown = [f"{each.parameter}: {each.reason}" for each in found.parameters if each.mean is None]
    return Report([said], [sheet, outlying], unknown)


_NOTE = (
    "spread: half the width of the central 68.3 %; (log): of the natural logarithm; error: information lost to draws"
)


def _population_row(each: ParameterPopulation) -> list[Cell]:
    assert each.mean is not None
    unit = each.unit_of_measure + (" (log)" if each.scale == "log" else "")
    law = "normal" if each.freedom is None else f"t, ν = {each.freedom:g}"
    return [
        Cell(each.parameter), Cell(unit), Cell(f"{each.informative}/{each.units}"),
        Cell(concise(each.mean, each.mean_sd or 0.0)), Cell(concise(each.spread or 0.0, each.spread_sd or 0.0)),
        Cell(law), Cell(significant(each.information_error, 1) if each.information_error else "0"),
    ]  # fmt: skip


def prior_report(replaced: Sequence[ReplacedPrior], out: Path) -> Report:
    """Return which priors the model of the next unit has from the population."""
    rows = [[Cell(each.parameter), Cell(each.prior), Cell(each.before or "default")] for each in replaced]
    sheet = Sheet("Priors from the population", ("parameter", "prior", "before"), rows, left=(0, 1, 2))
    return Report([], [sheet], [f"model written to {out}"])


def comparison_report(found: ModelComparison) -> Report:
    """Return what changed from one model to another."""
    alone = f"{found.only_old} in {found.old} alone, {found.only_new} in {found.new} alone"
    said = [f"{counted(found.campaigns, 'campaign')} in both, {alone}"]
    if found.delta_log_evidence is not None:
        said.append(f"log evidence {found.delta_log_evidence:+.1f}, higher in {found.better} campaigns")
    for word, names in (("new", found.added), ("dropped", found.removed)):
        if names:
            said.append(f"{word} parameters: {', '.join(names)}")
    head = ("parameter", "unit", "changed", "mean change", "rms / sd", "sd new/old", "p", "units")
    rows = [_change_row(each) for each in found.parameters]
    note = "changes beyond the variance that the new model adds, at a false discovery rate of 5 %"
    sheet = Sheet("Changes", head, rows, left=(0, 1, 7), note=note)
    return Report(said, [replace(sheet, narrow=of_columns(sheet, (0, 3, 1, 2, 6)))])


def _change_row(each: ParameterChange) -> list[Cell]:
    mean = concise(each.mean_change or 0.0, each.mean_change_sd or 0.0)
    return [
        Cell(each.parameter), Cell(each.unit_of_measure), Cell(f"{each.significant}/{each.campaigns}"), Cell(mean),
        Cell(f"{each.rms_ratio:.2f}"), Cell(f"{each.sd_ratio:.2f}"), Cell(chance_text(each.p)),
        Cell(", ".join(each.most_changed[:4])),
    ]  # fmt: skip


def trends_report(found: Trends) -> Report:
    """Return trends over dates and serial numbers, and drifts between calibrations: the significant ones first."""
    head = ("parameter", "slope", "unit", "per", "units", "p")
    trends = Sheet(
        _title("Trends", sum(each.significant for each in found.trends), len(found.trends)), head,
        [_trend_row(each) for each in _leading(found.trends, lambda each: each.significant)], left=(0, 2, 3),
    )  # fmt: skip
    head = ("parameter", "per year", "unit", "pairs", "changed", "p", "in units")
    changed = sum(each.significant > 0 for each in found.drifts)
    drifts = Sheet(
        _title("Drift between calibrations of a unit", changed, len(found.drifts)), head,
        [_drift_row(each) for each in _leading(found.drifts, lambda each: each.significant > 0)], left=(0, 2, 6),
        note="changed: pairs of consecutive calibrations with a significant change",
    )  # fmt: skip
    told = [
        f"{counted(sum(each.significant for each in found.trends), 'significant trend')} of {len(found.trends)}, "
        f"{counted(changed, 'drifting parameter')} of {len(found.drifts)}; false discovery rate {100 * found.rate:g} %"
    ]
    sheets = [replace(trends, narrow=of_columns(trends, (0, 1, 2, 3, 5)))] if trends.rows else []
    sheets += [replace(drifts, narrow=replace(of_columns(drifts, (0, 1, 2, 5)), note=""))] if drifts.rows else []
    return Report(told, sheets)


def _title(words: str, significant_ones: int, count: int) -> str:
    left = count - significant_ones - _MOST_OTHERS
    return f"{words} (the {left} least significant are in --json)" if left > 0 else words


def _leading[T: (Trend, Drift)](ordered: Sequence[T], holds: Callable[[T], bool]) -> list[T]:
    """Return the significant ones and the first few of the others."""
    return [*filter(holds, ordered), *[each for each in ordered if not holds(each)][:_MOST_OTHERS]]


def _unit(each: Trend | Drift) -> str:
    return "log " * (each.scale == "log") + each.unit_of_measure


def _trend_row(each: Trend) -> list[Cell]:
    mood, per = "bad" if each.significant else "", each.per.replace("serial numbers", "serials")
    return [
        Cell(each.parameter, mood), Cell(concise(each.slope, each.slope_sd)), Cell(_unit(each)), Cell(per),
        Cell(str(each.units)), Cell(chance_text(each.p)),
    ]  # fmt: skip


def _drift_row(each: Drift) -> list[Cell]:
    return [
        Cell(each.parameter, "bad" if each.significant else ""), Cell(concise(each.mean, each.mean_sd)),
        Cell(_unit(each)), Cell(str(each.pairs)), Cell(str(each.significant)),
        Cell(chance_text(each.p)), Cell(", ".join(each.units[:4])),
    ]  # fmt: skip
