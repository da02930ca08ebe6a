"""Effects that noise of the model has taken up.

They are not significant at the noise scales of the fit, but at those beside them or by their marginal likelihood.
"""

import math
from collections.abc import Mapping
from dataclasses import replace

from imubayes.criticism import thresholds
from imubayes.criticism.effect_selection import at_scales, select_beside
from imubayes.criticism.equivalent_effects import EquivalenceGroup, equivalence_group
from imubayes.criticism.known_noise import contradicted_between_runs
from imubayes.criticism.marginal_evidence import (
    columns_of,
    evidence_with_scatter,
    evident_between_runs,
    evident_in_correlated_noise,
)
from imubayes.criticism.scales_beside import evident_at_scales_beside
from imubayes.criticism.score_test import Candidate
from imubayes.criticism.search_input import Screening, SearchInput
from imubayes.criticism.search_outcome import FirstPass, SearchOutcome, only
from imubayes.criticism.slow_noise_evidence import slow_noise_evidence


def beside_slow_noise(given: SearchInput, at: FirstPass) -> SearchOutcome | None:
    """Return the outcome at the noise beside an effect that correlated noise took up; None where none is evident."""
    first = at.first
    columns = [columns_of(first.prepared, each) for each in first.candidates]
    evidence = slow_noise_evidence(given.records, columns)
    if evidence is None or evidence.corrected >= thresholds.SLOW_NOISE_EVIDENCE:
        return None
    beside = given.screening_beside(columns[min(evidence.p, key=lambda place: evidence.p[place])])
    return _judged_beside(beside, first, evidence.p, evidence.corrected)


def _judged_beside(
    beside: Screening, first: Screening, p: Mapping[int, float], corrected: float
) -> SearchOutcome | None:
    """Return the outcome at the noise beside the effect of the smallest p-value; None where none is possible there.

    Parameters
    ----------
    beside : the screening there.
    p : of candidates of the first screening alone, by their place.
    corrected : of the smallest one.
    """
    known = {_identity(first.candidates[place]): math.log(value) for place, value in p.items()}
    candidates = [
        replace(each, score=replace(each.score, log_p=max(each.score.log_p, known.get(_identity(each), -math.inf))))
        for each in beside.candidates
    ]
    beside = replace(beside, candidates=tuple(candidates))
    leader = next((each for each in candidates if _identity(each) in known), None)
    if leader is None:
        return None
    group = equivalence_group(beside.projection, leader, candidates, corrected)
    return SearchOutcome(beside, only(beside, group), thresholds.SLOW_NOISE_EVIDENCE / thresholds.FALSE_ALARM_EFFECT)


def _identity(candidate: Candidate) -> tuple[str, ...]:
    """Return what tells a candidate from others: effect, shape and coefficients."""
    shape = (f"{field}={value}" for field, value in candidate.scan.shape.items())
    return candidate.effect, *shape, *(each.parameter.name for each in candidate.coefficients)


def beside_noise(given: SearchInput, at: FirstPass, outcome: SearchOutcome) -> SearchOutcome:
    """Return the outcome with what is evident although noise of the model has taken it up."""
    if (found := _at_scales_beside(at, outcome)) is not None:
        return found
    if (between := _between_few_runs(given, at)) is not None:
        first, group = between
        return SearchOutcome(first, only(first, group))
    return _taken_up(given, at) or outcome


def _at_scales_beside(at: FirstPass, outcome: SearchOutcome) -> SearchOutcome | None:
    """Return the outcome at the scales beside an effect that acts within runs and between; None without one."""
    first, corrected = at.first, at.corrections.of_effect
    threshold = outcome.factor * thresholds.FALSE_ALARM_EFFECT
    found = evident_at_scales_beside(first.projection, first.prepared, first.candidates, corrected, threshold)
    if found is None:
        return None
    own, root = found
    there = at_scales(first, root)
    group = equivalence_group(there.projection, own, there.candidates, corrected(own.p))
    return SearchOutcome(there, only(there, group), outcome.factor)


def _between_few_runs(
    given: SearchInput, at: FirstPass, log_factor: float = -math.inf
) -> tuple[Screening, EquivalenceGroup] | None:
    """Return what is evident although the F test of few runs does not show it; None without.

    Parameters
    ----------
    log_factor : log Bayes factor of what it is to outweigh.

    Returns
    -------
    The screening with the p-values of that evidence, and the group of the most evident effect.
    """
    first = at.first
    evident = evident_between_runs(given.fitted, given.responses, first.prepared, first.candidates)
    if max(evident.values(), default=-math.inf) <= log_factor + thresholds.DECISIVE_LOG_ODDS:
        return None
    candidates = list(first.candidates)
    for place, own in evident.items():
        score = candidates[place].score
        candidates[place] = replace(candidates[place], score=replace(score, log_p=min(score.log_p, -own)))
    best = max(evident, key=lambda place: evident[place])
    near = [candidates[k] for k, value in evident.items() if value > evident[best] - thresholds.DECISIVE_LOG_ODDS]
    first, leader = replace(first, candidates=tuple(candidates)), candidates[best]
    corrected = at.corrections.of_effect(leader.score.p)
    return first, equivalence_group(first.projection, leader, candidates, corrected, near)


def outweighed(given: SearchInput, at: FirstPass, outcome: SearchOutcome) -> SearchOutcome:
    """Return the outcome with what scatter between runs took up, where that outweighs what was selected.

    Scatter that contradicts what is known is a finding.  The F test of few runs does not show its cause, whose smaller
    part within runs is then shared by effects that imitate it.  Beside the cause these explain nothing, but what is
    missing as well is selected.
    """
    if not contradicted_between_runs(given.fitted, given.responses):
        return outcome
    log_factor = -math.inf
    if outcome.groups:
        leader, prepared = outcome.groups[0].leader, at.first.prepared
        log_factor = evidence_with_scatter(given.fitted, given.responses, prepared, leader)
    between = _between_few_runs(given, at, log_factor)
    if between is None:
        return outcome
    first, group = between
    selection = select_beside(first, group, at.corrections.of_effect, outcome.factor)
    return SearchOutcome(first, selection, outcome.factor)


def _taken_up(given: SearchInput, at: FirstPass) -> SearchOutcome | None:
    """Return the outcome with what the model's correlated noise took up and is evident beside it; often None.

    Of records that are judged at the likeliest noise, it is sought at that of the model afterwards.
    """
    if given.records and not given.as_modelled:
        return None
    first = at.first
    evident = evident_in_correlated_noise(given.fitted, given.responses, first.prepared, first.candidates)
    if not evident:
        return None
    best = max(evident.values(), key=lambda each: each.log_factor)
    beside = replace(given, fitted=replace(given.fitted, h=best.h), as_modelled=True).screening()
    p = {place: math.exp(-each.log_factor) for place, each in evident.items()}
    outcome = _judged_beside(beside, first, p, at.corrections.of_effect(min(p.values())))
    # Noise of another family than the model's may explain the same.
    return outcome and replace(outcome, wandering="rival")
