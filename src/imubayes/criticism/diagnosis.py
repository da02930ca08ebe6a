"""The verdict: one sentence, what stands behind it, and the next command."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from imubayes.criticism import thresholds
from imubayes.criticism.detectability import Detectability, detectability
from imubayes.criticism.discriminating_run import separating_run
from imubayes.criticism.equivalent_effects import EquivalenceGroup, unexplained_chi2
from imubayes.criticism.formula_search import Formula, coefficient_unit, find_formula
from imubayes.criticism.lack_of_fit import Structure, dominant_channel
from imubayes.criticism.localised_structure import STEP
from imubayes.criticism.residual_evidence import Telling, tell, telling_covariate
from imubayes.criticism.score_test import Candidate
from imubayes.criticism.stepwise_search import SearchResult, search
from imubayes.effects.base import Effect, Order
from imubayes.errors import InputError, Issue
from imubayes.inference.fitted import Fitted

_MOST_NAMED = 3


@dataclass(frozen=True)
class Diagnosis:
    """What is missing in a model, found without a refit.

    Attributes
    ----------
    json : as `imubayes diagnose --json` prints it.
    telling : residuals behind each group, for pictures; in the order of the groups.
    found : the search itself; None where the fit had not converged.
    """

    json: dict[str, Any]
    telling: tuple[Telling, ...] = ()
    found: SearchResult | None = field(default=None, repr=False)

    @property
    def verdict(self) -> str:
        """One of the verdicts."""
        return self.json["verdict"]

    @property
    def sentence(self) -> str:
        """The verdict in a sentence."""
        return self.json["sentence"]

    def __repr__(self) -> str:
        return f"{self.verdict}: {self.sentence}"


def judge(fitted: Fitted, folder: str = "RESULT", effect: str = "") -> Diagnosis:
    """Return the diagnosis of a fit.

    Parameters
    ----------
    fitted : the fit; one that did not converge is not ranked.
    folder : the result folder, for the next command.
    effect : ask about one effect only: whether it is there, absent or cannot be seen.
    """
    if effect:
        _refuse_unknown(effect, fitted)
    if not fitted.converged:
        return Diagnosis(_document("not_converged", fitted.message or "The fit did not converge.", 1.0, folder))
    found = search(fitted)
    seen = _resolutions(found)
    groups = found.groups
    ranking = [_candidate_line(one, found) for one in found.first.candidates]
    alone = [one.p for one in found.first.candidates]
    best = found.look_elsewhere(min(alone)) if alone else 1.0
    if effect:
        return _asked(effect, found, seen, ranking, folder)
    telling = tuple(_telling(found, one) for one in groups)
    unexplained = _unexplained(found)
    verdict = _verdict(found, unexplained)
    document = _document(
        verdict,
        _sentence(verdict, found, seen, telling) + _far_off_sentence(found),
        best,
        folder,
        groups=[_group_line(fitted, one, told) for one, told in zip(groups, telling, strict=True)]
        if verdict in ("missing_effect", "equivalent_effects")
        else [],
        ranking=ranking,
        noise=[
            vars(one)
            | {"adopted": (one.effect, one.channels) in {(each.effect, each.channels) for each in found.adopted}}
            for one in found.noise
        ],
        undetectable=[_resolution_line(one) for one in seen if one.undetectable]
        + [
            {"effect": name, "absorbed_by": [], "needs": list(needs), "reason": "no run supplies " + ", ".join(needs)}
            for name, needs in found.responses.unobservable.items()
        ],
        nearest=[_nearest_line(one) for one in groups] if verdict == "unexplained_structure" else [],
        structure=_structure_lines(found, unexplained),
        looks=found.look_elsewhere.looks,
        far_off=_far_off_lines(found),
    )
    printable = any(line.get("python") for line in document["structure"])
    document["next"] = _next(verdict, found, folder, printable)
    return Diagnosis(document, telling, found)


def _refuse_unknown(effect: str, fitted: Fitted) -> None:
    """Raise where the effect that is asked about does not exist, or is in the model already."""
    where = f"effect '{effect}'"
    member = fitted.model.registry.find(effect, where)
    if not issubclass(member, Effect):
        raise InputError(
            Issue(f"'{effect}' is noise, not an effect", where, "an effect", "ask without it: noise is always judged")
        )
    if any(one.name == effect and one.channels is None for one in fitted.model.spec.effects):
        raise InputError(
            Issue(
                f"'{effect}' is in the model already",
                fitted.model.spec.where,
                "an effect that the model lacks",
                "see its estimate in the summary of the fit",
            )
        )


def _document(verdict: str, sentence: str, p_global: float, folder: str, **parts: Any) -> dict[str, Any]:
    empty = {
        "groups": [], "ranking": [], "noise": [], "undetectable": [], "nearest": [], "structure": [], "looks": 0.0,
        "far_off": [],
    }  # fmt: skip
    return {
        "format": 1,
        "verdict": verdict,
        "sentence": sentence,
        "p_global": p_global,
        "threshold": thresholds.FALSE_ALARM,
        **empty,
        **parts,
        "next": f"imubayes fit … --out {folder}" if verdict == "not_converged" else "",
    }


def _verdict(found: SearchResult, unexplained: Sequence) -> str:
    if unexplained:
        return "unexplained_structure"
    if found.groups:
        return "missing_effect" if len(found.groups[0].members) == 1 else "equivalent_effects"
    return "noise_model" if found.adopted else "adequate"


def _unexplained(found: SearchResult) -> list[tuple[Structure, float]]:
    """Return the structure that no effect of the catalogue explains; empty where they do."""
    if not found.groups:
        return list(found.structures)
    leader = found.groups[0].leader

    def concerned(structures: Sequence[tuple[Structure, float]]) -> list[tuple[Structure, float]]:
        return [(one, p) for one, p in structures if one.channel in leader.owners or not _channels(found, leader)]

    # The leader took a part of something larger; nor does anything in the catalogue happen once.
    larger = [
        (one, p) for one, p in _of_kind(found, leader, found.remaining) if one.score.delta_chi2 > leader.delta_chi2
    ]
    once = [(one, p) for one, p in _of_kind(found, leader, found.structures) if one.test == STEP]
    once = [(one, p) for one, p in once if one.score.delta_chi2 > thresholds.STEP_DOMINATES * leader.delta_chi2]
    if larger or once:
        return larger or once
    member = found.first.projection.fitted.model.registry.effects[leader.effect]
    if issubclass(member, Effect) and member.order >= Order.LIMIT:
        return []  # it bends the signal at its own size: looked at linearly it always leaves something
    several = False
    for owner in leader.owners:
        of_owner = [group for group in found.groups if owner in group.leader.owners]
        again = any(set(group.effects) & set(found.groups[0].effects) for group in of_owner[1:])
        mended = any(_resembles(found, group.leader, leader) for group in of_owner[1:])
        if again or mended or len(of_owner) >= thresholds.CROWDED_EFFECTS:
            return concerned(found.structures)
        several = several or len(of_owner) > 1
    # What remains has to be worth something beside what was explained: a large effect shows its smallest imperfection.
    worth = [
        (one, p)
        for one, p in concerned(found.remaining)
        if one.score.delta_chi2 > thresholds.REMAINDER_SHARE * leader.delta_chi2
    ]
    return worth if several else [(one, p) for one, p in worth if p < thresholds.AGAINST_SINGLE_NAME_P]


def _of_kind(
    found: SearchResult, leader: Candidate, structures: Sequence[tuple[Structure, float]]
) -> list[tuple[Structure, float]]:
    """Return what is on channels of the kinds that a candidate acts on; on all where it acts on a table."""
    kinds = {one.name: one.kind for one in found.first.projection.fitted.model.campaign.channels}
    own = {kinds[name] for name in _channels(found, leader)} or set(kinds.values())
    return [(one, p) for one, p in structures if kinds[one.channel] in own]


def _resembles(found: SearchResult, other: Candidate, leader: Candidate) -> bool:
    """Tell whether another effect on the same channels could explain most of what the leader does.

    Where both are needed they mend one another's shape, and neither is likely to be the cause: |Ω| and Ω² together make
    a good root of |Ω|.
    """
    shared = set(leader.owners) & set(other.owners)
    rivals = [one for one in found.first.candidates if one.effect == other.effect and set(one.owners) >= shared]
    shares = (unexplained_chi2(found.first.projection, leader, one) for one in rivals)
    return any(left < (1 - thresholds.MAIN_SHARE) * whole for left, whole in shares)


def _channels(found: SearchResult, candidate: Candidate) -> tuple[str, ...]:
    """Return the channels among the owners of a candidate."""
    names = {channel.name for channel in found.first.projection.fitted.model.campaign.channels}
    return tuple(owner for owner in candidate.owners if owner in names)


def _resolutions(found: SearchResult) -> list[Detectability]:
    """Return for each effect how well the runs can see it, over its coefficients and shapes."""
    projection = found.first.projection
    best: dict[str, Detectability] = {}
    for one in found.first.prepared:
        seen = detectability(projection, one, thresholds.FALSE_ALARM_EFFECT, found.look_elsewhere.looks)
        known = best.get(seen.effect)
        if known is None or seen.smallest_detectable / seen.typical[1] < known.smallest_detectable / known.typical[1]:
            best[seen.effect] = seen
    return list(best.values())


def _telling(found: SearchResult, group: EquivalenceGroup) -> Telling:
    projection, leader = found.first.projection, group.leader
    response = next(one for one in found.first.prepared if one.response.scan == leader.scan)
    names = [channel.name for channel in projection.fitted.model.campaign.channels]
    channel = dominant_channel(projection, names, leader.score)
    covariate = telling_covariate(projection, found.first.structures, leader, channel)
    return tell(projection, found.responses, response, leader, channel, covariate)


def _candidate_line(one: Candidate, found: SearchResult) -> dict[str, Any]:
    return {
        "effect": one.effect,
        "channels": list(one.owners),
        "delta_chi2": one.delta_chi2,
        "dof": one.dof,
        "p": one.p,
        "p_global": found.look_elsewhere(one.p),
        "within_runs": one.score.within_runs,
        "shape": one.scan.shape,
        "coefficients": _coefficients(one),
    }


def _coefficients(one: Candidate) -> list[dict[str, Any]]:
    return [
        {
            "name": coefficient.parameter.name,
            "value": float(value),
            "sd": float(sd) if np.isfinite(sd) else None,
            "unit": coefficient.parameter.unit,
        }
        for coefficient, value, sd in zip(one.coefficients, one.value, one.sd, strict=True)
    ]


def _group_line(fitted: Fitted, group: EquivalenceGroup, telling: Telling) -> dict[str, Any]:
    leader, separation = group.leader, separating_run(fitted, group)
    return {
        "effects": list(group.effects),
        "channels": list(leader.owners),
        "delta_chi2": leader.delta_chi2,
        "dof": leader.dof,
        "p_global": group.p,
        "candidates": [
            {
                "effect": one.effect,
                "channels": list(one.owners),
                "delta_chi2": one.delta_chi2,
                "shape": one.scan.shape,
                "coefficients": _coefficients(one),
                "unexplained": left,
            }
            for one, left in zip(group.members, group.unexplained, strict=True)
        ],
        "residual": telling.rms,
        "separating_run": separation.sentence if separation is not None else "",
    }


def _nearest_line(group: EquivalenceGroup) -> dict[str, Any]:
    """Return what the catalogue has for structure that it does not explain in full."""
    return {
        "effects": list(group.effects),
        "channels": list(group.leader.owners),
        "delta_chi2": group.leader.delta_chi2,
    }


def _resolution_line(one: Detectability) -> dict[str, Any]:
    return {
        "effect": one.effect,
        "absorbed_by": [{"parameter": each.parameter, "share": each.share} for each in one.absorbed_by],
        "retained": one.retained,
        "smallest_detectable": one.smallest_detectable if np.isfinite(one.smallest_detectable) else None,
        "typical": list(one.typical),
        "unit": one.unit,
        "bias": vars(one.bias) if one.bias is not None else None,
        "reason": "the model absorbs it" if one.retained < 0.5 else "the runs are too few or too noisy",
    }


def _structure_lines(found: SearchResult, unexplained: Sequence[tuple[Structure, float]]) -> list[dict[str, Any]]:
    """Return the free forms that stand out, with a formula for each channel where no effect explains them."""
    listed = _simplest(unexplained or found.structures)
    # What happens once in one run has no formula in what runs share.
    channels = [name for name in dict.fromkeys(one.channel for one, _ in unexplained) if not _once(name, unexplained)]
    shapes = {
        name: find_formula(found.first.projection, found.covariates, name)
        for name in channels[: thresholds.MAX_FORMULAS]
    }
    return [_structure_line(found, one, p, shapes.get(one.channel)) for one, p in listed]


def _once(channel: str, structures: Sequence[tuple[Structure, float]]) -> bool:
    """Tell whether most of what a channel shows is a step in one run."""
    drops = [(one.test == STEP, one.score.delta_chi2) for one, _ in structures if one.channel == channel]
    return max((drop for step, drop in drops if step), default=0.0) > thresholds.MAIN_SHARE * max(
        drop for _, drop in drops
    )


def _simplest(structures: Sequence[tuple[Structure, float]]) -> list[tuple[Structure, float]]:
    """Leave out products of what alone explains a channel better."""
    kept: list[tuple[Structure, float]] = []
    alone: set[tuple[str, str]] = set()
    for one, p in structures:
        names = {(one.channel, each.name) for each in one.covariates}
        if len(one.covariates) == 1:
            alone |= names
        if len(one.covariates) == 1 or not names & alone:
            kept.append((one, p))
    return kept


def _structure_line(found: SearchResult, one: Structure, p: float, shape: Formula | None) -> dict[str, Any]:
    line: dict[str, Any] = {
        "channel": one.channel,
        "covariate": " × ".join(each.name for each in one.covariates),
        "test": one.test if one.test == STEP else f"{one.test} {one.text}".strip(),
        "p": float(p),
        "shape": one.text if one.test == STEP else "",
        "coefficient": _height(found, one),
    }
    if shape is None or one.test == STEP:
        return line
    terms = zip(shape.terms, shape.value, shape.sd, shape.unit, shape.delta_chi2, shape.p, strict=True)
    return line | {
        "shape": shape.text,
        "coefficient": {"value": shape.value[0], "sd": shape.sd[0], "unit": shape.unit[0]},
        "terms": [
            {"shape": term.text, "value": value, "sd": sd, "unit": unit, "delta_chi2": drop, "p_global": chance}
            for term, value, sd, unit, drop, chance in terms
        ],
        "inclusion": shape.inclusion,
        "near": list(shape.near),
        "python": shape.python,
    }


def _height(found: SearchResult, one: Structure) -> dict[str, Any] | None:
    """Return the height of a step as a coefficient at the input."""
    if one.height is None:
        return None
    campaign = found.first.projection.fitted.model.campaign
    channel = next(each for each in campaign.channels if each.name == one.channel)
    factor, unit = coefficient_unit(channel.kind, channel.scale_si, campaign.site.gravity)
    return {"value": one.height[0] / factor, "sd": one.height[1] / factor, "unit": unit}


def _sentence(verdict: str, found: SearchResult, seen: Sequence[Detectability], telling: Sequence[Telling]) -> str:
    if verdict in ("missing_effect", "equivalent_effects"):
        group = found.groups[0]
        where = ", ".join(group.leader.owners)
        covariate = telling[0].covariate
        changes = f" The residual of {telling[0].channel} changes with {covariate.phrase}." if covariate else ""
        others = group.effects[1 : 1 + _MOST_NAMED]
        more = [f"{rest} more"] if (rest := len(group.effects) - 1 - len(others)) else []
        also = f" {' and '.join((*others, *more))} would fit as well: these runs cannot tell." if others else ""
        return f"{group.leader.effect} is missing on {where}.{changes}{also}"
    if verdict == "unexplained_structure":
        structures = found.remaining or found.structures
        one = structures[0][0]
        step = next((each for each, _ in structures if each.test == STEP), None)
        if step is not None and _once(step.channel, structures):
            return f"The residual of {step.channel} has a {step.text}: no effect of the catalogue happens once."
        phrases = " and ".join(each.phrase for each in one.covariates)
        depends = (
            f"The residual of {one.channel} depends on {phrases} in a way that no effect of the catalogue explains."
        )
        parts = [f"{group.leader.effect} on {', '.join(group.leader.owners)}" for group in found.groups]
        return f"{depends} It explains a part: {'; '.join(parts)}." if parts else depends
    if verdict == "noise_model":
        kinds = " and ".join(dict.fromkeys(f"{one.effect} on {', '.join(one.channels)}" for one in found.adopted))
        return f"The noise is not what the model says: {kinds}. With that no effect is missing."
    hidden = [one.effect for one in seen if one.undetectable] + list(found.responses.unobservable)
    rest = f" {len(hidden)} effects of the catalogue could not be seen in these runs." if hidden else ""
    return f"The model explains the data: nothing in the catalogue is missing as far as these runs can show.{rest}"


def _far_off_lines(found: SearchResult) -> list[dict[str, Any]]:
    """Return run, channel and row of readings that are far off, with their distance, the farthest first."""
    model, far = found.first.projection.fitted.model, found.outlier_sd
    names = [channel.name for channel in model.campaign.channels]
    return [
        {
            "run": model.campaign.runs[model.entries.run[place]].name,
            "channel": names[model.entries.channel[place]],
            "row": int(model.entries.row[place]) + 1,
            "distance": float(far[place]),
        }
        for place in np.argsort(-np.abs(far), kind="stable")[: np.count_nonzero(far)]
    ]


def _far_off_sentence(found: SearchResult) -> str:
    lines = _far_off_lines(found)
    if not lines:
        return ""
    worst, size = lines[0], abs(lines[0]["distance"])
    where = f"{worst['channel']} in row {worst['row']} of run {worst['run']}, by {size:.0f} standard deviations"
    return f" {len(lines)} readings are far off, the farthest {where}." if len(lines) > 1 else f" Far off is {where}."


def _next(verdict: str, found: SearchResult, folder: str, printable: bool) -> str:
    if verdict in ("missing_effect", "equivalent_effects"):
        leader = found.groups[0].leader
        channels = _channels(found, leader)
        everywhere = {
            owner for one in found.first.candidates if one.effect == leader.effect for owner in _channels(found, one)
        }
        chosen = f" --channels {' '.join(channels)}" if channels and set(channels) != everywhere else ""
        return f"imubayes add {leader.effect} --to {folder} --out {folder}-{leader.effect}{chosen}"
    if verdict == "noise_model":
        name = found.adopted[0].effect
        return f"imubayes add {name} --to {folder} --out {folder}-{name}"
    if verdict == "unexplained_structure":
        return f"imubayes diagnose {folder} --python > found_shape.py" if printable else f"imubayes compare {folder}"
    return f"imubayes plant --result {folder}"


def _asked(
    effect: str, found: SearchResult, seen: Sequence[Detectability], ranking: Sequence[Mapping[str, Any]], folder: str
) -> Diagnosis:
    """Answer for one effect: found, absent down to a size, or not to be seen."""
    lines = [line for line in ranking if line["effect"] == effect]
    known = [one for one in seen if one.effect == effect]
    best = min((line["p_global"] for line in lines), default=1.0)
    if best < thresholds.FALSE_ALARM_EFFECT:
        sentence = f"{effect} is in the data, or something that looks like it: chance {best:.2g}."
        return Diagnosis(_document("missing_effect", sentence, best, folder, ranking=lines), (), found)
    if known and not known[0].undetectable:
        one = known[0]
        sentence = (
            f"{effect} is absent down to {one.smallest_detectable:.3g} {one.unit}, the size that would be "
            "found with a chance of 80 %."
        )
        return Diagnosis(_document("adequate", sentence, best, folder, ranking=lines), (), found)
    reason = "no run supplies " + ", ".join(found.responses.unobservable.get(effect, ("what it needs",)))
    if known:
        hidden = ", ".join(f"{each.share:.0%} in {each.parameter}" for each in known[0].absorbed_by[:3])
        reason = f"it would hide, {hidden}" if hidden else "its largest usual size is below the noise"
    sentence = f"These runs cannot show {effect}: {reason}."
    undetectable = [_resolution_line(one) for one in known] or [{"effect": effect, "absorbed_by": []}]
    return Diagnosis(
        _document("undetectable", sentence, best, folder, ranking=lines, undetectable=undetectable), (), found
    )
