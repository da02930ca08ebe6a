"""The verdict of a diagnosis in words: a few sentences, the likeliest explanation first."""

import math

from imubayes.adequacy.adequacy_record import NoiseComparison
from imubayes.criticism.detectability import ParameterBias
from imubayes.criticism.diagnosis_record import Diagnosis, EffectGroup, UndetectableEffect
from imubayes.criticism.evidence.evidence_record import NAMED
from imubayes.display.disagreement_text import disagreement_text
from imubayes.display.evidence_text import form_text, likely, noise_text, probability
from imubayes.display.labels import listed, pretty
from imubayes.display.noise_violation_text import contradiction_text, noise_ratio
from imubayes.display.rounding import percent, significant

_MOST_NAMED = 3


def sentence(found: Diagnosis) -> str:
    """Return the verdict in a few sentences; first the noise that contradicts what is known, where noise leads."""
    if found.asked is not None:
        return _asked_sentence(found)
    told = [found.message] if found.verdict == "not_converged" else []
    # What explains the data at the noise that is known tells what a noise scale stands in for.
    if found.contradicted and found.explains_by_noise:
        told.append(f"{contradiction_text(found.contradicted)}.")
    told.append(_finding(found))
    return (
        " ".join(part for part in told if part)
        + _record_sentence(found)
        + _outlier_sentence(found)
        + _neglected_sentence(found)
    )


def _finding(found: Diagnosis) -> str:
    """Return the likeliest explanation."""
    evidence = found.explanations
    if evidence is None:
        return ""
    kind, (adverb, chance) = evidence.leading.kind, likely(evidence.leading.probability)
    if kind == "nothing":
        return _adequate_sentence(found)
    if kind == "noise":
        rest = "With the noise corrected, no effect is missing." if found.suggested else "No effect explains it."
        return f"The noise is{adverb} not as modelled{chance}: {noise_text(evidence.noise)}. {rest}"
    beside = _missing_sentence(found) if found.groups else ""
    if kind == "effects":
        noise = noise_text(evidence.noise)
        return beside + (f" The noise is not as modelled either: {noise}." if noise else "")
    if kind == "input":
        said = disagreement_text(found.disagreeing, evidence.leading.probability)
        return f"{said} With the record corrected: {beside}" if beside else said
    assert evidence.form is not None
    said = (
        f"A cause outside the catalogue{adverb} acts{chance}: {form_text(evidence.form)}. No effect of the catalogue "
        "explains it."
    )
    return said + _beside_form(found)


def _beside_form(found: Diagnosis) -> str:
    """Return the effects beside a form outside the catalogue, which is crude: what it leaves looks like effects."""
    if not found.groups:
        return ""
    each = [f"{' or '.join(group.effects[:2])} on {listed(group.channels)}" for group in found.groups]
    return f" Beside it {' and '.join(each)} fit what it leaves: missing as well, or a part of that cause."


def _adequate_sentence(found: Diagnosis) -> str:
    assert found.explanations is not None
    nothing = found.explanations.leading.probability
    if found.verdict == "not_converged":
        said = f"At the point where it stopped nothing is missing, with probability {probability(nothing)}."
    elif nothing >= NAMED:
        said = "The model explains the data: no effect of the catalogue is missing as far as these runs can show."
    else:
        adverb, chance = likely(nothing)
        said = f"The model{adverb} explains the data{chance}: that nothing is missing is the likeliest explanation."
    return said + _undetectable_sentence(found)


def _missing_sentence(found: Diagnosis) -> str:
    """Return the effects that are missing, the strongest first, with what the runs cannot distinguish."""
    first, *others = found.groups
    said = _group_sentence(first) + "".join(f" {_missing(each, 'also ')}{_in_its_place(each)}" for each in others)
    return said + _size_sentence(first)


def _missing(group: EffectGroup, also: str = "") -> str:
    """Return that the first effect of a group is missing, and where."""
    adverb, chance = likely(group.probability)
    return f"{group.effects[0]} is{adverb} {also}missing on {listed(group.channels)}{chance}."


def _in_its_place(group: EffectGroup) -> str:
    """Return which effects would fit as well as the first of a group; empty where none would."""
    others = group.effects[1:]
    if not others:
        return ""
    rest = len(others) - _MOST_NAMED
    names = [*others[:_MOST_NAMED], *([f"{rest} more"] if rest > 0 else [])]
    named = " or ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)
    return f" {named} would fit as well in place of {group.effects[0]}: these runs cannot distinguish them."


def _group_sentence(group: EffectGroup) -> str:
    said = _missing(group)
    if group.covariate is not None:
        said += f" The residual of {group.residual.channel} depends on {group.covariate.phrase}."
    return said + _in_its_place(group)


def _size_sentence(group: EffectGroup) -> str:
    """Return that the first effect is of unusual size; empty where it is not."""
    if not group.beyond_typical:
        return ""
    worst = max(group.beyond_typical, key=lambda each: abs(each.value) / each.largest)
    return (
        f" {worst.name} would be {significant(worst.value)} {pretty(worst.unit)}, beyond the typical range (up to "
        f"{significant(worst.largest)}): several effects at once may imitate it."
    )


def _record_sentence(found: Diagnosis) -> str:
    """Return by how much the fitted noise differs from the recorded one; empty where they agree."""
    told = {each.parameter for each in found.contradicted} if found.explains_by_noise else ()
    apart = [each for each in found.disagreeing_noise if each.parameter not in told]
    if not apart:
        return ""
    worst = max(apart, key=lambda each: abs(math.log(each.ratio)))
    rest = len(apart) - 1
    more = f" {rest} more {'channel disagrees' if rest == 1 else 'channels disagree'}." if rest else ""
    return f" The fitted noise of {worst.channel} is {noise_ratio(worst)} times the known noise ({_both(worst)}).{more}"


def _both(each: NoiseComparison) -> str:
    """Return fitted and recorded noise of one sample."""
    unit = f" {pretty(each.unit)}" if each.unit else ""
    return f"{significant(each.fitted)} against {significant(each.recorded)}{unit} per sample"


def _neglected_sentence(found: Diagnosis) -> str:
    """Return which stated uncertainties no interval includes, the worst with what it would shift."""
    if not found.neglected:
        return ""
    worst = found.neglected[0]
    effects = listed([each.effect for each in found.neglected])
    return (
        f" No interval includes {effects}, which the model takes as exact: the uncertainty that the campaign states of "
        f"{worst.parameter}, {significant(worst.value)} {pretty(worst.unit)}, shifts {worst.shifts} by "
        f"{significant(worst.in_sd)} times its sd."
    )


def _undetectable_sentence(found: Diagnosis) -> str:
    """Return how many effects these runs cannot show, and what that may mean for the estimates; empty where none."""
    hidden = len(found.undetectable)
    if not hidden:
        return ""
    effects, them = ("effect of the catalogue is", "it") if hidden == 1 else ("effects of the catalogue are", "them")
    said = f" {hidden} {effects} undetectable in these runs."
    worst = found.most_biasing
    return said if worst is None else f"{said} No interval includes {them}: {bias_clause(worst)}."


def bias_clause(bias: ParameterBias) -> str:
    """Return what an effect that the runs cannot show would do to the parameter that it biases most."""
    size = f"{significant(bias.size)} {pretty(bias.size_unit)}"
    return (
        f"{bias.coefficient} of {size}, the largest typical size, would bias {bias.parameter} by "
        f"{significant(abs(bias.in_sd))} times its sd"
    )


def _outlier_sentence(found: Diagnosis) -> str:
    told = {(each.run, each.row) for each in found.disagreeing}
    outliers = [each for each in found.outliers if (each.run, each.row) not in told]
    if not outliers:
        return ""
    worst, count = outliers[0], len(outliers)
    where = f"{worst.channel} in row {worst.row} of run {worst.run}, {abs(worst.distance):.0f} standard deviations"
    return f" {count} outliers, the largest {where}." if count > 1 else f" One outlier: {where}."


def _asked_sentence(found: Diagnosis) -> str:
    asked = found.asked
    assert asked is not None
    missing = found.probability(asked.effect)
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
            f"{asked.effect} is absent down to {size}, the size that is detected with a probability of 80 %; that it "
            f"is missing has probability {probability(missing)}."
        )
    hidden = found.undetectable[0]
    absorbed = ", ".join(f"{percent(each.share)} in {each.parameter}" for each in hidden.absorbed_by[:3])
    why = f"absorbed by the model, {absorbed}" if absorbed else why_undetectable(hidden)
    return f"These runs cannot show {asked.effect}: {why}."


def why_undetectable(hidden: UndetectableEffect) -> str:
    """Return why an effect that no parameter absorbs is undetectable."""
    if hidden.reason == "not_supplied":
        return (
            f"the runs do not all supply {', '.join(hidden.needs)}" if hidden.needs else "their response to it is zero"
        )
    return {"absorbed": "the model absorbs it", "noise": "its largest typical size is below the noise"}[hidden.reason]
