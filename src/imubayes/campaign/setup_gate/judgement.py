"""The judgement of a set-up: the mistakes that explain its outputs, or the runs that nothing explains.

The misfit of the linear model of plausible errors tells a campaign without gross mistakes.  There only the mistakes are
tried that such errors could conceal.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from imubayes.campaign.setup_gate.hidden_mistakes import hidden_mistakes
from imubayes.campaign.setup_gate.run_view import feels_the_earth_alone
from imubayes.campaign.setup_gate.search import DECISIVE, MOST_MISTAKES, Explanation, Search, equally_good
from imubayes.campaign.setup_gate.shown_steadiness import noise_as_rival
from imubayes.campaign.setup_gate.sizes import sized
from imubayes.campaign_data import Campaign

_STEPS = 3
_TURNED_FAR = 30.0
"""Misfit per output up to which squares of plausible rotations may make it; a larger one is that of a mistake."""


@dataclass(frozen=True)
class Judgement:
    """Outcome of the search.

    Attributes
    ----------
    mistakes : each with its equally good explanations, the best first; empty where there is none.
    misfit : of the set-up as stated, per output.
    unexplained : run → misfit per output of the runs that disagree, where no mistake explains it.
    """

    mistakes: tuple[tuple[Explanation, ...], ...] = ()
    misfit: float = 0.0
    unexplained: tuple[tuple[str, float], ...] = ()


def judge_setup(campaign: Campaign) -> Judgement:
    """Return the mistakes in the set-up of a campaign, if its outputs show any."""
    search = Search(campaign)
    if not search.views or not search.total.values:
        return Judgement()
    # Of tumbles a steady gyro tells one mistake from another where a poor one does not.
    tumbled = feels_the_earth_alone(campaign, search.views)
    ordinary = search.ordinary or _turned_far(search)
    single = [] if ordinary or tumbled else search.several_mistakes(1)
    if single and _more_than_noise(search, single) and (possible := _sized(campaign, single[0])):
        return Judgement((possible,), search.misfit)
    if (hidden := hidden_mistakes(campaign)) and (possible := _sized(campaign, equally_good(hidden, DECISIVE))):
        return Judgement((possible,), search.misfit)
    if ordinary:
        return Judgement((), search.misfit)
    if (found := search.several_mistakes(MOST_MISTAKES)) and _more_than_noise(search, found):
        return Judgement(tuple(found), search.misfit)
    return Judgement(misfit=search.misfit, unexplained=tuple(search.disagreements()))


def _turned_far(search: Search) -> bool:
    """Whether a campaign shows what its set-up says about mountings and tables that plausible errors turn far.

    Squares of rotations by some degrees are beyond what a model that is linear about zero leaves out.
    """
    if search.misfit > _TURNED_FAR:
        return False
    for _ in range(_STEPS):
        search = Search(search.campaign, views=search.views, centre=search.model.estimates(search.total))
    return search.ordinary


def _more_than_noise(search: Search, found: Sequence[tuple[Explanation, ...]]) -> bool:
    """Whether mistakes explain more than larger noise would."""
    noise = noise_as_rival(search.model, search.views, search.model.estimates(search.total))
    noisy = Search(search.campaign, noise, search.views)
    return sum(equal[0].gain for equal in found) > search.stated - noisy.stated + DECISIVE


def _sized(campaign: Campaign, equal: tuple[Explanation, ...]) -> tuple[Explanation, ...]:
    """Return explanations with their sizes, without those of sizes that cannot be."""
    found = [sized(campaign, each) for each in equal]
    return tuple(each for each in found if each.mistake.possible(each.size))
