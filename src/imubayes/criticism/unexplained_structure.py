"""Whether the effects that were found explain the structure, or only resemble its cause."""

from collections.abc import Iterable, Sequence

from imubayes.criticism import thresholds
from imubayes.criticism.effect_covariates import covariates_of
from imubayes.criticism.equivalent_effects import EquivalenceGroup, unexplained_chi2
from imubayes.criticism.localised_structure import STEP
from imubayes.criticism.score_test import Candidate
from imubayes.criticism.search_outcome import Significant
from imubayes.criticism.stepwise_search import SearchResult
from imubayes.effects.base import Effect, Order


def unexplained_structure(found: SearchResult) -> list[Significant]:
    """Return the structure that no effect of the catalogue explains; empty where they do."""
    if not found.groups:
        return list(found.structures)
    leader = found.groups[0].leader
    if found.unfinished:
        return _steps_beyond_leader(found, leader)  # the rest may be explained by the effects still to come
    dominant = _larger_than_leader(found, leader) or _steps_beyond_leader(found, leader)
    if dominant:
        return dominant
    if _saturates(found, leader):
        return []  # it bends the signal at its own size: a linear response always leaves structure
    if any(_only_resembles(found, leader, owner) for owner in leader.owners):
        return _concerning(found, leader, found.structures)
    # What remains has to be worth something beside what was explained: a large effect shows its smallest imperfection.
    least = thresholds.REMAINDER_SHARE * leader.delta_chi2
    remaining = [pair for pair in _concerning(found, leader, found.remaining) if pair[0].score.delta_chi2 > least]
    if any(len(_acting_on(found, owner)) > 1 for owner in leader.owners):
        return remaining
    return [(structure, p) for structure, p in remaining if p < thresholds.AGAINST_SINGLE_NAME_P]


def scatter_remains(found: SearchResult) -> bool:
    """Tell whether rows on which the leader acts still scatter more than recorded, by more than a trifle beside it.

    A wrong effect takes a part of what the cause does, and the rest may have no plain form.  It may as well be noise
    from row to row: the leader remains the best name, but not the only explanation.
    """
    leader = found.groups[0].leader
    channels = channels_of(found, leader)
    left = sum(each.excess_chi2 for each in found.record.comparisons if not channels or each.channel in channels)
    return left > thresholds.REMAINDER_SHARE * leader.delta_chi2


def channels_of(found: SearchResult, candidate: Candidate) -> tuple[str, ...]:
    """Return the channels among the owners of a candidate."""
    names = {channel.name for channel in found.first.projection.fitted.model.campaign.channels}
    return tuple(owner for owner in candidate.owners if owner in names)


def mostly_step(channel: str, structures: Iterable[Significant]) -> bool:
    """Tell whether a step in one run is most of the structure of a channel."""
    own = [structure for structure, _ in structures if structure.channel == channel]
    steps = [structure.score.delta_chi2 for structure in own if structure.test == STEP]
    largest = max(structure.score.delta_chi2 for structure in own)
    return max(steps, default=0.0) > thresholds.MAIN_SHARE * largest


def simplest(structures: Sequence[Significant]) -> list[Significant]:
    """Return the structures without products of a covariate that explains the channel better alone."""
    kept: list[Significant] = []
    alone: set[tuple[str, str]] = set()
    for structure, p in structures:
        names = {(structure.channel, covariate.name) for covariate in structure.covariates}
        if len(structure.covariates) == 1:
            alone |= names
        if len(structure.covariates) == 1 or not names & alone:
            kept.append((structure, p))
    return kept


def _larger_than_leader(found: SearchResult, leader: Candidate) -> list[Significant]:
    """Return remaining structure that is larger than what the leader explains: the leader took a part of it.

    It counts on every channel.  A motion that the catalogue lacks acts on gyros and accelerometers alike, and an effect
    of the accelerometers may imitate its smaller part.  At few degrees of freedom a form leaves next to nothing of the
    noise by chance, and its Δχ² is then large without being significant.
    """
    return [
        (structure, p)
        for structure, p in found.remaining
        if p < thresholds.AGAINST_SINGLE_NAME_P and structure.score.delta_chi2 > leader.delta_chi2
    ]


def _steps_beyond_leader(found: SearchResult, leader: Candidate) -> list[Significant]:
    """Return steps that dominate the leader: nothing in the catalogue happens once."""
    steps = [pair for pair in _of_kind(found, leader, found.structures) if pair[0].test == STEP]
    least = thresholds.STEP_DOMINATES * leader.delta_chi2
    return [pair for pair in steps if pair[0].score.delta_chi2 > least]


def _saturates(found: SearchResult, leader: Candidate) -> bool:
    member = found.first.projection.fitted.model.registry.effects[leader.effect]
    return issubclass(member, Effect) and member.order >= Order.LIMIT


def _only_resembles(found: SearchResult, leader: Candidate, owner: str) -> bool:
    """Tell whether a channel needs the same names again, a rival of the leader, or too many effects."""
    acting = _acting_on(found, owner)
    again = any(set(group.effects) & set(found.groups[0].effects) for group in acting[1:])
    rival = any(_rivals(found, group.leader, leader) for group in acting[1:])
    return again or rival or _crowded(found, leader, acting)


def _crowded(found: SearchResult, leader: Candidate, acting: Sequence[EquivalenceGroup]) -> bool:
    """Tell whether so many effects go with what the leader goes with that they only approximate one cause together.

    One of other covariates alone is a cause of its own.
    """
    own = goes_with(found, leader)
    shared = [goes_with(found, group.leader) for group in acting]
    return sum(not each or not own or bool(own & each) for each in shared) >= thresholds.CROWDED_EFFECTS


def goes_with(found: SearchResult, candidate: Candidate) -> frozenset[str]:
    """Return the covariates of an effect on channels; empty where they are not known."""
    model = found.first.projection.fitted.model
    kinds = {channel.kind for channel in model.campaign.channels if channel.name in candidate.owners}
    member = model.registry.effects[candidate.effect]
    return frozenset[str]().union(*(each for kind in kinds for each in covariates_of(member, kind)))


def _acting_on(found: SearchResult, owner: str) -> list[EquivalenceGroup]:
    return [group for group in found.groups if owner in group.leader.owners]


def _rivals(found: SearchResult, other: Candidate, leader: Candidate) -> bool:
    """Tell whether another effect on the same channels could explain most of what the leader does.

    Where both are needed they correct each other's shape, and neither is likely to be the cause: |Ω| and Ω² together
    approximate a root of |Ω| well.
    """
    shared = set(leader.owners) & set(other.owners)
    rivals = [each for each in found.first.candidates if each.effect == other.effect and set(each.owners) >= shared]
    shares = (unexplained_chi2(found.first.projection, leader, rival) for rival in rivals)
    return any(left < (1 - thresholds.MAIN_SHARE) * whole for left, whole in shares)


def _concerning(found: SearchResult, leader: Candidate, structures: Sequence[Significant]) -> list[Significant]:
    """Return the structures on the leader's channels; all where it acts on a table or mounting."""
    everywhere = not channels_of(found, leader)
    return [pair for pair in structures if everywhere or pair[0].channel in leader.owners]


def _of_kind(found: SearchResult, leader: Candidate, structures: Sequence[Significant]) -> list[Significant]:
    """Return the structures on channels of the leader's kinds; all where it acts on a table or mounting."""
    kinds = {channel.name: channel.kind for channel in found.first.projection.fitted.model.campaign.channels}
    own = {kinds[name] for name in channels_of(found, leader)} or set(kinds.values())
    return [pair for pair in structures if kinds[pair[0].channel] in own]
