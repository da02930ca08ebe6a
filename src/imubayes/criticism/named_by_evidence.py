"""Effects that the evidence names where the score tests are silent.

A score test takes the noise scales as free: with few runs a scatter between them absorbs an effect, and then no
candidate is significant.  The evidence weighs the same scatter against its prior, the recorded noise and the sister
channels (`imubayes.criticism.evidence`).
"""

from dataclasses import replace

from imubayes.criticism import thresholds
from imubayes.criticism.equivalent_effects import EquivalenceGroup, unexplained_chi2
from imubayes.criticism.evidence.evidence_record import EffectSlot, Evidence
from imubayes.criticism.score_test import Candidate
from imubayes.criticism.stepwise_search import SearchResult


def named_by_evidence(found: SearchResult, evidence: Evidence | None) -> SearchResult:
    """Return the outcome with the effects that the evidence names, where the search found nothing."""
    if evidence is None or found.groups or found.structures or not evidence.names_effects:
        return found
    groups = [group for slot in evidence.slots if (group := _group(found, slot, evidence)) is not None]
    return replace(found, groups=tuple(groups), adopted=(), paired=len(groups) == 2)


def _group(found: SearchResult, slot: EffectSlot, evidence: Evidence) -> EquivalenceGroup | None:
    """Return the candidates of a slot as a group; its p-value is the probability that nothing is missing."""
    members = [one for each in slot.candidates if (one := _candidate(found, each.effect, each.channels)) is not None]
    if not members:
        return None
    left = [unexplained_chi2(found.first.projection, members[0], each)[0] for each in members]
    p = min(evidence.of("nothing").probability, 0.5 * thresholds.FALSE_ALARM)
    return EquivalenceGroup(tuple(members), p, (0.0, *left[1:]))


def _candidate(found: SearchResult, effect: str, owners: tuple[str, ...]) -> Candidate | None:
    """Return the candidate of an effect on some channels, else the strongest of that effect."""
    own = [each for each in found.first.candidates if each.effect == effect]
    same = [each for each in own if set(each.owners) == set(owners)]
    return max(same or own, key=lambda each: each.score.log_likelihood_gain, default=None)
