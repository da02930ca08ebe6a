"""A diagnosis as it is shown: verdict, expectation and next command, evidence tables, and source of a new effect class.

The report begins with the verdict in a sentence, what to expect and the next command; then comes the evidence.  Its
tables cover effects, noise, outliers, formulas, and what cannot be detected.  For a formula that the catalogue lacks,
the source of an effect class is written.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from imubayes.adequacy.adequacy_record import NOISE_AGREES
from imubayes.criticism.diagnosis_record import Diagnosis, EffectGroup, ResidualFormula, ScreenedEffect
from imubayes.criticism.explanation_records import FormulaTerm, ParameterBias
from imubayes.display import numbers_and_labels as numbers
from imubayes.display.fit_cautions import noise_ratio
from imubayes.display.fit_quality_tables import run_design_text
from imubayes.display.layout import Cell, Report, Sheet, cells
from imubayes.display.loop import diagnosis_sentences as sentences
from imubayes.display.numbers_and_labels import command_line
from imubayes.foundations.covariates import effects_by_need
from imubayes.foundations.errors import input_error
from imubayes.foundations.quantity_names import QuantityName
from imubayes.foundations.wording import counted

_MOST_RANKED, _MOST_OUTLIERS = 10, 8
_RANKING = "Effects by the probability that they are missing"
# A bias below this share of a posterior standard deviation is not worth a word.
_SMALL_BIAS = 0.1


def ranking_sheet(found: Diagnosis) -> Sheet:
    """Return the effects by the probability that they are missing, each with the group it belongs to."""
    ranking = found.ranking if found.asked is not None else found.ranking[:_MOST_RANKED]
    group = {
        member.effect: str(place)
        for place, each in reversed(list(enumerate(found.groups, 1)))
        for member in each.candidates
    }
    rows, slim = [], []
    for line in ranking:
        likely = Cell(sentences.probability(line.probability), "bad" if line.probability >= 0.5 else "dim")
        name, drop, odds = line.effect, numbers.significant(line.delta_chi2), numbers.significant(line.log_odds)
        shown, mark = found.estimate(line.effect) or line, group.get(line.effect, "")
        rows.append(cells(name, numbers.listed(shown.channels, 3), coefficient_text(shown), drop, odds, likely, mark))
        slim.append(cells(name, coefficient_text(shown, short=True), drop, likely, mark))
    before = _more(len(found.ranking) - len(rows)) + (
        "Coefficient: the most significant one; a shape parameter, such as a time constant, has its most probable "
        "value. Δχ²: drop at the noise known beforehand if the effect alone is added, with a free coefficient in the "
        "linearised model. "
    )
    odds = "Log odds: natural logarithm of the odds of the effect alone against nothing missing. "
    after = (
        "Probability: the sum over all explanations that contain the effect. It is small beside a large Δχ² if another "
        "effect explains the same residual better. These runs cannot distinguish the effects of one group."
    )
    head = ("effect", "on", "coefficient", "Δχ²", "log odds", "probability", "group")
    narrow = Sheet(_RANKING, ("effect", "coefficient", "Δχ²", "probability", "group"), slim, (0, 1), "", before + after)
    return Sheet(_RANKING, head, rows, (0, 1, 2), "", before + odds + after, narrow=narrow)


def _more(count: int) -> str:
    return f"{count} more in diagnosis.json. " if count > 0 else ""


def coefficient_text(line: ScreenedEffect, short: bool = False) -> str:
    """Return the most significant coefficient, and the shape that was scanned."""
    known = [(each, each.value) for each in line.coefficients if each.value is not None]
    if not known:
        return "–"
    best, _ = max(known, key=lambda pair: abs(pair[1]) / (pair[0].sd or float("inf")))
    value, sd = numbers.value_and_sd(best.value, best.sd)
    text = f"{value} ± {sd} {numbers.pretty(best.unit)}"
    if short:
        return text
    shape = ", ".join(f"{key} {numbers.significant(size)}" for key, size in line.shape.items())
    text = f"{QuantityName.of(best.name).parts[1] or best.name} {text}" + (f" at {shape}" if shape else "")
    return text + (f", {len(known) - 1} more" if len(known) > 1 else "")


def undetectable_sheet(found: Diagnosis) -> Sheet:
    """Return the effects that these runs cannot show, and what absorbs them."""
    hidden = [each for each in found.undetectable if each.reason != "not_supplied"]
    absent = [each for each in found.undetectable if each.reason == "not_supplied"]
    without = effects_by_need((each.effect, each.needs) for each in absent)
    rows = []
    for each in hidden:
        absorbed = ", ".join(f"{numbers.percent(part.share)} {part.parameter}" for part in each.absorbed_by[:2])
        smallest = each.smallest_detectable
        size = f"{numbers.significant(smallest)} {numbers.pretty(each.unit)}" if smallest is not None else "–"
        rows.append(cells(each.effect, absorbed or sentences.why_undetectable(each), size, _bias(each.bias)))
    note = ""
    if rows:
        note = (
            "Undetectable is not absent: no statement is made about these effects. The last column is the bias of the "
            "most affected parameter if the effect is present at its largest typical size."
        )
    note += f" Further effects need inputs that these runs do not supply: {without}." if without else ""
    head = ("effect", "absorbed by", "smallest detectable", "would bias")
    return Sheet("Undetectable in these runs", head, rows, (0, 1, 3), "", note.strip())


def _bias(bias: ParameterBias | None) -> str:
    if bias is None or abs(bias.in_sd) < _SMALL_BIAS:
        return "–"
    size = f"{numbers.significant(abs(bias.value))} {numbers.pretty(bias.unit)}"
    return f"{bias.parameter} by {size}, {numbers.significant(abs(bias.in_sd))} sd"


def formula_sheet(found: Diagnosis) -> Sheet:
    """Return the simplest formula for what no effect explains, a line for each term."""
    rows = [
        cells(
            each.channel,
            term.shape,
            f"{' ± '.join(numbers.value_and_sd(term.value, term.sd))} {numbers.pretty(term.unit)}",
            numbers.significant(term.delta_chi2),
            numbers.significant(term.log_odds),
        )
        for each in found.formulas
        for term in each.terms
    ]
    angle = any("φ" in each.shape for each in found.formulas)
    note = "φ is counted from the zero of the table, not from that of its scale." if angle else ""
    head = ("channel", "term", "coefficient", "Δχ²", "log odds")
    return Sheet("Simplest formula of the residual that no effect explains", head, rows, (0, 1, 2), "", note)


def noise_sheet(found: Diagnosis) -> Sheet:
    """Return the noise of the most probable explanation if it is not as the model says."""
    noise = found.explanations.noise if found.explanations is not None else ()
    rows = [cells(sentences.noise_text([each]), numbers.significant(each.scale)) for each in noise]
    return Sheet("Noise that differs from the model", ("noise", "scale / known"), rows, (0,))


def recorded_noise_sheet(found: Diagnosis) -> Sheet:
    """Return fitted against recorded noise of the channels if they do not agree."""
    sources = {"samples": "samples within rows", "prior": "the prior", "channel": "'noise' of the channel"}
    rows = [
        cells(
            each.channel,
            numbers.significant(each.fitted),
            numbers.significant(each.recorded),
            sources[each.source],
            noise_ratio(each),
            Cell(numbers.chance_text(each.p), "bad" if each.excessive else ""),
        )
        for each in found.disagreeing_noise
    ]
    note = (
        "Standard deviation of one raw sample: fitted from the scatter of the rows, and as the "
        "campaign records it. A ratio above 1 is scatter from row to row that the samples do not show; p: "
        f"probability that chance gives such a ratio if the true one is at most {NOISE_AGREES:.2f}."
    )
    head = ("channel", "fitted", "recorded", "from", "ratio", "p")
    return Sheet("Fitted and recorded noise disagree", head, rows, (0, 3), "", note)


def outlier_sheet(found: Diagnosis) -> Sheet:
    """Return the outliers, the farthest first."""
    rows = [
        cells(
            each.run,
            each.channel,
            str(each.row),
            *("–" if value is None else f"{value:.6g}" for value in (each.time_s, each.table_angle_deg)),
            f"{each.distance:+.1f}",
        )
        for each in found.outliers[:_MOST_OUTLIERS]
    ]
    note = _more(len(found.outliers) - len(rows)) + ("Deletion residuals, in standard deviations of the other samples.")
    head = ("run", "channel", "row", "time / s", "table angle / °", "residual / sd")
    return Sheet("Outliers", head, rows, (0, 1), "", note)


_NAMES = ("coefficient", "second", "third")
_SOURCE = '''"""Found in the residuals: {formula}."""
{numpy}
from imubayes import Order, Scalar, SignalEffect, Stage, parameter


class FoundShape(SignalEffect):
    """Signal + {formula}."""

    name = "found_{kind}_shape"
    stage, order, kinds = Stage.SENSOR, Order.BIAS, ("{kind}",)
    needs = {needs!r}
{parameters}

    def apply(self, signal, sample):
        return signal + {total}
'''


def formula_source(found: ResidualFormula) -> str:
    """Return an effect class for a formula, to save beside the model."""
    named = list(zip(_NAMES, found.terms, strict=False))
    total = " + ".join(f"self.{name} * {term.expression}" for name, term in named)
    return _SOURCE.format(
        formula=" + ".join(f"{name}·{term.shape}" for name, term in named),
        numpy="\nimport jax.numpy as jnp\n" if "jnp." in total else "",
        kind=found.kind,
        needs=tuple(dict.fromkeys(need for term in found.terms for need in term.needs)),
        parameters="\n".join(_parameter(name, term) for name, term in named),
        total=total,
    )


def _parameter(name: str, term: FormulaTerm) -> str:
    """Return the declaration of a coefficient; its prior is three times as wide as the estimate."""
    wide = float(f"{3 * abs(term.value):.1g}") or 1.0
    low = float(f"{abs(term.value) / 10:.1g}")
    prior = f"normal(0, {wide:g} {term.unit})"
    return f'    {name}: Scalar = parameter("{term.unit}", "{prior}", ({low:g}, {wide:g}), "the coefficient")'


# Rows of the tables that the verdict rests on, so that the whole fits on a screen of 24 lines.  An effect that the
# verdict names has its row nevertheless.
_MOST_LEADING = 5


def diagnosis_report(found: Diagnosis, pictures: Sequence[Path] = (), verbose: bool = False) -> Report:
    """Return the verdict with its evidence; the answer about one effect if one was asked for.

    Parameters
    ----------
    pictures : the files that show the residual behind the first group, and the noise.
    verbose : add every table; otherwise the first rows of those that the verdict rests on, to fit on one screen.
    """
    if found.asked is not None:
        return Report([sentences.sentence(found)], [ranking_sheet(found)])
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
    members = {member.effect for group in found.groups for member in group.candidates}
    named = len(members & {line.effect for line in found.ranking[:_MOST_RANKED]})
    return [sheet.first(max(each, named) if sheet.title == _RANKING else each, note="") for sheet in sheets]


def _omitted(found: Diagnosis) -> list[str]:
    """Return what the tables that are left out hold, in one line."""
    lists = {"ranked effect": found.ranking, "outlier": found.outliers}
    each = [counted(len(lines), name) for name, lines in lists.items() if lines]
    each += [f"{len(found.undetectable)} undetectable"] * bool(found.undetectable)
    whole = command_line("diagnose", found.result, "--verbose")
    return [f"All tables ({', '.join(each)}): {whole}"] if each else []


def diagnosis_json(found: Diagnosis) -> dict[str, Any]:
    """Return a diagnosis as `imubayes diagnose --json` prints it: the record with its sentence and next command."""
    formulas = [each.model_dump(mode="json") | {"python": formula_source(each)} for each in found.formulas]
    groups = [
        group.model_dump(mode="json") | {"effects": list(group.effects), "separating_run": _run_text(group)}
        for group in found.groups
    ]
    shown = {"sentence": sentences.sentence(found), "groups": groups, "formulas": formulas, "next": next_command(found)}
    return found.model_dump(mode="json") | shown


def diagnosis_lines(found: Diagnosis) -> list[str]:
    """Return the verdict, the probability of each explanation, the prediction for what leads, and omissions last."""
    lines = [sentences.verdict_text(found)]
    if found.explanations is not None:
        lines.append(sentences.evidence_text(found.explanations))
    if found.groups:
        lines.append(_prediction(found))
        lines += _discriminating(found)
    if found.verdict == "not_converged" and found.explanations is not None:
        lines.append("All statements refer to the point at which the fit stopped, and are provisional.")
    elif found.message and found.verdict != "not_converged":
        lines.append("The sampling of this fit did not converge. All statements refer to its mode.")
    return [*lines, *filter(None, [sentences.omitted_text(found)])]


def next_lines(found: Diagnosis, pictures: Sequence[Path] = ()) -> list[str]:
    """Return the pictures and the next commands, one line each: the simplest explanation, and all that fit."""
    command, other = next_command(found), found.all_that_fit
    # The only command of the loop that takes minutes.
    if command.startswith("imubayes plant"):
        command += "  # takes minutes; tests whether these runs would have shown an effect"
    lines = [*(f"picture: {picture}" for picture in pictures), *([f"next: {command}"] if command else [])]
    if other is not None:
        whole = add_command(other.effects, other.channels, found.result, f"{found.result}-all")
        lines.append(f"or, with every effect that fits equally well: {whole}")
    return lines


def next_command(found: Diagnosis) -> str:
    """Return the command to run next; empty for an answer about one effect."""
    result, choice = found.result, found.proposed
    if found.asked is not None:
        return ""
    if choice is not None:
        return add_command(choice.effects, choice.channels, result, f"{result}-{choice.effects[0]}")
    if found.formulas:
        adding = add_command(["found_shape.py"], None, result, f"{result}-found_shape")
        return f"{command_line('diagnose', result, '--python')} > found_shape.py && {adding}"
    if found.verdict == "adequate":
        return command_line("plant", "--result", result)
    return command_line("compare", result)


def add_command(effects: Sequence[str], channels: Sequence[str] | None, result: str, out: str) -> str:
    """Return the command that adds effects to the model of a result, on channels if they are named."""
    on = ["--channels", *channels] if channels else []
    return command_line("add", *effects, "--to", result, "--out", out, *on)


def effect_source(found: Diagnosis) -> str:
    """Return the effect class written for what no effect explains.

    Raises
    ------
    InputError
        if that has no formula.
    """
    if found.formulas:
        return formula_source(found.formulas[0])
    what, allowed = "there is no effect class to print", "a cause outside the catalogue, with a formula"
    remedy = f"follow the next step of the diagnosis: {next_command(found) or 'nothing'}"
    raise input_error(what, f"diagnosis: {found.verdict}", allowed, remedy)


def _prediction(found: Diagnosis) -> str:
    best = found.groups[0]
    rms, together = best.residual, found.delta_chi2 if found.delta_chi2 is not None else best.delta_chi2
    added = numbers.listed([each.effects[0] for each in found.groups])
    told = f"Predicted with {added} added: Δχ² {numbers.significant(together)} at the noise known beforehand"
    if rms.after >= rms.before:  # one of several, whose coefficient is that beside the others
        return f"{told}."
    alone = f" (with {best.effects[0]} alone added)" if len(found.groups) > 1 else ""
    before, after = (numbers.significant(each) for each in (rms.before, rms.after))
    return f"{told}; residual of {rms.channel} {before} → {after} {numbers.pretty(rms.unit)} rms{alone}."


def _discriminating(found: Diagnosis) -> list[str]:
    """Return the run that would distinguish the effects of a group that these do not."""
    return [
        f"A run that would distinguish {numbers.listed(group.effects)}: {_run_text(group)}."
        for group in found.groups
        if group.discriminating_run is not None
    ]


def _run_text(group: EffectGroup) -> str:
    return run_design_text(group.discriminating_run) if group.discriminating_run is not None else ""
