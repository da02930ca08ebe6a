"""What to add next: the effects found, with those that the data do not tell from them, if a refit with them converges.

Where the data do not distinguish several effects, all of them are added: the posterior then holds every explanation.  A
refit with one of them alone would confirm it, and what another one would shift would be far off.  Where the odds decide
for a set of effects that rivals what the search selected, that set is added alone: beside it the others explain
nothing, and nearly singular models of that kind do not converge.
"""

from collections.abc import Iterable, Sequence

from imubayes.criticism import thresholds
from imubayes.criticism.addition import start_of_refit
from imubayes.criticism.diagnosis_record import Diagnosis
from imubayes.criticism.score_test import Candidate
from imubayes.criticism.stepwise_search import SearchResult
from imubayes.criticism.unexplained_structure import channels_of
from imubayes.criticism.verdict import MISSING, Suggestion, Verdict
from imubayes.inference.posterior_mode import find_mode


def suggestions(found: SearchResult, verdict: Verdict) -> list[Suggestion]:
    """Return what might be added next, the best first; a later one has fewer effects, in case a refit fails.

    The channels are named where they are not all on which the effects were screened.
    """
    if verdict == "noise_model":
        return [Suggestion(effects=(found.adopted[0].effect,), channels=None)] if found.adopted else []
    # What noise explains as well is not worth an addition before another record has told them apart.
    if verdict not in MISSING or found.wandering:
        return []
    groups = found.groups if found.unfinished else found.groups[: 1 + found.paired]
    leaders = [group.leader for group in groups]
    selected = [*leaders, *(member for group in groups for member in group.members[1:])]
    rival, log_odds = _best_rival(found)
    sets = [[*selected, *rival], selected, leaders]
    if log_odds > 0:
        sets.insert(1, rival)
    made = [_suggestion(found, each) for each in sets[log_odds > thresholds.DECISIVE_LOG_ODDS :]]
    return list({each.effects: each for each in made}.values())


def _best_rival(found: SearchResult) -> tuple[list[Candidate], float]:
    """Return the likeliest set in place of what was selected, with its log odds; none beside much that is missing."""
    if found.unfinished or not found.rivals:
        return [], 0.0
    return list(found.rivals[0].members), found.rivals[0].log_odds


def that_converges(found: SearchResult, diagnosis: Diagnosis, tried: Sequence[Suggestion]) -> Suggestion | None:
    """Return the first suggestion from whose start the refit converges, with what it leaves out of the first.

    It is the refit that `addition` makes.  A single suggestion is not tried: nothing would take its place.
    """
    fit = found.first.projection.fitted
    for place, each in enumerate(tried):
        left_out = tuple(name for name in tried[0].effects if name not in each.effects)
        if place == len(tried) - 1:
            return each.model_copy(update={"left_out": left_out})
        start = start_of_refit(fit, each.effects, each.channels, diagnosis)
        if bool(find_mode(start.model.problem, start.z, start.h).converged):
            return each.model_copy(update={"left_out": left_out})
    return None


def _suggestion(found: SearchResult, together: Sequence[Candidate]) -> Suggestion:
    effects = tuple(dict.fromkeys(member.effect for member in together))
    return Suggestion(effects=effects, channels=_channels_of_all(found, together))


def _channels_of_all(found: SearchResult, together: Sequence[Candidate]) -> tuple[str, ...] | None:
    """Return the channels on which candidates were found; None where their effects were screened on no others."""

    def channels(candidates: Iterable[Candidate]) -> set[str]:
        return {name for candidate in candidates for name in channels_of(found, candidate)}

    here, effects = channels(together), {candidate.effect for candidate in together}
    screened = channels(candidate for candidate in found.first.candidates if candidate.effect in effects)
    every = found.first.projection.fitted.model.campaign.channels
    return None if here == screened else tuple(channel.name for channel in every if channel.name in here)
