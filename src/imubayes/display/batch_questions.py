"""What the questions asked of a batch answer: populations, priors, pooled evidence, comparisons, trends."""

import math
from collections.abc import Sequence
from pathlib import Path

from imubayes.batch.compare_models import ModelComparison, ParameterChange
from imubayes.batch.next_prior import ReplacedPrior
from imubayes.batch.parameter_population import ParameterPopulation, Populations
from imubayes.batch.pooled_discovery import EquipmentEvidence, PooledCandidate, PooledDiscovery, PooledFinding
from imubayes.batch.trends import Drift, Trend, Trends
from imubayes.display.archive_report import counted
from imubayes.display.report_layout import Report
from imubayes.display.rounding import concise, significant
from imubayes.display.table_layout import Cell, Sheet
from imubayes.errors import Issue

_SHOWN = 15
_LAWS = {
    "common": "the same in all units",
    "own": "of its own size in each unit",
    "some": "in some units only",
}


def population_report(found: Populations) -> Report:
    """Return mean and spread of every parameter, and the outlying units."""
    said = f"{counted(found.units, 'unit')}, {counted(found.campaigns, 'campaign')}, {found.left_out} without estimates"
    known = [each for each in found.parameters if each.mean is not None]
    head = ("parameter", "unit", "units", "mean", "spread", "law", "error / bit")
    sheet = Sheet("Population", head, [_population_row(each) for each in known], left=(0, 1, 5), note=_NOTE)
    rows = [
        [Cell(each.parameter), Cell(unit.unit), Cell(concise(unit.value, unit.sd)), Cell(f"{unit.distance:+.1f} sd")]
        for each in known
        for unit in each.outlying[:_SHOWN]
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


def discovery_report(found: PooledDiscovery, issues: Sequence[Issue] = ()) -> Report:
    """Return what the units show together, and the units that speak for it and against it."""
    looked = f"{counted(found.campaigns, 'campaign')} of {counted(found.units, 'unit')}, {found.candidates} candidates"
    lines = [f"{looked}; false discovery rate {100 * found.rate:g} %"]
    lines += [_finding_line(each) for each in found.findings] or ["no effect is missing that these units show together"]
    lines += [_equipment_line(each) for each in found.equipment]
    sheets = [
        Sheet(f"Units for and against {each.effects[0]}", ("", "unit", "Δχ²", "p alone"), _unit_rows(each), left=(0, 1))
        for each in found.findings
    ]
    head = ("effect", "acts on", "law", "units", "Δχ² common", "Δχ² own", "log10 p adjusted")
    ranking = Sheet("Candidates", head, [_candidate_row(each) for each in found.ranking], left=(0, 1, 2))
    return Report(lines, [*sheets, ranking], [str(issue) for issue in issues])


def _finding_line(each: PooledFinding) -> str:
    names = each.effects[0] + (f" ({', '.join(each.effects[1:])} fits as well)" if each.effects[1:] else "")
    evidence, named = each.evidence, ""
    if each.named:
        shown = ", ".join(each.named[:_SHOWN]) + (", …" if len(each.named) > _SHOWN else "")
        named = f"; alone it shows in {counted(len(each.named), 'unit')}: {shown}"
    sizes = "; ".join(
        f"{c.name} = {concise(c.value, c.sd)} {c.unit}"
        for c in each.coefficients
        if c.value is not None and c.sd is not None
    )
    size = f", {sizes}" if evidence.law == "common" and sizes else ""
    chance = f"adjusted p = 1e{math.floor(evidence.log10_adjusted)}"
    return f"missing: {names}, {_LAWS[evidence.law]} ({evidence.scope}), {chance}{size}{named}"


def _equipment_line(each: EquipmentEvidence) -> str:
    return (
        f"{each.kind} {each.name}: {' or '.join(each.effects)} in its {counted(each.inside, 'campaign')}, "
        f"log10 p = {each.log10_p:.1f}; in the {each.outside} others {each.log10_p_outside:.1f}"
    )


def _unit_rows(each: PooledFinding) -> list[list[Cell]]:
    common = each.evidence.law == "common"
    return [
        [Cell(word), Cell(unit.unit), Cell(f"{unit.contribution if common else unit.chi2:.1f}"),
         Cell(significant(unit.p, 2))]
        for word, listed in (("for", each.supporting), ("against", each.opposing))
        for unit in listed
    ]  # fmt: skip


def _candidate_row(each: PooledCandidate) -> list[Cell]:
    name = each.effect + (f" ({each.shape})" if each.shape else "")
    return [
        Cell(name), Cell(each.scope), Cell(each.law), Cell(str(each.units)),
        Cell(f"{each.chi2:.1f} ({each.dof})"), Cell(f"{each.chi2_own:.1f} ({each.dof_own})"),
        Cell(f"{each.log10_adjusted:.1f}"),
    ]  # fmt: skip


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
    return Report(said, [Sheet("Changes", head, rows, left=(0, 1, 7), note=note)])


def _change_row(each: ParameterChange) -> list[Cell]:
    mean = concise(each.mean_change or 0.0, each.mean_change_sd or 0.0)
    return [
        Cell(each.parameter), Cell(each.unit_of_measure), Cell(f"{each.significant}/{each.campaigns}"), Cell(mean),
        Cell(f"{each.rms_ratio:.2f}"), Cell(f"{each.sd_ratio:.2f}"), Cell(significant(each.p, 2)),
        Cell(", ".join(each.most_changed[:4])),
    ]  # fmt: skip


def trends_report(found: Trends) -> Report:
    """Return trends over dates and serial numbers, and drifts between calibrations."""
    trends = Sheet(
        "Trends", ("parameter", "over", "slope", "per", "units", "p"), [_trend_row(each) for each in found.trends],
        left=(0, 1, 3),
    )  # fmt: skip
    drifts = Sheet(
        "Drift between calibrations of a unit", ("parameter", "unit", "pairs", "per year", "changed", "p", "units"),
        [_drift_row(each) for each in found.drifts], left=(0, 1, 6),
    )  # fmt: skip
    count = sum(each.significant for each in found.trends)
    said = f"{counted(count, 'significant trend')} of {len(found.trends)}; false discovery rate {100 * found.rate:g} %"
    return Report([said], [trends, drifts])


def _trend_row(each: Trend) -> list[Cell]:
    unit = f"{'log ' if each.scale == 'log' else ''}{each.unit_of_measure} per {each.per}"
    mood = "bad" if each.significant else ""
    return [
        Cell(each.parameter, mood), Cell(each.over), Cell(concise(each.slope, each.slope_sd)), Cell(unit),
        Cell(str(each.units)), Cell(significant(each.p, 2)),
    ]  # fmt: skip


def _drift_row(each: Drift) -> list[Cell]:
    return [
        Cell(each.parameter, "bad" if each.significant else ""), Cell(each.unit_of_measure), Cell(str(each.pairs)),
        Cell(concise(each.mean, each.mean_sd)), Cell(str(each.significant)), Cell(significant(each.p, 2)),
        Cell(", ".join(each.units[:4])),
    ]  # fmt: skip
