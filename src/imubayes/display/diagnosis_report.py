"""A diagnosis as it is shown: the verdict in a sentence, what to expect, the next command; then the evidence."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from imubayes.criticism.diagnosis_record import Diagnosis, EffectGroup
from imubayes.display.diagnosis_sentences import sentence
from imubayes.display.diagnosis_tables import (
    formula_sheet,
    noise_sheet,
    outlier_sheet,
    ranking_sheet,
    recorded_noise_sheet,
    undetectable_sheet,
)
from imubayes.display.evidence_text import evidence_text
from imubayes.display.formula_source import formula_source
from imubayes.display.labels import listed, pretty
from imubayes.display.report_layout import Report
from imubayes.display.rounding import significant
from imubayes.display.run_design_words import run_design_text
from imubayes.display.table_layout import Sheet
from imubayes.errors import InputError, Issue

# Rows of the tables that the verdict rests on, so that the whole fits on a screen of 24 lines.
_MOST_LEADING = 5


def diagnosis_report(found: Diagnosis, pictures: Sequence[Path] = (), verbose: bool = False) -> Report:
    """Return the verdict with its evidence; the answer about one effect where one was asked for.

    Parameters
    ----------
    pictures : the files that show the residual behind the first group, and the noise.
    verbose : add every table; otherwise the first rows of those that the verdict rests on, to fit on one screen.
    """
    if found.asked is not None:
        return Report([sentence(found)], [ranking_sheet(found)])
    told, commands = diagnosis_lines(found), next_lines(found, pictures)
    if not verbose:
        return Report(told, leading_sheets(found), [*_omitted(found), *commands])
    noise = [noise_sheet(found), recorded_noise_sheet(found)]
    sheets = [ranking_sheet(found), *noise, outlier_sheet(found), formula_sheet(found)]
    return Report([*told, *commands], [*sheets, undetectable_sheet(found)])


def leading_sheets(found: Diagnosis) -> list[Sheet]:
    """Return the tables that the verdict rests on, their first rows alone."""
    sheets = {
        "unexplained_structure": [formula_sheet(found), ranking_sheet(found)],
        "noise_model": [noise_sheet(found), recorded_noise_sheet(found)],
    }.get(found.verdict, [ranking_sheet(found)])
    sheets = [sheet for sheet in sheets if sheet.rows]
    each = max(_MOST_LEADING // max(len(sheets), 1), 2)
    return [_leading(sheet, each) for sheet in sheets]


def _leading(sheet: Sheet, most: int) -> Sheet:
    """Return the first rows of a table, without its note."""
    narrow = _leading(sheet.narrow, most) if sheet.narrow is not None else None
    return replace(sheet, rows=sheet.rows[:most], note="", narrow=narrow)


def _omitted(found: Diagnosis) -> list[str]:
    """Return what the tables that are left out hold, in one line."""
    counts = {
        "effect": len(found.ranking),
        "outlier": len(found.outliers),
        "undetectable effect": len(found.undetectable),
    }
    each = [f"{count} {name}{'s' if count > 1 else ''}" for name, count in counts.items() if count]
    return [f"All tables: {', '.join(each)}: imubayes diagnose {found.result} --verbose"] if each else []


def diagnosis_json(found: Diagnosis) -> dict[str, Any]:
    """Return a diagnosis as `imubayes diagnose --json` prints it: the record with its sentence and next command."""
    formulas = [each.model_dump(mode="json") | {"python": formula_source(each)} for each in found.formulas]
    groups = [
        group.model_dump(mode="json") | {"effects": list(group.effects), "separating_run": _run_text(group)}
        for group in found.groups
    ]
    shown = {"sentence": sentence(found), "groups": groups, "formulas": formulas, "next": next_command(found)}
    return found.model_dump(mode="json") | shown


def diagnosis_lines(found: Diagnosis) -> list[str]:
    """Return the verdict, the probability of each explanation, and the prediction for what leads."""
    lines = [sentence(found)]
    if found.explanations is not None:
        lines.append(evidence_text(found.explanations))
    if found.groups:
        lines.append(_prediction(found))
        lines += _discriminating(found)
    if found.verdict == "not_converged" and found.explanations is not None:
        lines.append("What is said here refers to the point where the fit stopped, and is provisional.")
    elif found.message and found.verdict != "not_converged":
        lines.append("The sampling of this fit did not converge; what is said here refers to its mode.")
    return lines


def next_lines(found: Diagnosis, pictures: Sequence[Path] = ()) -> list[str]:
    """Return the pictures and the next commands, one line each: the simplest explanation, and all that fit."""
    command, other = next_command(found), found.all_that_fit
    # The only command of the loop that takes minutes.
    if command.startswith("imubayes plant"):
        command += "  # minutes: would these runs have shown an effect?"
    lines = [*(f"picture: {picture}" for picture in pictures), *([f"next: {command}"] if command else [])]
    if other is not None:
        whole = add_command(other.effects, other.channels, found.result, f"{found.result}-all")
        lines.append(f"or, with all that fit as well: {whole}")
    return lines


def next_command(found: Diagnosis) -> str:
    """Return the command to run next; empty for an answer about one effect."""
    result, choice = found.result, found.proposed
    if found.asked is not None:
        return ""
    if choice is not None:
        return add_command(choice.effects, choice.channels, result, f"{result}-{choice.effects[0]}")
    if found.formulas:
        adding = f"imubayes add found_shape.py --to {result} --out {result}-found_shape"
        return f"imubayes diagnose {result} --python > found_shape.py && {adding}"
    if found.verdict == "adequate":
        return f"imubayes plant --result {result}"
    return f"imubayes compare {result}"


def add_command(effects: Sequence[str], channels: Sequence[str] | None, result: str, out: str) -> str:
    """Return the command that adds effects to the model of a result, on channels where they are named."""
    on = f" --channels {' '.join(channels)}" if channels else ""
    return f"imubayes add {' '.join(effects)} --to {result} --out {out}{on}"


def effect_source(found: Diagnosis) -> str:
    """Return the effect class written for what no effect explains.

    Raises
    ------
    InputError
        where that has no formula.
    """
    if found.formulas:
        return formula_source(found.formulas[0])
    raise InputError(
        Issue(
            "there is no effect class to print",
            f"diagnosis: {found.verdict}",
            "a cause outside the catalogue, with a formula",
            f"do what the diagnosis says next: {next_command(found) or 'nothing'}",
        )
    )


def _prediction(found: Diagnosis) -> str:
    best = found.groups[0]
    rms, together = best.residual, found.delta_chi2 if found.delta_chi2 is not None else best.delta_chi2
    added = listed([each.effects[0] for each in found.groups])
    alone = f", with {best.effects[0]} alone" if len(found.groups) > 1 else ""
    return (
        f"Predicted with {added} added: Δχ² {significant(together)} at the noise known beforehand; residual of "
        f"{rms.channel} {significant(rms.before)} → {significant(rms.after)} {pretty(rms.unit)} rms{alone}."
    )


def _discriminating(found: Diagnosis) -> list[str]:
    """Return the run that would distinguish the effects of a group that these do not."""
    return [
        f"A run that would distinguish {listed(group.effects)}: {_run_text(group)}."
        for group in found.groups
        if group.discriminating_run is not None
    ]


def _run_text(group: EffectGroup) -> str:
    return run_design_text(group.discriminating_run) if group.discriminating_run is not None else ""
