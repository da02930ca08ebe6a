"""Selection of effects: the best candidate, projected out, and the next, then whether a pair explains the same better.

Forward selection takes the single effect that explains most.  If a pair without it is likelier than all that was
selected, it is exchanged for that pair; what was selected first remains a rival explanation.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from imubayes.criticism import thresholds
from imubayes.criticism.equivalent_effects import EquivalenceGroup, equivalence_group
from imubayes.criticism.multiple_testing import LookElsewhere
from imubayes.criticism.projection import Projection, orthonormal
from imubayes.criticism.rival_explanations import RivalEffects, acts_with, rival_pairs
from imubayes.criticism.score_test import Candidate, assess, noise_left, response_of, screen
from imubayes.criticism.search_input import Screening, screened


@dataclass(frozen=True)
class Selection:
    """Effects selected.

    Attributes
    ----------
    groups : one per effect, in order of evidence.
    last, rest : the last screening at the noise of the fit, and at the noise that is left.
    rivals : other sets of effects that the data do not exclude, the likeliest first; after an exchange, what was found
        before it leads.
    paired : whether the first two groups were selected together.
    unfinished : whether more effects are significant than one search selects, of which the first ones explain most of
        the variance of some stratum: the model lacks a great deal.  The groups are those first ones alone.
    """

    groups: tuple[EquivalenceGroup, ...]
    last: Screening
    rest: Screening
    rivals: tuple[RivalEffects, ...] = ()
    paired: bool = False
    unfinished: bool = False


def select_effects(at: Screening, corrected: LookElsewhere, factor: float = 1.0) -> Selection:
    """Return the effects that a screening shows, below `factor` times the threshold."""
    threshold = factor * thresholds.FALSE_ALARM_EFFECT
    forward = _forward(at, (), corrected, threshold)
    if len(forward.groups) > 1 and not forward.unfinished:
        forward = _by_another_name(at, forward, corrected, threshold)
    # Beside much that is still missing no two explanations can be weighed.
    if not forward.groups or forward.unfinished:
        return forward
    rivals = rival_pairs(at, [group.leader for group in forward.groups], _judged_noise(forward.last.projection))
    if rivals and rivals[0].log_odds > 0:
        exchanged = _forward(at, rivals[0].members, corrected, threshold)
        if not exchanged.unfinished and _explains_instead(exchanged, forward):
            before = RivalEffects(_replaced(at, forward, exchanged), 0.0)
            return replace(exchanged, rivals=_against(rivals[0], (before, *rivals[1:])), paired=True)
    return replace(forward, rivals=tuple(rivals))


def select_beside(at: Screening, group: EquivalenceGroup, corrected: LookElsewhere, factor: float) -> Selection:
    """Return a group that evidence of another kind names, and the effects that a screening shows beside it."""
    found = _forward(at, (group.leader,), corrected, factor * thresholds.FALSE_ALARM_EFFECT)
    return replace(found, groups=(group, *found.groups[1:]))


def _by_another_name(at: Screening, forward: Selection, corrected: LookElsewhere, threshold: float) -> Selection:
    """Return the selection that begins with an equivalent of the leader which is selected again beside it.

    An effect of one coefficient may be as significant as the cause, of which it is the larger part, at few degrees of
    freedom.  What alone leaves less to select is the simpler explanation.
    """
    first, *further = forward.groups
    again = set(first.effects) & {group.leader.effect for group in further} - {first.leader.effect}
    owners = set(first.leader.owners)
    likeliest = {
        each.effect: each for each in reversed(at.candidates) if each.effect in again and set(each.owners) >= owners
    }
    for own in likeliest.values():
        instead = _forward(at, (own,), corrected, threshold)
        if not instead.unfinished and len(instead.groups) < len(forward.groups):
            return instead
    return forward


def _explains_instead(exchanged: Selection, forward: Selection) -> bool:
    """Tell whether what a pair leads to explains what forward selection did: with fewer effects, or as two causes.

    Where one effect would do in place of either member, they are one cause, whose shape each of them mends; where the
    leader is found again beside them, they are no explanation.
    """
    first, second, *further = (set(group.effects) for group in exchanged.groups)
    leader = forward.groups[0].leader.effect
    two_causes = not first & second and not any(leader in effects for effects in further)
    return two_causes or len(exchanged.groups) < len(forward.groups)


def _replaced(at: Screening, forward: Selection, exchanged: Selection) -> tuple[Candidate, ...]:
    """Return the leaders that a pair was exchanged for: those that act with the first and are not found beside it."""
    first, again = forward.groups[0].leader, {group.leader.effect for group in exchanged.groups}
    leaders = [group.leader for group in forward.groups]
    return tuple(each for each in leaders if each.effect not in again and acts_with(at, each, first))


def _against(best: RivalEffects, others: Sequence[RivalEffects]) -> tuple[RivalEffects, ...]:
    """Return other explanations with their odds against the best, what was found first before the pairs."""
    relative = [replace(each, log_odds=each.log_odds - best.log_odds) for each in others]
    return tuple(each for each in relative if each.members and each.log_odds > -2 * thresholds.DECISIVE_LOG_ODDS)


def _forward(at: Screening, given: Sequence[Candidate], corrected: LookElsewhere, threshold: float) -> Selection:
    """Select the best candidate, project it out and screen again at the noise that is left, while one is significant.

    Given candidates are selected first, each of them beside the others.
    """
    groups, start = _beside_each_other(at, given, corrected), at
    for own in given:
        at = deflate(at, span_over_shapes(at, _same(at, own)))
    halved = [_halves_noise(start.projection, at.projection)] * len(groups)
    seen = _candidates_at_noise_left(at)
    while significant := [each for each in seen if corrected(each.p) < threshold]:
        if len(groups) == thresholds.MAX_EFFECTS:
            break
        leader, p = _same(at, significant[0]), corrected(min(candidate.p for candidate in seen))
        groups.append(equivalence_group(at.projection, leader, at.candidates, p))
        before, at = at, deflate(at, span_over_shapes(at, leader))
        halved.append(_halves_noise(before.projection, at.projection))
        seen = _candidates_at_noise_left(at)
    dominant = [*halved, False].index(False)
    unfinished = bool(significant) and dominant > 0
    # Beside what is still missing, smaller effects are corrections of its shape as likely as causes of their own.
    kept = groups[:dominant] if unfinished else groups
    return Selection(tuple(kept), at, at_noise_left(at), unfinished=unfinished)


def _halves_noise(before: Projection, after: Projection) -> bool:
    """Tell whether a projection leaves less than half of the variance of some stratum with enough freedom to tell."""
    ratio = _noise(after) / _noise(before)
    return bool(ratio[after.freedom >= thresholds.FREEDOM_TO_JUDGE].min(initial=1.0) < thresholds.LESS_NOISE)


def _judged_noise(projection: Projection) -> np.ndarray:
    """Return the variance of each stratum that has enough freedom, relative to the fit's; 1 of the others."""
    return np.where(projection.freedom >= thresholds.FREEDOM_TO_JUDGE, _noise(projection), 1.0)


def _noise(projection: Projection) -> np.ndarray:
    """Return the variance of each stratum, the rows of the priors last, relative to the fit's."""
    return noise_left(projection.strata.sums(projection.residual**2), projection.freedom)[0]


def _beside_each_other(at: Screening, given: Sequence[Candidate], corrected: LookElsewhere) -> list[EquivalenceGroup]:
    """Return the group of each given candidate where the others are projected out, the most significant first."""
    groups = []
    for own in given:
        beside = at
        for other in given:
            beside = beside if other is own else deflate(beside, span_over_shapes(at, other))
        leader = _same(beside, own)
        groups.append(equivalence_group(beside.projection, leader, beside.candidates, corrected(leader.p)))
    return sorted(groups, key=lambda group: group.leader.log_p)


def _same(at: Screening, candidate: Candidate) -> Candidate:
    """Return a candidate as another screening assesses it."""
    return assess(at.projection, *response_of(at.prepared, candidate))


def at_noise_left(at: Screening) -> Screening:
    """Return the screening at the noise that is left, where that is much less than a missing effect let it seem.

    Priors weigh less against less noise.  With the scale of the fit they bend what is left, which then looks like
    further effects.
    """
    root = _root_of_less_noise(at.projection)
    return at if root is None else at_scales(at, root)


def at_scales(at: Screening, root: np.ndarray) -> Screening:
    """Return the screening of rows that were multiplied by `root`, (R,)."""
    reweighted = at.projection.reweighted(root)
    responses = [each.reweighted(reweighted, root) for each in at.prepared]
    forms = [each.reweighted(reweighted, root) for each in at.forms]
    return screened(reweighted, responses, forms, [each.reweighted(root) for each in at.feature_sets])


def _candidates_at_noise_left(at: Screening) -> Sequence[Candidate]:
    """Return the candidates of `at_noise_left`, without the forms that take most of its time."""
    root = _root_of_less_noise(at.projection)
    if root is None:
        return at.candidates
    reweighted = at.projection.reweighted(root)
    return screen(reweighted, [each.reweighted(reweighted, root) for each in at.prepared])


def _root_of_less_noise(projection: Projection) -> np.ndarray | None:
    """Return what rows, (R,), are to be multiplied by for the noise that is left; None where that is hardly less."""
    variance = _noise(projection)
    return None if variance.min() > thresholds.LESS_NOISE else 1 / np.sqrt(projection.strata.at_rows(variance))


def span_over_shapes(at: Screening, leader: Candidate) -> np.ndarray:
    """Return the directions of a candidate at every shape scanned, (R, d): the true shape lies between them."""
    names = {coefficient.parameter.name for coefficient in leader.coefficients}
    own = leader.score.span
    columns, lengths = [np.zeros((len(own), 0))], [np.zeros(0)]
    for each in at.prepared:
        if each.response.scan.effect == leader.effect and each.response.scan != leader.scan:
            chosen = [place for place, c in enumerate(each.response.coefficients) if c.parameter.name in names]
            projected = each.projected[:, chosen]
            columns.append(projected - own @ (own.T @ projected))
            lengths.append(np.linalg.norm(each.whitened[:, chosen], axis=0))
    others = orthonormal(np.concatenate(columns, axis=1), np.concatenate(lengths), thresholds.SHAPE_RETAINED_MIN)
    # Its own directions are projected out however little of them the model leaves: the search would find them again.
    return np.concatenate([own, others], axis=1)


def deflate(at: Screening, span: np.ndarray) -> Screening:
    """Return the screening after some orthonormal directions, (R, d), were projected out."""

    def less(columns: np.ndarray) -> np.ndarray:
        return columns - span @ (span.T @ columns)

    responses = [replace(each, projected=less(each.projected)) for each in at.prepared]
    forms = [replace(each, columns=less(each.columns)) for each in at.forms]
    return screened(at.projection.without(span), responses, forms, at.feature_sets)
