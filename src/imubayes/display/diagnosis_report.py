"""A diagnosis in words and tables: the verdict in a sentence, what to expect, the next command; then the evidence."""

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from imubayes.criticism import thresholds
from imubayes.criticism.detectability import ParameterBias
from imubayes.criticism.diagnosis_record import Diagnosis, EffectGroup, RankedEffect, UndetectableEffect
from imubayes.criticism.noise_against_prior import NoiseBeyondPrior
from imubayes.criticism.recorded_noise import NoiseComparison
from imubayes.criticism.verdict import MISSING
from imubayes.display.labels import listed, pretty
from imubayes.display.report_layout import Report
from imubayes.display.rounding import percent, significant, value_and_sd
from imubayes.display.run_design_words import run_design_text
from imubayes.display.structure_words import formula_source, step_text, structure_shape
from imubayes.display.table_layout import Cell, Sheet
from imubayes.errors import InputError, Issue

_MOST_NAMED, _MOST_RANKED, _MOST_STRUCTURES, _MOST_OUTLIERS = 3, 10, 6, 8
# Rows of the tables that the verdict rests on, so that the whole fits on a screen of 24 lines.
_MOST_LEADING = 5
# A bias below this share of a posterior standard deviation is not worth a word.
_SMALL_BIAS = 0.1


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
    if found.groups:
        lines.append(_prediction(found))
        lines += _discriminating_run(found.groups[0])
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
    command += "  # minutes: would these runs have shown an effect?" if found.verdict == "adequate" and command else ""
    return [*(f"picture: {picture}" for picture in pictures), *([f"next: {command}"] if command else [])]


def sentence(found: Diagnosis) -> str:
    """Return the verdict in a few sentences, the finding of the strongest evidence first."""
    if found.asked is not None:
        return _asked_sentence(found)
    if found.verdict == "not_converged":
        return found.message
    noise = ""
    if found.groups:
        said = _missing_sentence(found.groups[0], found.wandering == "rival") + _more_sentence(found)
        noise = _adopted_sentence(found)
    elif found.verdict == "unexplained_structure":
        said = _structure_sentence(found)
        noise = _adopted_sentence(found)
    elif found.verdict == "noise_model":
        said = _noise_sentence(found)
    else:
        said = "The model explains the data: no effect of the catalogue is missing as far as these runs can show."
        hidden = len(found.undetectable)
        said += f" {hidden} effects of the catalogue are undetectable in these runs." if hidden else ""
    parts = [noise, said] if found.noise_outweighs else [said, noise]
    return " ".join(part for part in parts if part) + _record_sentence(found) + _outlier_sentence(found)


def _adopted_sentence(found: Diagnosis) -> str:
    """Return which noise the model lacks beside an effect or structure; empty where none."""
    adopted = [noise for noise in found.noise if noise.adopted]
    each = [f"{noise.effect} on {listed(noise.channels)} (Δχ² {significant(noise.delta_chi2)})" for noise in adopted]
    return f"The noise model lacks {' and '.join(each)}." if each else ""


def _missing_sentence(group: EffectGroup, noise_rivals: bool) -> str:
    first, *others = group.effects
    said = f"{first} is missing on {', '.join(group.channels)}"
    if noise_rivals:
        said = f"Either {said}, or the noise wanders as flicker noise or a random walk does: these records cannot tell"
    said += "."
    if group.covariate is not None:
        said += f" The residual of {group.residual.channel} depends on {group.covariate.phrase}."
    if others:
        rest = len(others) - _MOST_NAMED
        names = [*others[:_MOST_NAMED], *([f"{rest} more"] if rest > 0 else [])]
        said += f" {' and '.join(names)} would fit as well: these runs cannot distinguish them."
    if group.unlisted:
        phrase = " and ".join(label.phrase for label in group.unlisted[0])
        said += f" An unlisted cause that depends on {phrase} would fit as well."
    return said + _stage_sentence(group) + _size_sentence(group)


def _size_sentence(group: EffectGroup) -> str:
    """Return that the first effect is of unusual size; empty where it is not."""
    if not group.beyond_typical:
        return ""
    worst = max(group.beyond_typical, key=lambda each: abs(each.value) / each.largest)
    return (
        f" {worst.name} would be {significant(worst.value)} {pretty(worst.unit)}, beyond the typical range (up to "
        f"{significant(worst.largest)}): two smaller effects at once may imitate it."
    )


def _stage_sentence(group: EffectGroup) -> str:
    """Return that the stage of the signal chain is not determined; empty where it is."""
    if group.stage is None or group.stage.determined:
        return ""
    devices = f"the {group.stage.sensor} or in its converter"
    return f" Whether it acts in {devices} is not determined: drive the converter alone."


def _more_sentence(found: Diagnosis) -> str:
    if found.scatter_remains:
        return " Rows scatter beyond the recorded noise all the same: it may only resemble the cause."
    if not found.more_remains:
        return ""
    return " More remains beside it, small against what it explains: add it and diagnose again."


def _structure_sentence(found: Diagnosis) -> str:
    strongest = found.strongest
    assert strongest is not None
    if strongest.step:
        where = step_text(strongest.step)
        return f"The residual of {strongest.channel} has a {where}: no effect of the catalogue happens once."
    phrases = " and ".join(covariate.phrase for covariate in strongest.covariates)
    said = (
        f"The residual of {strongest.channel} depends on {phrases} in a way that no effect of the catalogue explains."
    )
    parts = [f"{group.effects[0]} on {', '.join(group.channels)}" for group in found.nearest]
    return f"{said} Explained in part by {'; '.join(parts)}." if parts else said


def _noise_sentence(found: Diagnosis) -> str:
    adopted = [f"{noise.effect} on {', '.join(noise.channels)}" for noise in found.noise if noise.adopted]
    if not adopted and found.wandering:
        return (
            "The noise wanders as flicker noise or a random walk does, and not as the model says; with it, no effect "
            "is missing. Write flicker_noise and random_walk_noise into the model in place of correlated_noise."
        )
    if not adopted and found.beyond_prior:
        return _beyond_prior_sentence(found.beyond_prior)
    if not adopted:
        return (
            "The model does not explain the scatter from row to row: no single effect and no noise of the catalogue is "
            "significant, but something acts there that the model lacks."
        )
    return f"The noise model is inadequate: {' and '.join(adopted)}. With it corrected, no effect is missing."


def _beyond_prior_sentence(beyond: Sequence[NoiseBeyondPrior]) -> str:
    """Return which noise is larger than its prior allows, and what that may mean."""
    worst, rest = beyond[0], len(beyond) - 1
    said = (
        f"{worst.parameter} is {significant(worst.value)} {pretty(worst.unit)}, far beyond its prior (above "
        f"{significant(worst.expected)} with 2.5 % probability; p {_relation(worst.p)})"
    )
    said += f", and so {'is one more parameter' if rest == 1 else f'are {rest} more parameters'}." if rest else "."
    where = "between runs" if worst.between_runs else "from row to row"
    return f"{said} Either something acts {where} that the model lacks, or the prior is too narrow for this unit."


def _record_sentence(found: Diagnosis) -> str:
    """Return by how much the fitted noise differs from the recorded one; empty where they agree."""
    apart = found.disagreeing_noise
    if not apart:
        return ""
    worst = max(apart, key=lambda each: abs(math.log(each.ratio)))
    rest = len(apart) - 1
    more = f" {rest} more {'channel disagrees' if rest == 1 else 'channels disagree'}." if rest else ""
    return f" The fitted noise of {worst.channel} is {_ratio(worst)} times the recorded noise ({_both(worst)}).{more}"


def _ratio(each: NoiseComparison) -> str:
    value, sd = value_and_sd(each.ratio, each.ratio_sd)
    return f"{value} ± {sd}"


def _both(each: NoiseComparison) -> str:
    """Return fitted and recorded noise of one sample."""
    unit = f" {pretty(each.unit)}" if each.unit else ""
    return f"{significant(each.fitted)} against {significant(each.recorded)}{unit} per sample"


def _outlier_sentence(found: Diagnosis) -> str:
    if not found.outliers:
        return ""
    worst, count = found.outliers[0], len(found.outliers)
    where = f"{worst.channel} in row {worst.row} of run {worst.run}, {abs(worst.distance):.0f} standard deviations"
    return f" {count} outliers, the largest {where}." if count > 1 else f" One outlier: {where}."


def _asked_sentence(found: Diagnosis) -> str:
    asked = found.asked
    assert asked is not None
    if found.verdict == "missing_effect":
        return f"{asked.effect} is missing, or an effect that resembles it: p = {found.p_global:.2g}."
    if found.verdict == "adequate":
        size = f"{significant(asked.smallest_detectable)} {pretty(asked.unit)}"
        return f"{asked.effect} is absent down to {size}, the size that is detected with 80 % power."
    hidden = found.undetectable[0]
    absorbed = ", ".join(f"{percent(each.share)} in {each.parameter}" for each in hidden.absorbed_by[:3])
    why = f"absorbed by the model, {absorbed}" if absorbed else _reason(hidden)
    return f"These runs cannot show {asked.effect}: {why}."


def _reason(hidden: UndetectableEffect) -> str:
    if hidden.reason == "not_supplied":
        return f"no run supplies {', '.join(hidden.needs)}" if hidden.needs else "their response to it is zero"
    return {"absorbed": "the model absorbs it", "noise": "its largest typical size is below the noise"}[hidden.reason]


def next_command(found: Diagnosis) -> str:
    """Return the command to run next; empty for an answer about one effect."""
    result, choice = found.result, found.suggested
    if found.asked is not None:
        return ""
    if choice is not None:
        channels = f" --channels {' '.join(choice.channels)}" if choice.channels else ""
        return f"imubayes add {choice.effect} --to {result} --out {result}-{choice.effect}{channels}"
    if found.verdict == "unexplained_structure":
        printable = any(structure.terms for structure in found.structure)
        adding = f"imubayes add found_shape.py --to {result} --out {result}-found_shape"
        written = f"imubayes diagnose {result} --python > found_shape.py && {adding}"
        return written if printable else f"imubayes compare {result}"
    if found.verdict in ("noise_model", "not_converged") or found.wandering:
        return f"imubayes compare {result}"
    return f"imubayes plant --result {result}"


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
    rms, at_fit = best.residual, best.delta_chi2_at_fit
    return (
        f"Predicted for adding it: Δχ² {significant(best.delta_chi2)} at the noise that remains"
        f"{'' if at_fit is None else f', {significant(at_fit)} at the noise as fitted'}; "
        f"residual of {rms.channel} {significant(rms.before)} → {significant(rms.after)} {pretty(rms.unit)} rms; "
        f"p {_relation(best.p_global)} corrected for {found.looks:.0f} looks."
    )


def _relation(p: float) -> str:
    text = chance_text(p)
    return text if text.startswith("<") else f"= {text}"


def _discriminating_run(group: EffectGroup) -> list[str]:
    if len(group.effects) < 2:
        return []
    run = f" Discriminating run: {_run_text(group)}." if group.discriminating_run is not None else ""
    return [f"Indistinguishable in these runs: {', '.join(group.effects)}.{run}"]


def _run_text(group: EffectGroup) -> str:
    return run_design_text(group.discriminating_run) if group.discriminating_run is not None else ""


def chance_text(p: float | None) -> str:
    """Return a p-value: two digits, and a power of ten where it is small."""
    if p is None:
        return "–"
    return f"{p:.2g}" if p >= 1e-3 else ("< 1e-30" if p < 1e-30 else f"{p:.0e}".replace("e-0", "e-"))


def ranking_sheet(found: Diagnosis) -> Sheet:
    """Return the candidates in order of evidence, each with its equivalence group.

    One line per effect, on the channels with the strongest evidence; all lines of an effect that was asked about.
    """
    ranking: Sequence[RankedEffect] = found.ranking
    if found.asked is None:
        best: dict[str, RankedEffect] = {}
        for line in found.ranking:
            best.setdefault(line.effect, line)
        ranking = list(best.values())[:_MOST_RANKED]
    group = {
        (member.effect, member.channels): str(place)
        for place, each in reversed(list(enumerate(found.groups, 1)))
        for member in each.candidates
    }
    rows, slim = [], []
    for line in ranking:
        name, drop = Cell(line.effect), Cell(significant(line.delta_chi2))
        p = Cell(chance_text(line.p_global), "bad" if line.p_global < found.threshold else "dim")
        mark = Cell(group.get((line.effect, line.channels), ""))
        on, size = Cell(listed(line.channels, 3)), Cell(_coefficient(line))
        rows.append((name, on, size, drop, Cell(str(line.dof)), p, mark))
        slim.append((name, Cell(_coefficient(line, short=True)), drop, p, mark))
    note = _more(len(found.ranking) - len(rows)) + (
        "Δχ²: predicted drop of χ² if the effect were added, at the noise that remains; p: probability that the best "
        "of all candidates does so well where nothing is missing. These runs cannot distinguish the candidates of one "
        "group."
    )
    head = ("effect", "on", "coefficient", "Δχ²", "dof", "p", "group")
    title = "Candidates in order of evidence"
    narrow = Sheet(title, ("effect", "coefficient", "Δχ²", "p", "group"), slim, (0, 1), "", note)
    return Sheet(title, head, rows, (0, 1, 2), "", note, narrow=narrow)


def _more(count: int) -> str:
    return f"{count} more in diagnosis.json. " if count > 0 else ""


def _coefficient(line: RankedEffect, short: bool = False) -> str:
    """Return the most significant coefficient, and the shape that was scanned."""
    known = [(each, each.value) for each in line.coefficients if each.value is not None]
    if not known:
        return "–"
    best, _ = max(known, key=lambda pair: abs(pair[1]) / (pair[0].sd or float("inf")))
    value, sd = value_and_sd(best.value, best.sd)
    text = f"{value} ± {sd} {pretty(best.unit)}"
    if short:
        return text
    shape = ", ".join(f"{key.rpartition('.')[2]} {significant(size)}" for key, size in line.shape.items())
    text = f"{best.name.partition('.')[2] or best.name} {text}" + (f" at {shape}" if shape else "")
    return text + (f", {len(known) - 1} more" if len(known) > 1 else "")


def undetectable_sheet(found: Diagnosis) -> Sheet:
    """Return the effects that these runs cannot show, and what absorbs them."""
    hidden = [each for each in found.undetectable if each.reason != "not_supplied"]
    absent = [each for each in found.undetectable if each.reason == "not_supplied"]
    without = [f"{each.effect} ({', '.join(each.needs) or 'response zero'})" for each in absent]
    rows = []
    for each in hidden:
        absorbed = ", ".join(f"{percent(part.share)} {part.parameter}" for part in each.absorbed_by[:2])
        smallest = each.smallest_detectable
        size = f"{significant(smallest)} {pretty(each.unit)}" if smallest is not None else "–"
        rows.append((Cell(each.effect), Cell(absorbed or _reason(each)), Cell(size), Cell(_bias(each.bias))))
    note = ""
    if rows:
        note = (
            "Undetectable is not absent: no statement is made about these effects. The last column is the bias of the "
            "most affected parameter where an effect is present at its largest typical size."
        )
    note += f" No run supplies what these need: {', '.join(without)}." if without else ""
    head = ("effect", "absorbed by", "smallest detectable", "would bias")
    return Sheet("Undetectable in these runs", head, rows, (0, 1, 3), "", note.strip())


def _bias(bias: ParameterBias | None) -> str:
    if bias is None or abs(bias.in_sd) < _SMALL_BIAS:
        return "–"
    size = f"{significant(abs(bias.value))} {pretty(bias.unit)}"
    return f"{bias.parameter} by {size}, {significant(abs(bias.in_sd))} sd"


def structure_sheet(found: Diagnosis) -> Sheet:
    """Return the significant structure of the residuals, whatever its cause."""
    rows = []
    for each in found.structure[:_MOST_STRUCTURES]:
        size = each.coefficient
        height = f"{significant(size.value)} {pretty(size.unit)}" if size is not None else ""
        form = Cell(" ".join(part for part in (structure_shape(each), height) if part))
        rows.append((Cell(each.channel), Cell(each.covariate), Cell(each.test), Cell(chance_text(each.p), "bad"), form))
    head = ("channel", "depends on", "test", "p", "form")
    angle = any("φ" in structure_shape(each) for each in found.structure[:_MOST_STRUCTURES])
    counted = " φ is counted from the zero of the table, not from that of its scale." if angle else ""
    note = f"{_more(len(found.structure) - len(rows))}{counted}".strip()
    return Sheet("Structure in the residuals, whatever its cause", head, rows, (0, 1, 2, 4), "", note)


def noise_sheet(found: Diagnosis) -> Sheet:
    """Return the noise that the model lacks."""
    rows = [
        (Cell(noise.effect), Cell(listed(noise.channels, 4)), Cell(significant(noise.delta_chi2)), Cell(p))
        for noise, p in ((noise, chance_text(noise.p)) for noise in found.noise if noise.adopted)
    ]
    return Sheet("Noise that the model lacks", ("noise", "on", "Δχ²", "p"), rows, (0, 1))


def recorded_noise_sheet(found: Diagnosis) -> Sheet:
    """Return fitted against recorded noise of the channels where they do not agree."""
    sources = {"samples": "samples within rows", "channel": "'noise' of the channel"}
    rows = [
        (
            Cell(each.channel),
            Cell(significant(each.fitted)),
            Cell(significant(each.recorded)),
            Cell(sources[each.source]),
            Cell(_ratio(each)),
            Cell(chance_text(each.p), "bad" if each.excessive else ""),
        )
        for each in found.disagreeing_noise
    ]
    note = (
        "Standard deviation of one raw sample: fitted from the scatter of the rows, after the groups above, and as the "
        "campaign records it. A ratio above 1 is scatter from row to row that the samples do not show; p: its excess "
        f"over {thresholds.NOISE_AGREES:.2f} by chance."
    )
    head = ("channel", "fitted", "recorded", "from", "ratio", "p")
    return Sheet("Fitted and recorded noise disagree", head, rows, (0, 3), "", note)


def outlier_sheet(found: Diagnosis) -> Sheet:
    """Return the outliers, the farthest first."""
    rows = [
        (
            *(Cell(each.run), Cell(each.channel), Cell(str(each.row))),
            *(Cell("–" if value is None else f"{value:.6g}") for value in (each.time_s, each.table_angle_deg)),
            Cell(f"{each.distance:+.1f}"),
        )
        for each in found.outliers[:_MOST_OUTLIERS]
    ]
    note = _more(len(found.outliers) - len(rows)) + (
        "Deletion residuals, in standard deviations of the other samples. The search excludes outliers."
    )
    head = ("run", "channel", "row", "time / s", "table angle / °", "residual / sd")
    return Sheet("Outliers", head, rows, (0, 1), "", note)
