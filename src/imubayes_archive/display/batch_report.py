"""Reports of a batch: progress and results, answers to the questions asked of it, and what its units show together.

The progress states how far a batch is, what is in the results folder, and which units have no estimates.  The answers
concern populations, priors, comparisons and drift.  Results on the units together are findings, the units for and
against them, and other candidates.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import polars as pl

from imubayes.display.fit_cautions import NOISE_WORDS
from imubayes.display.layout import Cell, Report, Sheet, cells, of_columns
from imubayes.display.loop.diagnosis_sentences import probability
from imubayes.display.numbers_and_labels import chance_text, concise, listed
from imubayes.foundations.errors import Issue
from imubayes.foundations.wording import counted
from imubayes_archive.population.drift import Drift, Drifts
from imubayes_archive.population.model_comparison import ModelComparison, ParameterChange
from imubayes_archive.population.population import LEAST_UNITS
from imubayes_archive.population.units_in_doubt import UnitInDoubt
from imubayes_archive.unit_fits.pooled_discovery import PooledCandidate, PooledDiscovery, PooledFinding
from imubayes_archive.unit_fits.posterior_table import MODEL_FILE, model_folder
from imubayes_archive.unit_fits.run_batch import BatchProgress

# Parameters without significant drift, shown beside those with it.
_MOST_OTHERS = 5


def comparison_report(found: ModelComparison) -> Report:
    """Return what changed from one model to another."""
    alone = f"{found.only_old} in {found.old} alone, {found.only_new} in {found.new} alone"
    said = [f"{counted(found.campaigns, 'campaign')} in both, {alone}"]
    if found.delta_log_evidence is not None:
        said.append(f"log evidence {found.delta_log_evidence:+.1f}, higher in {counted(found.better, 'campaign')}")
    for word, names in (("new", found.added), ("dropped", found.removed)):
        if names:
            said.append(f"{word} parameters: {', '.join(names)}")
    head = ("parameter", "unit", "changed", "mean change", "rms / sd", "sd new/old", "p", "units")
    rows = [_change_row(each) for each in found.parameters]
    note = (
        "changed: campaigns in which the estimate changed by more than the additional variance of the new model "
        "explains, at a false discovery rate of 5 %"
    )
    sheet = Sheet("Changes", head, rows, left=(0, 1, 7), note=note)
    return Report(said, [sheet.with_few(0, 3, 1, 2, 6)])


def _change_row(each: ParameterChange) -> Sequence[Cell]:
    mean = concise(each.mean_change or 0.0, each.mean_change_sd or 0.0)
    return cells(
        each.parameter, each.unit_of_measure, f"{each.significant}/{each.campaigns}", mean,
        f"{each.rms_ratio:.2f}", f"{each.sd_ratio:.2f}", chance_text(each.p),
        ", ".join(each.most_changed[:4])
    )  # fmt: skip


def drift_report(found: Drifts) -> Report:
    """Return the drift between calibrations of one unit, the significant parameters first."""
    changed = sum(each.significant > 0 for each in found.parameters)
    others = [each for each in found.parameters if not each.significant]
    left = len(others) - _MOST_OTHERS
    title = "Drift between calibrations of a unit" + (
        f" (the {left} least significant are in --json)" if left > 0 else ""
    )
    rows = [*filter(lambda each: each.significant, found.parameters), *others[:_MOST_OTHERS]]
    sheet = Sheet(
        title, ("parameter", "per year", "unit", "pairs", "changed", "p", "in units"), list(map(_drift_row, rows)),
        left=(0, 2, 6), note="changed: pairs of consecutive calibrations with a significant change; per year: 0.03(11) "
        "is 0.03 ± 0.11; log: of the natural logarithm",
    )  # fmt: skip
    told = [
        f"{counted(changed, 'drifting parameter')} of {len(found.parameters)}; false discovery rate "
        f"{100 * found.rate:g} %",
        "Trends over the dates or serial numbers of different units: `imubayes batch population`.",
    ]
    return Report(told, [replace(sheet, narrow=replace(of_columns(sheet, (0, 1, 2, 5)), note=""))])


def _drift_row(each: Drift) -> Sequence[Cell]:
    return cells(
        Cell(each.parameter, "bad" if each.significant else ""), concise(each.mean, each.mean_sd),
        "log " * (each.scale == "log") + each.unit_of_measure, str(each.pairs), str(each.significant),
        chance_text(each.p), ", ".join(each.units[:4])
    )  # fmt: skip


_SHOWN = 20


def progress_text(state: BatchProgress) -> str:
    """Return how far a batch is, in one line."""
    if not state.done and state.before < state.units:
        return "compiling for the first campaigns"
    left = state.seconds_left
    parts = [f"{state.before + state.done} of {state.units} campaigns"]
    if state.done:
        parts.append(f"{state.rate:.3g} campaigns/s")
    if state.failed:
        parts.append(f"{state.failed} without estimates")
    if left is not None and left >= 1:
        parts.append(f"{_duration(left)} left")
    return ", ".join(parts)


def _duration(seconds: float) -> str:
    hours, minutes = int(seconds // 3600), int(seconds % 3600 // 60)
    if hours:
        return f"{hours} h {minutes} min"
    return f"{minutes} min {int(seconds % 60)} s" if minutes else f"{int(seconds)} s"


def batch_report(state: BatchProgress, units: pl.DataFrame, out: Path, doubts: Sequence[UnitInDoubt] = ()) -> Report:
    """Return what a batch did, the units without estimates, and the other units that need a person.

    Parameters
    ----------
    units : the table of units of the model.
    doubts : why units need a person.
    """
    before = f"; {counted(state.before, 'campaign')} processed before" if state.before else ""
    said = f"{counted(state.done, 'campaign')} processed in {_duration(state.seconds)}{before}"
    failed = units.filter(pl.col("status") != "fitted")
    rows = [
        [str(row[name]) for name in ("unit", "status", "reason", "file")]
        for row in failed.head(_SHOWN).iter_rows(named=True)
    ]
    # A reason and a path beside each other leave neither enough room on 80 columns.
    slim = [cells(unit, "\n".join(further)) for unit, *further in rows]
    title, apart = "Units without estimates", frozenset(range(1, len(slim)))
    narrow = Sheet(title, ("unit", "status, reason, file"), slim, left=(0, 1), dividers=apart)
    head = ("unit", "status", "reason", "file")
    sheet = Sheet(title, head, [cells(*row) for row in rows], left=(0, 1, 2, 3), narrow=narrow)
    looked_at = [each for each in doubts if each.doubt != "no_estimates"]
    closing = [f"result in {out}: {units.height - failed.height} fitted, {failed.height} without estimates"]
    if failed.height > _SHOWN:
        closing.insert(0, f"{failed.height - _SHOWN} more are in units.parquet")
    if len({each.unit for each in looked_at}) > _SHOWN:
        closing.append(f"units to look at: {len({each.unit for each in looked_at})}; all are in --json")
    closing += [f"next: imubayes {each}" for each in _commands(units, out, looked_at)]
    return Report([said], [sheet, _to_look_at(looked_at)], closing)


def _to_look_at(doubts: Sequence[UnitInDoubt]) -> Sheet:
    """Return the units that need a person, with a line for each reason."""
    by_unit: dict[str, list[UnitInDoubt]] = {}
    for each in doubts:
        by_unit.setdefault(each.unit, []).append(each)
    rows = [
        cells("" if place else unit, _reason(each))
        for unit, reasons in list(by_unit.items())[:_SHOWN]
        for place, each in enumerate(reasons)
    ]
    return Sheet("Units to look at", ("unit", "reason"), rows, left=(0, 1))


def _reason(each: UnitInDoubt) -> str:
    if each.doubt == "population":
        return f"{each.about[0]} lies {each.distance:+.1f} sd from the population"
    named = [NOISE_WORDS.get(one, f"{one} exceeds its known value") for one in each.about]
    return f"intervals must not be trusted: {listed(named, 3)}"


def _commands(units: pl.DataFrame, out: Path, doubts: Sequence[UnitInDoubt]) -> list[str]:
    """Return what to run next: the fit of the first doubtful unit, and what only all units together show."""
    first = next((each for each in doubts if each.doubt == "noise"), None)
    alone = [f"fit {first.file} --model {_model_of(units, out)} --out {out}-{first.unit}"] if first is not None else []
    several = units.filter(pl.col("status") == "fitted").height >= LEAST_UNITS
    return [*alone, *([f"batch population {out}", f"batch diagnose {out}"] if several else [])]


def _model_of(units: pl.DataFrame, out: Path) -> Path:
    return model_folder(out, units["model"][0]) / MODEL_FILE


def batch_json(
    state: BatchProgress, units: pl.DataFrame, model: str, doubts: Sequence[UnitInDoubt] = ()
) -> dict[str, Any]:
    """Return what a batch did, for `--json`."""
    failed = units.filter(pl.col("status") != "fitted").select("unit", "campaign", "digest", "status", "reason", "file")
    return {
        "format": 1, "model": model, "units": units.height, "fitted": units.height - failed.height,
        "done_now": state.done, "done_before": state.before, "seconds": state.seconds, "failed": failed.to_dicts(),
        "doubts": [each.model_dump() for each in doubts],
    }  # fmt: skip


_MOST_NAMED, _MOST_SIDE, _MOST_CANDIDATES = 15, 5, 6
_LAWS = {
    "common": "the same in all units",
    "own": "of its own size in each unit",
    "some": "in some units only",
}


def discovery_report(found: PooledDiscovery, issues: Sequence[Issue] = ()) -> Report:
    """Return what the units show together, and the units that speak for it and against it."""
    of, candidates = counted(found.units, "unit"), counted(found.candidates, "candidate")
    looked = f"{counted(found.campaigns, 'campaign')} of {of}, {candidates}"
    lines = [text for each in found.findings for text in _finding_lines(each)]
    lines.append(_nothing_line(found))
    lines.append(f"{looked}; the prior expects {found.expected:g} missing effect")
    head = ("effect", "acts on", "units", "law", "probability", "log odds", "coefficient", "for / against")
    beside = {(each.effect, each.equipment): each for each in reversed(found.ranking)}
    rows = [_row(each.evidence, each) for each in found.findings]
    rows += [_row(each) for each in list(beside.values())[::-1][:_MOST_CANDIDATES]]
    effects = Sheet("Effects found, and further candidates", head, rows, left=(0, 1, 2, 3, 6)).with_few(0, 3, 4, 5)
    return Report(lines, [*map(_sides, found.findings), effects], [*map(str, issues), *_next(found)])


def _nothing_line(found: PooledDiscovery) -> str:
    if found.findings:
        return f"The probability that nothing else is missing is {probability(found.nothing_else)}."
    return f"No effect is missing that these units show together: probability {probability(found.nothing)}."


def _finding_lines(each: PooledFinding) -> list[str]:
    first, *others = each.place
    where = f" of {each.equipment.kind} {each.equipment.name}" if each.equipment else ""
    law = _LAWS[each.evidence.law].replace("units", f"campaigns{where}") if where else _LAWS[each.evidence.law]
    chance = f"probability {probability(each.probability)}, log odds {each.evidence.log_odds:.1f}"
    lines = [f"{first.effect} is missing ({first.scope}), {law}: {chance}{_size(each)}."]
    if each.equipment is not None and each.equipment.log_bayes_outside is not None:
        said = f"is {each.equipment.log_bayes_outside:.1f}"
        lines.append(f"The log evidence of the {counted(each.equipment.outside, 'other campaign')} {said}.")
    if others:
        told = [
            f"{one.effect}{f' ({one.equipment})' if one.equipment else ''} {probability(one.probability)}"
            for one in each.place
        ]
        lines.append(f"These units cannot distinguish these causes (with their shares): {' or '.join(told)}.")
    if each.named:
        shown = ", ".join(each.named[:_MOST_NAMED]) + (", …" if len(each.named) > _MOST_NAMED else "")
        lines.append(f"Shown by each of {counted(len(each.named), 'unit')} alone: {shown}.")
    return lines


def _size(each: PooledFinding) -> str:
    """Return the coefficients if they are common to all units."""
    known = [f", {c.name} = {concise(c.value, c.sd)} {c.unit}" for c in each.coefficients]
    return "".join(known) if each.evidence.law == "common" else ""


def _next(found: PooledDiscovery) -> list[str]:
    """Return what to do with the first finding."""
    if not found.findings:
        return []
    # All that the units do not distinguish: the posterior then holds each explanation.
    entries = " and ".join(f'[[effect]] name = "{effect}"' for effect in found.findings[0].effects)
    return [
        f"next: add {entries} to a copy of the model, run imubayes batch with the copy and another --out, then "
        "imubayes batch compare OLD NEW"
    ]


def _sides(each: PooledFinding) -> Sheet:
    """Return the units for and against a finding."""
    rows = [
        cells(word, unit.unit, f"{unit.gain:+.1f}", probability(unit.probability))
        for word, listed in (("for", each.supporting), ("against", each.opposing))
        for unit in listed[:_MOST_SIDE]
    ]
    return Sheet(
        f"Units for and against {each.place[0].effect}", ("", "unit", "log evidence", "has it"), rows, left=(0, 1)
    )


def _row(each: PooledCandidate, found: PooledFinding | None = None) -> Sequence[Cell]:
    name = each.effect + (f" ({each.shape})" if each.shape else "")
    scope = each.scope + (f": {each.part}" if each.part else "")
    size, sides = "", ""
    if found is not None:
        size = ", ".join(f"{concise(one.value, one.sd)} {one.unit}" for one in found.coefficients[:2])
        gains = [unit.gain for unit in found.every_unit]
        sides = f"{sum(gain > 0 for gain in gains)} / {sum(gain < 0 for gain in gains)}"
    chance = found.probability if found is not None else each.probability
    return cells(
        name, scope, each.equipment or str(each.units), each.law, probability(chance),
        f"{each.log_odds:.1f}", size, sides
    )  # fmt: skip
