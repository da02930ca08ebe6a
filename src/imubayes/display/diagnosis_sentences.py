"""The verdict of a diagnosis in words: a few sentences, the finding of the strongest evidence first."""

import math

from imubayes.criticism import thresholds
from imubayes.criticism.detectability import ParameterBias
from imubayes.criticism.diagnosis_record import Diagnosis, EffectChoice, EffectGroup, UndetectableEffect
from imubayes.criticism.noise_violation import NoiseComparison
from imubayes.display.disagreement_text import disagreement_text
from imubayes.display.labels import listed, pretty
from imubayes.display.noise_violation_text import contradiction_text, noise_ratio, violation_text
from imubayes.display.rounding import percent, significant
from imubayes.display.structure_words import step_text

_MOST_NAMED = 3


def sentence(found: Diagnosis) -> str:
    """Return the verdict in a few sentences, the finding of the strongest evidence first."""
    if found.asked is not None:
        return _asked_sentence(found)
    if found.verdict == "not_converged":
        return found.message
    noise = ""
    if found.verdict == "run_disagrees":
        return disagreement_text(found.disagreeing) + _record_sentence(found) + _outlier_sentence(found)
    if found.groups:
        said = _missing_sentence(found.groups[0], found.wandering == "rival") + _pair_sentence(found)
        said += _rival_sentence(found) + _more_sentence(found)
        noise = _adopted_sentence(found)
    elif found.verdict == "unexplained_structure":
        said = _structure_sentence(found)
        noise = _adopted_sentence(found)
    elif found.verdict == "noise_model":
        said = _noise_sentence(found)
    else:
        said = "The model explains the data: no effect of the catalogue is missing as far as these runs can show."
        said += _undetectable_sentence(found)
        said += _nearest_sentence(found)
    parts = [noise, said] if found.noise_outweighs else [said, noise]
    told = [f"{contradiction_text(found.contradicted)}."] if found.contradicted else []
    return (
        " ".join(part for part in (*told, *parts) if part)
        + "".join(f" {disagreement_text([each])}" for each in found.disagreeing if each.leads)
        + _record_sentence(found)
        + _outlier_sentence(found)
        + _neglected_sentence(found)
    )


def _nearest_sentence(found: Diagnosis) -> str:
    """Return the candidate that is nearly significant; empty where none is."""
    best = min(found.ranking, key=lambda line: line.p_global, default=None)
    if best is None or best.p_global > thresholds.NEARLY_SIGNIFICANT_P:
        return ""
    return f" The nearest to significance is {best.effect} on {listed(best.channels)}, p = {best.p_global:.1g}."


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


def _pair_sentence(found: Diagnosis) -> str:
    """Return which effects are to be added together with the first; empty where it is to be added alone."""
    if found.unfinished:
        others = list(dict.fromkeys(group.effects[0] for group in found.groups[1:]))
        said = f" {listed(others)} {'are' if others[1:] else 'is'} missing beside it." if others else ""
        return f"{said} The model lacks more: add what is named and diagnose again."
    if not found.paired:
        return ""
    second = found.groups[1]
    others = f" ({', '.join(second.effects[1:])} in its place would fit as well)" if second.effects[1:] else ""
    return f" {second.effects[0]} is missing beside it{others}: neither explains alone what both do."


def _rival_sentence(found: Diagnosis) -> str:
    """Return which effects would explain the same together; empty where the data exclude all others."""
    if not found.rivals:
        return ""
    best = found.rivals[0]
    names = listed([_on_channels(each, found.groups[0]) for each in best.effects])
    together = " together" if len(best.effects) > 1 else ""
    if best.log_odds > thresholds.DECISIVE_LOG_ODDS:
        verb = "explain" if together else "explains"
        return f" {names}{together} {verb} it better (log odds {significant(best.log_odds)})" + (left_out(found) or ".")
    said = f" {names}{together} would fit as well"
    return said + (left_out(found) or ": the posterior with all of them in the model holds both explanations.")


def left_out(found: Diagnosis) -> str:
    """Return which effects the next command leaves out since a refit with them fails; empty where none."""
    names = found.suggested.left_out if found.suggested is not None else ()
    verb = "are" if names[1:] else "is"
    return (
        f"; {listed(names)} {verb} left out of the next command: the refit does not converge with all." if names else ""
    )


def _on_channels(choice: EffectChoice, group: EffectGroup) -> str:
    """Return an effect by name, with its channels where they are some of the group's."""
    own = choice.channels or ()
    return f"{choice.effect} ({listed(own)} alone)" if own and set(own) < set(group.channels) else choice.effect


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
    if found.unfinished:
        return ""
    if found.scatter_remains:
        return " Rows scatter beyond the recorded noise all the same: it may only resemble the cause."
    if not found.more_remains:
        return ""
    first, *others = found.groups
    small = all(other.delta_chi2 < first.delta_chi2 for other in others)
    return f" More remains beside it{', small against what it explains' if small else ''}: add it and diagnose again."


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
            f"{_rival_of_noise(found)}"
        )
    if not adopted and found.violations:
        return (
            f"The noise is not as the model says: {violation_text(found.violations)}. No effect or noise of the "
            "catalogue is significant, but the intervals of this fit cannot be trusted."
        )
    if not adopted and found.contradicted:
        return "No single effect and no noise of the catalogue is significant, but the model is not adequate."
    if not adopted:
        return (
            "The model does not explain the scatter from row to row: no single effect and no noise of the catalogue is "
            "significant, but something acts there that the model lacks."
        )
    return f"The noise model is inadequate: {' and '.join(adopted)}. With it corrected, no effect is missing."


def _rival_of_noise(found: Diagnosis) -> str:
    """Return the effect that would do in place of wandering noise; empty where that is excluded."""
    if not found.rivals:
        return ""
    [effect] = found.rivals[0].effects
    channels = f" on {', '.join(effect.channels)}" if effect.channels else ""
    return (
        f" {effect.effect}{channels} may be missing instead: record the unit at rest again, since a systematic drift "
        "repeats and wandering noise does not."
    )


def _record_sentence(found: Diagnosis) -> str:
    """Return by how much the fitted noise differs from the recorded one; empty where they agree."""
    told = () if found.groups else {each.parameter for each in found.contradicted}
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
    if not found.neglected or found.unfinished:
        return ""
    worst = found.neglected[0]
    effects = listed([each.effect for each in found.neglected])
    return (
        f" No interval includes {effects}, which the model takes as exact: the uncertainty that the campaign states of "
        f"{worst.parameter}, {significant(worst.value)} {pretty(worst.unit)}, shifts {worst.shifts} by "
        f"{significant(worst.in_sd)} of its sd."
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
        f"{significant(abs(bias.in_sd))} of its sd"
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
    if found.verdict == "missing_effect":
        return f"{asked.effect} is missing, or an effect that resembles it: p = {found.p_global:.2g}."
    if found.verdict == "adequate":
        size = f"{significant(asked.smallest_detectable)} {pretty(asked.unit)}"
        return f"{asked.effect} is absent down to {size}, the size that is detected with 80 % power."
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
