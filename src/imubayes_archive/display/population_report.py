"""Report of a population: what parts the units, mean and spread of every parameter, units unlike the others; priors."""

import math
from collections.abc import Iterator, Sequence
from pathlib import Path

from imubayes.display.layout import Cell, Report, Sheet, cells
from imubayes.display.loop.diagnosis_sentences import probability
from imubayes.display.numbers_and_labels import concise, listed, significant, value_and_sd
from imubayes.foundations.wording import counted
from imubayes_archive.population.hierarchical_fit import HierarchicalFit
from imubayes_archive.population.parameter_population import ParameterPopulation, Populations
from imubayes_archive.population.population_findings import PopulationFinding, PopulationGroup
from imubayes_archive.population.population_priors import ReplacedPrior

_MOST_OUTLYING, _MOST_MEMBERS = 15, 8


def population_report(found: Populations, fit: HierarchicalFit | None = None) -> Report:
    """Return what parts the units, mean and spread of every parameter, and the outlying units.

    Parameters
    ----------
    fit : that the populations are of; None for those of the fits of each unit alone.
    """
    said = f"{counted(found.units, 'unit')}, {counted(found.campaigns, 'campaign')}, {found.left_out} without estimates"
    known = [each for each in found.parameters if each.mean is not None]
    own = [each for each in known if each.kind != "derived"]
    told = [said, *(line for each in own for line in finding_lines(each)), *_nothing(own), *_of_doubted(fit)]
    head = ("parameter", "unit", "units", "mean", "spread", "law")
    sheet = Sheet("Population", head, [_population_row(each) for each in known], left=(0, 1, 5), note=_NOTE)
    rows = [
        cells(each.parameter, unit.unit, concise(unit.value, unit.sd), f"{unit.distance:+.1f} sd")
        for each in known
        for unit in each.outlying[:_MOST_OUTLYING]
    ]
    outlying = Sheet("Outlying units", ("parameter", "unit", "estimate", "distance"), rows, left=(0, 1))
    return Report(told, [sheet.with_few(0, 3, 4, 1), outlying], [*_unknown(found), *_of_rounds(fit)])


_NOTE = (
    "mean: of the first group, of the units before a step, or at the middle of a trend; spread: half the width of the "
    "central 68.3 % within a group; 0.57(9): 0.57 ± 0.09; (log): of the natural logarithm; units: number whose data "
    "determine the parameter, of all"
)


def _unknown(found: Populations) -> Iterator[str]:
    """Yield a line for each reason why parameters have no population, with their names."""
    missing = [each for each in found.parameters if each.mean is None]
    for reason in dict.fromkeys(each.reason for each in missing):
        names = [each.parameter for each in missing if each.reason == reason]
        yield f"No population of {listed(names)}: {reason}."


def _of_doubted(fit: HierarchicalFit | None) -> Iterator[str]:
    if fit is not None and fit.doubted:
        yield (
            "Intervals of these units must not be trusted, neither alone nor given the population: "
            f"{listed(fit.doubted)}."
        )


def _nothing(known: Sequence[ParameterPopulation]) -> Iterator[str]:
    """Yield that no parameter has groups, steps or trends, if none has."""
    searched = [each.laws for each in known if each.laws is not None]
    if searched and not any(each.findings or each.possible for each in searched):
        least = min(each.nothing_else for each in searched)
        yield f"All units form one group, with a probability of {probability(least)} or more for each parameter."


def _of_rounds(fit: HierarchicalFit | None) -> Iterator[str]:
    if fit is None:
        yield "Each unit was fitted alone."
        return
    if fit.fitted:
        yield f"Fitted again with the noise scales of the others as prior: {counted(fit.fitted, 'unit')}."
    else:
        yield "Each unit was fitted alone: the other units do not determine its noise scales better."
    if fit.left_out:
        yield f"Fitted alone: {listed(fit.left_out, 3)}."


def finding_lines(each: ParameterPopulation) -> Iterator[str]:
    """Yield a sentence for each finding of a parameter."""
    if each.laws is None:
        return
    unit = ("log " * (each.scale == "log") + each.unit_of_measure).strip()
    for found in each.laws.findings:
        chance = f"(probability {probability(found.probability)})"
        yield f"{each.parameter}: {_finding(found, unit)} {chance}.{_beside(found)}"
    if (found := each.laws.possible) is not None:
        yield f"{each.parameter}: possibly {_finding(found, unit)} (probability {probability(found.probability)})."


def _finding(found: PopulationFinding, unit: str) -> str:
    if found.kind == "trend":
        slope = " ± ".join(value_and_sd(found.slope, found.slope_sd))
        return f"trend over {found.covariate}, {slope} {unit} per {found.per}"
    first, *others = found.groups
    if found.kind == "step":
        return f"step over {found.covariate} {found.at}, {_offset(others[0], unit)} in {_members(others[0])}"
    apart = "; ".join(f"{_of(group, found)} {_offset(group, unit)}" for group in others)
    if found.kind == "groups":
        return f"{len(found.groups)} groups of units, {apart} against {_members(first)}"
    return f"differs with {found.covariate}, {apart} against {first.name} ({counted(len(first.units), 'unit')})"


def _of(group: PopulationGroup, found: PopulationFinding) -> str:
    return _members(group) if found.kind == "groups" else f"{group.name} ({_members(group)})"


def _offset(group: PopulationGroup, unit: str) -> str:
    if unit.startswith("log "):
        return f"{significant(math.exp(group.offset), 2)} times"
    value, sd = value_and_sd(group.offset, group.offset_sd)
    return f"{'' if value.startswith('-') else '+'}{value} ± {sd} {unit}"


def _members(group: PopulationGroup) -> str:
    """Return the members of a group by name, as far as there is room."""
    shown = listed(group.units, _MOST_MEMBERS)
    return shown if len(group.units) <= _MOST_MEMBERS else f"{len(group.units)} units ({shown})"


def _beside(found: PopulationFinding) -> str:
    return f" Membership is undecided for {listed(found.undecided, _MOST_MEMBERS)}." if found.undecided else ""


def _population_row(each: ParameterPopulation) -> Sequence[Cell]:
    assert each.mean is not None
    unit = each.unit_of_measure + (" (log)" if each.scale == "log" else "")
    law = "normal" if each.freedom is None else f"t, ν = {each.freedom:g}"
    if each.laws is not None and each.laws.findings:
        law = " + ".join(found.kind for found in each.laws.findings)
    return cells(
        each.parameter, unit, f"{each.informative}/{each.units}",
        concise(each.mean, each.mean_sd or 0.0), concise(each.spread or 0.0, each.spread_sd or 0.0),
        law,
    )  # fmt: skip


def prior_report(replaced: Sequence[ReplacedPrior], out: Path) -> Report:
    """Return which priors the model of the next unit has from the population."""
    rows = [cells(each.parameter, each.prior, each.before or "default") for each in replaced]
    sheet = Sheet("Priors from the population", ("parameter", "prior", "before"), rows, left=(0, 1, 2))
    return Report([], [sheet], [f"model written to {out}"])
