"""Injection recovery in words and tables: which effects were injected, and which the diagnosis would have found."""

from typing import Any

from imubayes.display.diagnosis_sentences import sentence
from imubayes.display.evidence_text import probability
from imubayes.display.labels import listed, pretty
from imubayes.display.report_layout import Report
from imubayes.display.rounding import percent, significant
from imubayes.display.table_layout import Cell, Sheet
from imubayes.loop.injection_recovery import Trial, Trials

_MOOD = {"first": "", "other name": "weak", "missed": "bad"}


def injection_report(trials: Trials) -> Report:
    """Return what was injected and what was recovered."""
    return Report(injection_lines(trials), [injection_sheet(trials)])


def injection_lines(trials: Trials) -> list[str]:
    """Return the outcome in sentences."""
    lines = [
        f"{_counted(len(trials.trials), 'effect')} injected one by one into simulated data of '{trials.campaign}', "
        f"{_size(trials)}: {trials.detected} detected, the right group first for {trials.group_first}."
    ]
    if trials.nulls:
        low, high = trials.false_alarm_interval
        lines.append(
            f"Without injection: {_counted(trials.false_alarms, 'false alarm')} in "
            f"{_counted(len(trials.nulls), 'draw')}, a rate of {percent(trials.false_alarms / len(trials.nulls))} "
            f"(95 % interval {percent(low)} to {percent(high)})."
        )
    missed = [trial.effect for trial in trials.trials if not trial.detected]
    if missed:
        lines.append(f"Missed: {', '.join(missed)}.")
    if trials.skipped:
        lines.append(f"Not injected, undetectable in these runs: {listed(list(trials.skipped), 12)}.")
    return lines


def _counted(count: int, name: str) -> str:
    return f"{count} {name}{'' if count == 1 else 's'}"


def _size(trials: Trials) -> str:
    typical = trials.size.typical
    if typical is None:
        return f"at the size with Δχ² = {significant(trials.size.delta_chi2)}"
    return f"at {significant(typical)} times the largest typical size"


def injection_sheet(trials: Trials) -> Sheet:
    """Return a line for each effect injected."""
    rows = []
    for trial in trials.trials:
        outcome = "first" if trial.group_first else ("other name" if trial.detected else "missed")
        first = listed(trial.effects, 2) or trial.diagnosis.verdict
        cells = (Cell(trial.effect), Cell(_injected(trial)), Cell(significant(trial.delta_chi2)))
        rows.append(
            (
                *cells,
                Cell(outcome, _MOOD[outcome]),
                Cell(first),
                Cell(probability(trial.diagnosis.probability(trial.effect))),
            )
        )
    head = ("effect", "injected", "Δχ²", "found", "first group", "probability")
    return Sheet("Injection recovery", head, rows, (0, 1, 3, 4))


def _injected(trial: Trial) -> str:
    if not trial.planted:
        return "–"
    first, count = trial.planted[0], len(trial.planted)
    text = f"{first.name.partition('.')[2]} {significant(first.value)} {pretty(first.unit)}"
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
