"""From the hypotheses of a search to the probabilities of explanations, of effects, and of what stands in their place.

What the model leaves open of its noise is a nuisance, such as the scatter between runs: hypotheses that differ in it
alone count once, by the likeliest.  A search evaluates more sizes about its leader than about others, and their sum
would favour it.
"""

import math
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from imubayes.criticism.evidence.evidence_record import (
    EffectSlot,
    Evidence,
    EvidenceCoefficient,
    Explanation,
    FoundForm,
    FoundNoise,
    ProbableEffect,
    ProbableExplanation,
)
from imubayes.criticism.evidence.hypothesis import Evaluated, EvidenceOf, Hypothesis
from imubayes.criticism.evidence.model_search import ModelSearch

_TOLD, _SHOWN, _NEAR_FORM = 0.95, 8, 5.0
_KINDS: tuple[Explanation, ...] = ("nothing", "noise", "effects", "input", "outside")


def evidence_of(search: ModelSearch) -> Evidence:
    """Return what a search found."""
    of, distinct = search.of, _distinct(search.known)
    logs = np.array([each.log_posterior for each in distinct])
    share = np.exp(logs - np.logaddexp.reduce(logs))
    top = distinct[int(np.argmax(logs))]
    kinds: list[Explanation] = [kind_of(each.hypothesis) for each in distinct]
    slots = sorted((_slot(of, distinct, top, n) for n in top.hypothesis.variants), key=lambda each: -each.gain)
    return Evidence(
        explanations=tuple(_explanation(kind, kinds, share, logs) for kind in _KINDS),
        slots=tuple(slots),
        inclusion=_inclusion(of, distinct, share),
        form=_form(of, distinct),
        noise=tuple(_noise(of, top)),
        noise_known=max(of.problem.rows[k].scale_sd for k in of.unit_of),
        hypotheses=len(search.known),
    )


def _explanation(
    kind: Explanation, kinds: Sequence[Explanation], share: np.ndarray, logs: np.ndarray
) -> ProbableExplanation:
    here = np.array([each == kind for each in kinds])
    odds = float(logs[here].max() - logs.max()) if here.any() else None
    return ProbableExplanation(kind=kind, probability=min(float(share[here].sum()), 1.0), log_odds=odds)


def kind_of(hypothesis: Hypothesis) -> Explanation:
    """Return what kind of explanation a hypothesis is."""
    if hypothesis.form is not None:
        return "input" if hypothesis.form.form.wrong is not None else "outside"
    if hypothesis.variants:
        return "effects"
    return "nothing" if all(each.stated for each in hypothesis.noise) else "noise"


def _distinct(known: Iterable[Evaluated]) -> list[Evaluated]:
    found: dict[object, Evaluated] = {}
    for each in known:
        own = each.hypothesis
        key = own.variants, own.form, tuple((noise.stated or noise.rows, noise.stated) for noise in own.noise)
        if key not in found or found[key].log_posterior < each.log_posterior:
            found[key] = each
    return list(found.values())


def _inclusion(of: EvidenceOf, distinct: list[Evaluated], share: np.ndarray) -> tuple[ProbableEffect, ...]:
    found: dict[str, float] = {}
    owners: dict[str, tuple[str, ...]] = {}
    for each, p in sorted(zip(distinct, share, strict=True), key=lambda pair: -pair[1]):
        for effect in {of.variants[n].effect for n in each.hypothesis.variants}:
            found[effect] = found.get(effect, 0.0) + float(p)
        for n in each.hypothesis.variants:
            owners.setdefault(of.variants[n].effect, of.variants[n].owners)
    order = sorted(found, key=lambda effect: -found[effect])[:_SHOWN]
    return tuple(ProbableEffect(effect=e, channels=owners[e], probability=found[e]) for e in order)


def _slot(of: EvidenceOf, distinct: list[Evaluated], top: Evaluated, variant: int) -> EffectSlot:
    """Return a member of the likeliest hypothesis with what may stand in its place."""
    rest, form = set(top.hypothesis.variants) - {variant}, top.hypothesis.form
    inside: dict[str, list[Evaluated]] = {}
    without = -math.inf
    for each in distinct:
        own = set(each.hypothesis.variants)
        if each.hypothesis.form is not form or not rest <= own:
            continue
        if own == rest:
            without = max(without, each.log_posterior)
        elif len(own) == len(rest) + 1:
            inside.setdefault(of.variants[next(iter(own - rest))].effect, []).append(each)
    mass = {e: float(np.logaddexp.reduce([one.log_posterior for one in every])) for e, every in inside.items()}
    whole = np.logaddexp.reduce(list(mass.values()))
    candidates, told = list[ProbableEffect](), 0.0
    for effect in sorted(mass, key=lambda each: -mass[each]):
        if told >= _TOLD:
            break
        best = max(inside[effect], key=lambda each: each.log_posterior)
        owners = of.variants[next(iter(set(best.hypothesis.variants) - rest))].owners
        told += float(np.exp(mass[effect] - whole))
        candidates.append(
            ProbableEffect(effect=effect, channels=owners, probability=float(np.exp(mass[effect] - whole)))
        )
    own = of.variants[variant]
    return EffectSlot(
        candidates=tuple(candidates),
        channels=own.owners,
        gain=float(top.log_posterior - without) if math.isfinite(without) else 0.0,
        coefficients=_coefficients(of, top, own.places),
        shape=dict(of.problem.candidates[own.response].scan.shape),
    )


def _coefficients(of: EvidenceOf, top: Evaluated, places: tuple[int, ...]) -> tuple[EvidenceCoefficient, ...]:
    at = {int(column) - of.problem.own: n for n, column in enumerate(top.columns)}
    found, covariance = [], of.solved(top).covariance
    for k in places:
        coefficient, size = of.problem.coefficients[k], float(of.problem.sizes[k])
        found.append(
            EvidenceCoefficient(
                name=coefficient.parameter.name,
                value=float(top.mean[at[k]]) * size,
                sd=float(np.sqrt(covariance[at[k], at[k]])) * size,
                unit=coefficient.parameter.shown_unit,
            )
        )
    return tuple(found)


def _form(of: EvidenceOf, distinct: list[Evaluated]) -> FoundForm | None:
    without = max(each.log_posterior for each in distinct if each.hypothesis.form is None)
    formed = [each for each in distinct if each.hypothesis.form is not None]
    if not formed:
        return None
    best = max(formed, key=lambda each: each.log_posterior)
    if best.log_posterior < without - _NEAR_FORM:
        return None
    chosen, problem = best.hypothesis.form, of.problem
    assert chosen is not None
    form = chosen.form
    return FoundForm(
        name=form.name,
        channels=tuple(problem.channels[k].name for k in chosen.channels),
        covariates=form.covariates,
        run=problem.runs[form.run] if form.run is not None else "",
        row=form.row + 1 if form.row is not None else None,
        log_odds=float(best.log_posterior - without),
        wrong=form.wrong is not None,
    )


def _noise(of: EvidenceOf, top: Evaluated) -> Iterable[FoundNoise]:
    names: Mapping[int, str] = dict(enumerate(each.name for each in of.problem.channels))
    for unit, noise in zip(of.units, top.hypothesis.noise, strict=True):
        if not noise.stated:
            scale = float(np.exp(np.mean(np.log(top.scale[list(unit.channels)]))))
            channels = tuple(names[k] for k in unit.channels)
            yield FoundNoise(channels=channels, family=noise.family, scale=scale)
