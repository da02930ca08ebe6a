"""The evidence of a diagnosis in words: how probable each explanation is, the likeliest first."""

import math
from collections.abc import Iterable

from imubayes.criticism.evidence.evidence_record import (
    NAMED,
    EffectSlot,
    Evidence,
    Explanation,
    FoundForm,
    FoundNoise,
)
from imubayes.display.labels import listed
from imubayes.display.rounding import significant

_LEAST_TOLD, _MOST_NAMES, _WELL_KNOWN = 0.01, 4, 0.1
_PRIOR_DOUBT = 2.0
"""Nats by which prior odds may reasonably differ."""
_NOISE = {
    "known": "noise as stated", "scale": "white noise", "correlated": "correlated rows",
    "wander": "a random walk", "rate": "noise that grows with the input", "tails": "heavy tails",
    "runs": "scatter between runs",
}  # fmt: skip
_KINDS: dict[Explanation, str] = {
    "nothing": "nothing missing", "noise": "noise not as stated", "effects": "an effect missing",
    "input": "a wrong record", "outside": "a cause outside the catalogue",
}  # fmt: skip


def evidence_text(found: Evidence) -> str:
    """Return the probability of each explanation, what the likeliest is, and what that rests on."""
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
    """Return what an explanation is in particular; empty where nothing is to be said."""
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
    """Return the effects of the explanation that leads; where another does, the likeliest."""
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
    first, *others = slot.candidates[:_MOST_NAMES]
    names = (
        [f"{each.effect} {probability(each.probability)}" for each in (first, *others)] if others else [first.effect]
    )
    return f"{' or '.join(names)} on {listed(slot.channels)}"


def form_text(form: FoundForm) -> str:
    """Return a form outside the catalogue, or a wrong input, with its channels and place."""
    where = f" in run {form.run}" if form.run else ""
    row = f", row {form.row}" if form.row is not None else ""
    return f"{form.name} on {listed(form.channels)}{where}{row}"


def _assumptions(found: Evidence) -> str:
    """Return what the probabilities assume where that matters: noise that is not known, and prior odds."""
    said = ""
    if found.noise_known > _WELL_KNOWN:
        factor = significant(math.exp(found.noise_known), 2)
        said += f" The noise is known beforehand only to within a factor of {factor}."
    odds = sorted((each.log_odds for each in found.explanations if each.log_odds is not None), reverse=True)
    if len(odds) > 1 and odds[0] - odds[1] < _PRIOR_DOUBT:
        said += " Prior odds of 7 to 1 would change the order of the first two."
    return said
