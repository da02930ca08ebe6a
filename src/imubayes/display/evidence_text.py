"""The evidence of a diagnosis in words: how probable each explanation is, the likeliest first."""

import math

from imubayes.criticism.evidence.evidence_record import EffectSlot, Evidence, Explanation, FoundForm
from imubayes.display.labels import listed
from imubayes.display.rounding import percent

_LEAST_TOLD, _MOST_NAMES, _WELL_KNOWN = 0.01, 4, 0.1
_PRIOR_DOUBT = 2.0
"""Nats by which prior odds may reasonably differ."""


def evidence_text(found: Evidence) -> str:
    """Return the probability of each explanation, what the likeliest is, and what that rests on."""
    each = sorted(found.explanations, key=lambda one: -one.probability)
    shown = [one for one in each if one.kind == "nothing" or one.probability >= _LEAST_TOLD]
    told = [f"{_words(found, one.kind)} {probability(one.probability)}" for one in shown]
    return f"Probability: {'; '.join(told)}.{_assumptions(found)}"


def probability(value: float) -> str:
    """Return a probability, never 0 or 1."""
    if value > 0.999:
        return "> 0.999"
    return "< 0.001" if value < 0.001 else f"{value:.2g}" if value < 0.1 else f"{min(value, 0.999):.3g}"


def _words(found: Evidence, kind: Explanation) -> str:
    if kind == "nothing":
        return "nothing missing"
    if kind == "effects":
        names = " and ".join(map(_slot_words, found.slots)) or listed([each.effect for each in found.inclusion[:2]])
        return f"{names} missing"
    if kind == "noise":
        names = [f"{_NOISE[each.family]} on {listed(each.channels)}" for each in found.noise]
        return f"other noise ({listed(names)})" if names else "other noise than stated"
    plain = "wrong record" if kind == "input" else "outside the catalogue"
    form = found.form
    return f"{plain} ({_form_words(form)})" if form is not None and form.wrong == (kind == "input") else plain


_NOISE = {
    "known": "as stated", "scale": "another size", "correlated": "correlated rows", "wander": "random walk",
    "rate": "noise that grows with rate", "tails": "heavy tails", "runs": "scatter between runs",
}  # fmt: skip


def _slot_words(slot: EffectSlot) -> str:
    first, *others = slot.candidates[:_MOST_NAMES]
    names = first.effect
    if others:
        names = " or ".join(f"{each.effect} {probability(each.probability)}" for each in (first, *others))
        names = f"({names})" if len(others) > 1 else names
    return f"{names} on {listed(slot.channels)}"


def _form_words(form: FoundForm) -> str:
    where = f" in run {form.run}" if form.run else ""
    row = f", row {form.row}" if form.row is not None else ""
    return f"{form.name} on {listed(form.channels)}{where}{row}"


def _assumptions(found: Evidence) -> str:
    """Return what the probabilities assume where that matters: noise that is not known, and prior odds."""
    said = ""
    if found.noise_known > _WELL_KNOWN:
        said += f" No raw samples tell the noise: it is taken to be known to {percent(math.expm1(found.noise_known))}."
    odds = sorted((each.log_odds for each in found.explanations if each.log_odds is not None), reverse=True)
    if len(odds) > 1 and odds[0] - odds[1] < _PRIOR_DOUBT:
        said += " Prior odds of 7 to 1 would change which is likeliest."
    return said
