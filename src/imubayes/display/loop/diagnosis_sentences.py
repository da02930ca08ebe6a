"""The diagnosis in words: the verdict, the evidence, and runs that disagree with the others, the most probable first.

The verdict is a few sentences.  The evidence is how probable each explanation is.  Of a run that does not agree with
the others, a sentence states what would make it agree.
"""

import math
from collections.abc import Iterable, Iterator

from imubayes.adequacy.adequacy_record import Disagreement, NoiseComparison
from imubayes.criticism import diagnosis_record as diagnosis
from imubayes.criticism.explanation_records import (
    NAMED,
    EffectSlot,
    Evidence,
    Explanation,
    FoundForm,
    FoundNoise,
    FoundStep,
    ParameterBias,
)
from imubayes.display.fit_cautions import contradiction_text, noise_ratio
from imubayes.display.numbers_and_labels import listed, percent, pretty, significant, value_and_sd
from imubayes.foundations.wording import counted
from imubayes.foundations.wrong_records import WrongRecord, agreement_text, record_remedy

_LEAST_TOLD, _MOST_NAMES, _WELL_KNOWN = 0.01, 4, 0.1
_PRIOR_DOUBT = 2.0
"""Nats by which prior odds may reasonably differ."""
_NOISE = {
    "known": "noise as stated", "scale": "white noise", "correlated": "correlated rows",
    "wander": "a random walk", "rate": "noise that grows with the input", "tails": "heavy tails",
    "counts": "white noise of one run",
    "runs": "scatter between runs",
}  # fmt: skip
_KINDS: dict[Explanation, str] = {
    "nothing": "nothing missing", "noise": "other noise", "effects": "an effect missing",
    "input": "a wrong record or prior", "outside": "a cause outside the catalogue",
}  # fmt: skip


def evidence_text(found: Evidence) -> str:
    """Return the probability of each explanation, what the most probable is, and what that rests on."""
    each = sorted(found.explanations, key=lambda one: -one.probability)
    shown = [one for one in each if one.kind == "nothing" or one.probability >= _LEAST_TOLD]
    told = []
    for one in shown:
        detail = _detail(found, one.kind)
        several = one.kind == "effects" and found.leading.kind == "effects" and len(found.slots) > 1
        kind = "effects missing" if several else _KINDS[one.kind]
        told.append(f"{kind} {probability(one.probability)}" + (f" ({detail})" if detail else ""))
    return f"Probability: {'; '.join(told)}.{_assumptions(found)}"


def likely(value: float) -> tuple[str, str]:
    """Return the adverb of a finding, and its probability in parentheses; both empty beyond reasonable doubt."""
    if value >= NAMED:
        return "", ""
    return " probably" if value >= 0.5 else " possibly", f" (probability {probability(value)})"


def probability(value: float) -> str:
    """Return a probability, never 0 or 1."""
    if value > 0.999:
        return "> 0.999"
    return "< 0.001" if value < 0.001 else f"{value:.2f}" if 0.01 <= value < 0.99 else f"{value:.3f}"


def _detail(found: Evidence, kind: Explanation) -> str:
    """Return what an explanation is in particular; empty if nothing is to be said."""
    leads = found.leading.kind == kind
    if kind == "noise":
        return noise_text(found.noise) if leads else ""
    if kind == "effects":
        return _effects(found, leads)
    if found.form is None or found.form.wrong != (kind == "input") or kind == "nothing":
        return ""
    noise = noise_text(found.noise)
    beside = " and ".join([*map(_slot, found.slots), *([noise] if noise else [])]) if leads else ""
    return form_text(found.form) + (f", beside {beside}" if beside else "")


def _effects(found: Evidence, leads: bool) -> str:
    """Return the effects of the explanation that leads; if another does, the most probable."""
    if leads and found.slots:
        noise = noise_text(found.noise)
        return "; ".join(map(_slot, found.slots)) + (f"; beside {noise}" if noise else "")
    told = [each for each in found.inclusion if each.probability >= _LEAST_TOLD][:2]
    return ", ".join(f"{each.effect} {probability(each.probability)}" for each in told)


def noise_text(noise: Iterable[FoundNoise]) -> str:
    """Return what the noise is beyond what is stated; of white noise of another size, by which factor."""
    return listed([
        f"{_NOISE[each.family]} on {listed(each.channels)}"
        + (f" {significant(each.scale, 2)} times as large as known" if each.family == "scale" else "")
        for each in noise
    ])  # fmt: skip


def _slot(slot: EffectSlot) -> str:
    """Return the effects of a group, the channels, and the shares of the effects in the group."""
    shown = slot.candidates[:_MOST_NAMES]
    names = f"{' or '.join(each.effect for each in shown)} on {listed(slot.channels)}"
    shares = ", ".join(probability(each.probability) for each in shown)
    return f"{names}, shares {shares}" if shown[1:] else names


def form_text(form: FoundForm) -> str:
    """Return a form outside the catalogue, or a wrong input, with its channels and place."""
    where = f" in run {form.run}" if form.run else ""
    row = f", row {form.row}" if form.row is not None else ""
    return f"{form.name} on {listed(form.channels)}{where}{row}"


def _step_sentence(step: FoundStep) -> str:
    """Return the sizes of a step, the time and the temperature at which it is, and the remedy."""
    sizes = [
        f"{' ± '.join(value_and_sd(each.value, each.sd))} {pretty(each.unit)} on {each.name}" for each in step.sizes
    ]
    settings = [f"{each.name} {significant(each.value, 4)} {pretty(each.unit)}" for each in step.settings]
    place = f", at {listed(settings)}" if settings else ""
    return (
        f" The step is {listed(sizes)}{place}. If the unit was disturbed there, state the rows before and after it as "
        "two runs."
    )


def _assumptions(found: Evidence) -> str:
    """Return what the probabilities assume if that matters: noise that is not known, and prior odds."""
    said = ""
    if found.noise_known > _WELL_KNOWN:
        factor = significant(math.exp(found.noise_known), 2)
        said += f" The noise is known beforehand only to within a factor of {factor}."
    odds = sorted((each.log_odds for each in found.explanations if each.log_odds is not None), reverse=True)
    if len(odds) > 1 and odds[0] - odds[1] < _PRIOR_DOUBT:
        said += (
            " The first two explanations are close: prior odds of 7 to 1 in favour of the second would reverse their "
            "order."
        )
    return said


_MOST = 3


def place_text(found: Disagreement) -> str:
    """Return a run, or a row of one, as it is named in a sentence."""
    if not found.run:
        return "a prior"
    return f"run {found.run}" if found.row is None else f"row {found.row} of run {found.run}"


def _prior_sentence(best: WrongRecord, chance: str, adverb: str) -> str:
    return (
        f"A prior{adverb} contradicts the data{chance}: the fitted {best.quantity} is "
        f"{significant(abs(best.agreeing[0]), 2)} prior standard deviations from its prior. State a wider prior for "
        "it in the model, and fit again. The next diagnosis shows whether anything else is missing."
    )


def _sentence(found: Disagreement, probability: float) -> str:
    place, (adverb, chance) = place_text(found), likely(probability)
    said = (
        f"{place[0].upper()}{place[1:]}{adverb} does not agree with "
        f"{'the other runs' if found.row is None else 'the other rows'}{chance}."
    )
    best, *others = found.causes
    if best.form == "prior":
        return _prior_sentence(best, chance, adverb)
    said += f" It would agree given {agreement_text(best)}."
    if others:
        said += f" It would agree as well given {'; or '.join(agreement_text(each) for each in others[:_MOST])}."
    if found.instead:
        said += f" Alternatively the record of {listed(list(found.instead), _MOST)} is wrong."
    do = record_remedy(best)
    return f"{said} {do[0].upper()}{do[1:]}; then fit again."


_MOST_NAMED = 3


def sentence(found: diagnosis.Diagnosis) -> str:
    """Return the verdict in a few sentences, and the uncertainties that no interval includes."""
    return " ".join(filter(None, (verdict_text(found), omitted_text(found))))


def verdict_text(found: diagnosis.Diagnosis) -> str:
    """Return the verdict in a few sentences; first the noise that contradicts what is known, if noise leads."""
    if found.asked is not None:
        return _asked_sentence(found)
    told = [found.message] if found.verdict == "not_converged" else []
    # What explains the data at the noise that is known shows what a noise scale stands in for.
    if found.contradicted and found.explains_by_noise:
        told.append(f"{contradiction_text(found.contradicted)}.")
    return " ".join(filter(None, (*told, _finding(found), *_beside_the_finding(found))))


def _beside_the_finding(found: diagnosis.Diagnosis) -> Iterator[str]:
    """Yield by how much the fitted noise differs from the recorded one, and outliers."""
    told = {each.parameter for each in found.contradicted} if found.explains_by_noise else ()
    apart = [each for each in found.disagreeing_noise if each.parameter not in told]
    if apart:
        worst, rest = max(apart, key=lambda each: abs(math.log(each.ratio))), len(apart) - 1
        yield f"The fitted noise of {worst.channel} is {noise_ratio(worst)} times the known noise ({_both(worst)})."
        if rest:
            yield f"The fitted noise of {counted(rest, 'other channel')} also differs from the known noise."
        if worst.source == "samples" and all(each.ratio < 1 for each in apart):
            yield (
                "Rows that scatter less than their samples hide no effect: within a row something averages out, such "
                "as a vibration. The uncertainties follow from the scatter of the rows."
            )
    disagreeing = {(each.run, each.row) for each in found.disagreeing}
    outliers = [each for each in found.outliers if (each.run, each.row) not in disagreeing]
    if outliers:
        worst, many = outliers[0], f"{len(outliers)} outliers, the largest" if outliers[1:] else "One outlier:"
        where = f"{worst.channel} in row {worst.row} of run {worst.run}"
        yield f"{many} {where}, {abs(worst.distance):.0f} standard deviations."


def _finding(found: diagnosis.Diagnosis) -> str:
    """Return the most probable explanation."""
    evidence = found.explanations
    if evidence is None:
        return ""
    kind, (adverb, chance) = evidence.leading.kind, likely(evidence.leading.probability)
    if kind == "nothing":
        return _adequate_sentence(found)
    if found.disagreeing:
        beside = _missing_sentence(found) if found.groups and kind == "input" else ""
        said = " ".join(_sentence(each, evidence.leading.probability) for each in found.disagreeing)
        return f"{said} With the record corrected: {beside}" if beside else said
    if kind == "noise":
        rest = "With the noise corrected, no effect is missing." if found.suggested else "No effect explains it."
        return f"The noise is{adverb} not as modelled{chance}: {noise_text(evidence.noise)}. {rest}"
    beside = _missing_sentence(found) if found.groups else ""
    if kind == "effects":
        noise = noise_text(evidence.noise)
        return beside + (f" The noise is not as modelled either: {noise}." if noise else "")
    assert evidence.form is not None
    said = (
        f"A cause outside the catalogue{adverb} acts{chance}: {form_text(evidence.form)}. No effect of the catalogue "
        "explains it."
    )
    if evidence.form.step is not None:
        said += _step_sentence(evidence.form.step)
    return said + _beside_form(found)


def _beside_form(found: diagnosis.Diagnosis) -> str:
    """Return the effects beside a form outside the catalogue, which is crude: what it leaves looks like effects."""
    if not found.groups:
        return ""
    each = [f"{' or '.join(group.effects[:2])} on {listed(group.channels)}" for group in found.groups]
    return f" The remaining residual resembles {' and '.join(each)}, missing as well or a part of the same cause."


def _adequate_sentence(found: diagnosis.Diagnosis) -> str:
    assert found.explanations is not None
    nothing = found.explanations.leading.probability
    if found.verdict == "not_converged":
        said = f"At the point at which the fit stopped, nothing is missing with probability {probability(nothing)}."
    elif nothing >= NAMED:
        said = "The model explains the data: no effect of the catalogue is missing as far as these runs can show."
    else:
        adverb, chance = likely(nothing)
        said = f"The model{adverb} explains the data{chance}: the most probable explanation is that nothing is missing."
    return said + _undetectable_sentence(found)


def _missing_sentence(found: diagnosis.Diagnosis) -> str:
    """Return the effects that are missing, the strongest first, with what the runs cannot distinguish."""
    first, *others = found.groups
    said = _group_sentence(first) + "".join(f" {_missing(each, 'also ')}{_in_its_place(each)}" for each in others)
    return said + _size_sentence(first)


def _missing(group: diagnosis.EffectGroup, also: str = "") -> str:
    """Return that the first effect of a group is missing, and where."""
    adverb, chance = likely(group.probability)
    if chance and group.effects[1:]:
        chance = f" (probability {probability(group.probability)} for its group)"
    return f"{group.effects[0]} is{adverb} {also}missing on {listed(group.channels)}{chance}."


def _in_its_place(group: diagnosis.EffectGroup) -> str:
    """Return which effects would fit as well as the first of a group; empty if none would."""
    others = group.effects[1:]
    if not others:
        return ""
    rest = len(others) - _MOST_NAMED
    names = [*others[:_MOST_NAMED], *([f"{rest} more"] if rest > 0 else [])]
    named = " or ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)
    return f" {named} would fit as well in place of {group.effects[0]}: these runs cannot distinguish them."


def _group_sentence(group: diagnosis.EffectGroup) -> str:
    said = _missing(group)
    if group.covariate is not None:
        said += f" The residual of {group.residual.channel} depends on {group.covariate.phrase}."
    return said + _in_its_place(group)


def _size_sentence(group: diagnosis.EffectGroup) -> str:
    """Return that the first effect is of unusual size; empty if it is not."""
    if not group.beyond_typical:
        return ""
    worst = max(group.beyond_typical, key=lambda each: abs(each.value) / each.largest)
    return (
        f" {worst.name} would be {significant(worst.value)} {pretty(worst.unit)}, beyond the typical range (up to "
        f"{significant(worst.largest)}): several effects together may imitate it."
    )


def _both(each: NoiseComparison) -> str:
    """Return fitted and recorded noise of one sample."""
    unit = f" {pretty(each.unit)}" if each.unit else ""
    return f"{significant(each.fitted)} against {significant(each.recorded)}{unit} per sample"


def omitted_text(found: diagnosis.Diagnosis) -> str:
    """Return which stated uncertainties no interval includes, the worst with its shift; empty without one."""
    if not found.neglected or found.asked is not None:
        return ""
    worst = found.neglected[0]
    effects = listed([each.effect for each in found.neglected])
    return (
        f"No interval includes {effects}, which the model takes as exact: the stated uncertainty of {worst.parameter}, "
        f"{significant(worst.value)} {pretty(worst.unit)}, shifts {worst.shifts} by {significant(worst.in_sd)} times "
        "its sd."
    )


def _undetectable_sentence(found: diagnosis.Diagnosis) -> str:
    """Return how many effects these runs cannot show, and what that may mean for the estimates; empty if none."""
    hidden = len(found.undetectable)
    if not hidden:
        return ""
    effects, them = ("effect of the catalogue is", "it") if hidden == 1 else ("effects of the catalogue are", "them")
    said = f" {hidden} {effects} undetectable in these runs."
    worst = found.most_biasing
    return said if worst is None else f"{said} No interval includes {them}. Worst case: {bias_clause(worst)}."


def bias_clause(bias: ParameterBias) -> str:
    """Return what an effect that the runs cannot show would do to the parameter that it biases most."""
    size = f"{significant(bias.size)} {pretty(bias.size_unit)}"
    return (
        f"{bias.coefficient} at its largest typical size, {size}, would bias {bias.parameter} by "
        f"{significant(abs(bias.in_sd))} standard deviations"
    )


def _asked_sentence(found: diagnosis.Diagnosis) -> str:
    asked = found.asked
    assert asked is not None
    missing = found.probability(asked.effect)
    if found.verdict == "not_converged":
        chance = probability(missing)
        return (
            f"{found.message} At the point at which the fit stopped, {asked.effect} is missing with probability "
            f"{chance}."
        )
    if found.verdict == "missing_effect":
        adverb, _ = likely(missing)
        return (
            f"{asked.effect}, or an effect that resembles it, is{adverb} missing (probability {probability(missing)})."
        )
    if found.verdict == "adequate":
        size = f"{significant(asked.smallest_detectable)} {pretty(asked.unit)}"
        if missing > 1 - NAMED:
            chance = f"probability {probability(missing)}"
            return f"{asked.effect} may be missing ({chance}); {size} would be detected with a probability of 80 %."
        return (
            f"{asked.effect} is absent down to {size}, the size that is detected with a probability of 80 %. The "
            f"probability that it is missing is {probability(missing)}."
        )
    hidden = found.undetectable[0]
    absorbed = ", ".join(f"{percent(each.share)} in {each.parameter}" for each in hidden.absorbed_by[:3])
    why = f"absorbed by the model, {absorbed}" if absorbed else why_undetectable(hidden)
    return f"These runs cannot show {asked.effect}: {why}."


def why_undetectable(hidden: diagnosis.UndetectableEffect) -> str:
    """Return why an effect that no parameter absorbs is undetectable."""
    if hidden.reason == "not_supplied":
        return (
            f"the runs do not all supply {', '.join(hidden.needs)}" if hidden.needs else "their response to it is zero"
        )
    return {"absorbed": "the model absorbs it", "noise": "its largest typical size is below the noise"}[hidden.reason]
