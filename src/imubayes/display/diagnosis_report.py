"""A diagnosis as it is shown: the verdict in a sentence, what to expect, the next command; then the evidence."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from imubayes.criticism.diagnosis_record import Diagnosis, EffectGroup
from imubayes.criticism.verdict import MISSING
from imubayes.display.diagnosis_sentences import sentence
from imubayes.display.diagnosis_tables import (
    noise_sheet,
    outlier_sheet,
    ranking_sheet,
    recorded_noise_sheet,
    structure_sheet,
    undetectable_sheet,
)
from imubayes.display.evidence_text import evidence_text
from imubayes.display.labels import pretty
from imubayes.display.report_layout import Report
from imubayes.display.rounding import relation, significant
from imubayes.display.run_design_words import run_design_text
from imubayes.display.structure_words import formula_source, structure_shape
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
    sheets = [ranking_sheet(found), *noise, outlier_sheet(found), structure_sheet(found)]
    return Report([*told, *commands], [*sheets, undetectable_sheet(found)])


def leading_sheets(found: Diagnosis) -> list[Sheet]:
    """Return the tables that the verdict rests on, their first rows alone."""
    sheets = {
        "unexplained_structure": [structure_sheet(found)],
        "noise_model": [noise_sheet(found), recorded_noise_sheet(found)],
        "not_converged": [],
    }.get(found.verdict, [ranking_sheet(found)])
    if found.verdict in MISSING and found.noise_outweighs:
        sheets.append(noise_sheet(found))
    each = max(_MOST_LEADING // max(len(sheets), 1), 2)
    return [_leading(sheet, each) for sheet in sheets]


def _leading(sheet: Sheet, most: int) -> Sheet:
    """Return the first rows of a table, without its note."""
    narrow = _leading(sheet.narrow, most) if sheet.narrow is not None else None
    return replace(sheet, rows=sheet.rows[:most], note="", narrow=narrow)


def _omitted(found: Diagnosis) -> list[str]:
    """Return what the tables that are left out hold, in one line."""
    counts = {
        "candidate": len(found.ranking),
        "significant structure": len(found.structure),
        "outlier": len(found.outliers),
        "undetectable effect": len(found.undetectable),
    }
    each = [f"{count} {name}{'s' if count > 1 else ''}" for name, count in counts.items() if count]
    return [f"All tables: {', '.join(each)}: imubayes diagnose {found.result} --verbose"] if each else []


def diagnosis_json(found: Diagnosis) -> dict[str, Any]:
    """Return a diagnosis as `imubayes diagnose --json` prints it: the record with its sentence and next command."""
    structure = [
        each.model_dump(mode="json") | {"shape": structure_shape(each), "python": formula_source(each)}
        for each in found.structure
    ]
    groups = [group.model_dump(mode="json") | {"separating_run": _run_text(group)} for group in found.groups]
    shown = {"sentence": sentence(found), "groups": groups, "structure": structure, "next": next_command(found)}
    return found.model_dump(mode="json") | shown


def diagnosis_lines(found: Diagnosis) -> list[str]:
    """Return the verdict, and the prediction for the first group."""
    lines = [sentence(found)]
    if found.explanations is not None:
        lines.append(evidence_text(found.explanations))
    if found.groups:
        lines.append(_prediction(found))
        lines += _indistinguishable(found)
        if found.wandering == "rival":
            lines.append("Record the unit at rest again: a systematic drift repeats, wandering noise does not.")
    elif found.verdict == "not_converged":
        lines.append("Candidates are not ranked about a fit that did not converge.")
    if found.message and found.verdict != "not_converged":
        lines.append("The sampling of this fit did not converge; what is said here is about its mode.")
    return lines


def next_lines(found: Diagnosis, pictures: Sequence[Path] = ()) -> list[str]:
    """Return the pictures and the next command, one line each."""
    command = next_command(found)
    # The only command of the loop that takes minutes.
    if command.startswith("imubayes plant"):
        command += "  # minutes: would these runs have shown an effect?"
    return [*(f"picture: {picture}" for picture in pictures), *([f"next: {command}"] if command else [])]


def next_command(found: Diagnosis) -> str:
    """Return the command to run next; empty for an answer about one effect."""
    result, choice = found.result, found.proposed
    if found.asked is not None:
        return ""
    if choice is not None:
        return add_command(choice.effects, choice.channels, result, f"{result}-{choice.effects[0]}")
    if found.verdict == "unexplained_structure":
        printable = any(structure.terms for structure in found.structure)
        adding = f"imubayes add found_shape.py --to {result} --out {result}-found_shape"
        written = f"imubayes diagnose {result} --python > found_shape.py && {adding}"
        return written if printable else f"imubayes compare {result}"
    if found.verdict in ("noise_model", "run_disagrees", "not_converged") or found.wandering:
        return f"imubayes compare {result}"
    return f"imubayes plant --result {result}"


def add_command(effects: Sequence[str], channels: Sequence[str] | None, result: str, out: str) -> str:
    """Return the command that adds effects to the model of a result, on channels where they are named."""
    on = f" --channels {' '.join(channels)}" if channels else ""
    return f"imubayes add {' '.join(effects)} --to {result} --out {out}{on}"


def effect_source(found: Diagnosis) -> str:
    """Return the effect class written for the strongest unexplained structure.

    Raises
    ------
    InputError
        where no structure has a formula.
    """
    source = next((formula_source(structure) for structure in found.structure if structure.terms), "")
    if source:
        return source
    raise InputError(
        Issue(
            "there is no effect class to print",
            f"diagnosis: {found.verdict}",
            "unexplained_structure, with a formula",
            f"do what the diagnosis says next: {next_command(found) or 'nothing'}",
        )
    )


def _prediction(found: Diagnosis) -> str:
    best = found.groups[0]
    rms, known = best.residual, best.delta_chi2_known
    drop, noise = (best.delta_chi2, "that remains") if known is None else (known, "known beforehand")
    return (
        f"Predicted for adding it: Δχ² {significant(drop)} at the noise {noise}; residual of {rms.channel} "
        f"{significant(rms.before)} → {significant(rms.after)} {pretty(rms.unit)} rms; "
        f"p {relation(best.p_global)} corrected for {found.looks:.0f} looks."
    )


def _indistinguishable(found: Diagnosis) -> list[str]:
    """Return which effects the runs do not distinguish, and the run that would."""
    group = found.groups[0]
    if len(group.effects) < 2:
        return []
    suggested = found.suggested is not None and set(group.effects) <= set(found.suggested.effects)
    together = " The posterior with all of them in the model holds each explanation." if suggested else ""
    run = f" Discriminating run: {_run_text(group)}." if group.discriminating_run is not None else ""
    return [f"Indistinguishable in these runs: {', '.join(group.effects)}.{together}{run}"]


def _run_text(group: EffectGroup) -> str:
    return run_design_text(group.discriminating_run) if group.discriminating_run is not None else ""
