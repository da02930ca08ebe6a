"""Sizes of mistakes and their uncertainties, in a unit as steady as its outputs show without the mistake.

The search takes every unit for a poor one, and linearises about mountings as stated.  Once a mistake is found,
mountings, tables, steadiness and the size itself are estimated together: a zero of a table is told no better than the
mountings are, and an azimuth no better than the g-sensitivity of the gyros lets the Earth rate show it.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from imubayes.campaign.setup_gate.evidence import ErrorModel
from imubayes.campaign.setup_gate.hidden_mistakes import LEVELS_OF_TUMBLES
from imubayes.campaign.setup_gate.mistakes import Mistake, TableAzimuth, TableElevation, TableZero
from imubayes.campaign.setup_gate.normal_terms import stacked_terms
from imubayes.campaign.setup_gate.outer_mistakes import AxisZero
from imubayes.campaign.setup_gate.plausible_errors import POOR, Steadiness
from imubayes.campaign.setup_gate.run_view import RunView, views_of
from imubayes.campaign.setup_gate.search import Explanation, Search
from imubayes.campaign.setup_gate.shown_steadiness import shown_steadiness
from imubayes.campaign.setup_gate.site_mistakes import LatitudeValue
from imubayes.campaign.setup_gate.wrong_rates import RateFactor
from imubayes.campaign_data import Campaign

SIZED = (TableZero, AxisZero, TableElevation, TableAzimuth, LatitudeValue, RateFactor)
"""Mistakes whose size is an angle, or a ratio, of which the remedy writes the value."""
_STEP = math.radians(0.01)  # of the derivative by the size; a ratio is as small a number as an angle in rad
_APART = math.radians(1.0)
_LONGEST = math.radians(10.0)  # of one step to the best size
_WIDEST = math.radians(30.0)  # standard deviation; beyond, the evidence is no parabola of the size
_STEPS = 5
_TUMBLED = tuple(POOR.times(rows, runs) for rows, runs, _ in LEVELS_OF_TUMBLES)
_SETTLED = 0.05  # standard deviations


@dataclass(frozen=True)
class _Bowl:
    """−2 log of the evidence at a size, and the size of most evidence nearby with its standard deviation."""

    least: float
    best: float
    sd: float


def sized(campaign: Campaign, found: Explanation) -> Explanation:
    """Return an explanation with the size of most evidence nearby, and its uncertainty."""
    if not isinstance(found.mistake, SIZED):
        return found
    views = views_of(campaign)
    steadiness = _shown(campaign, found.mistake.removed(views, found.size))
    size, bowl = found.size, _bowl(campaign, steadiness, found.mistake, views, found.size)
    if bowl is None:
        return found
    usual = [each for each in found.mistake.usual(views) if abs(math.remainder(each - size, 2 * math.pi)) < _STEP]
    for _ in range(0 if usual else _STEPS):
        nearer = size + float(np.clip(bowl.best - size, -_LONGEST, _LONGEST))
        tried = _bowl(campaign, steadiness, found.mistake, views, nearer)
        if tried is None or tried.least > bowl.least:
            break
        size, bowl = nearer, tried
        if abs(bowl.best - size) < _SETTLED * bowl.sd:
            break
    return replace(found, size=_as_usual(found.mistake, views, size, bowl), uncertainty=bowl.sd)


def _as_usual(mistake: Mistake, views: Sequence[RunView], size: float, bowl: _Bowl) -> float:
    """Return a usual size in place of the best one where the outputs hardly tell the two."""
    for usual in mistake.usual(views):
        off = math.remainder(usual - size, 2 * math.pi)
        if abs(off) < mistake.usual_within and (off / bowl.sd) ** 2 < mistake.as_usual:
            return size + off
    return size


def _shown(campaign: Campaign, views: Sequence[RunView]) -> Steadiness:
    """Return how steady the outputs show the channels to be with a mistake corrected."""
    steadiness, centre = POOR, None
    for step in range(3):
        search = Search(campaign, steadiness, views, centre)
        errors = search.model.estimates(search.total)
        if search.model.squares:
            return min(_TUMBLED, key=lambda each: Search(campaign, each, views, errors).stated)
        if step:
            steadiness = shown_steadiness(ErrorModel(campaign, centre=centre), views, errors)
        centre = errors
    return steadiness


def _bowl(
    campaign: Campaign, steadiness: Steadiness, mistake: Mistake, views: Sequence[RunView], size: float
) -> _Bowl | None:
    """Return the evidence near a size, with all other errors at their best; None where the outputs do not tell it."""
    corrected = mistake.removed(views, size)
    search, centre = Search(campaign, steadiness, corrected), np.zeros(0)
    for _ in range(2):
        centre = search.model.estimates(search.total)
        search = Search(campaign, steadiness, corrected, centre)
    model = search.model
    seen = model.seen_of(corrected)
    # How the size moves the outputs less what is predicted with mounting and table at the centre.
    rates = [
        (other.without_shared(centre).error - one.without_shared(centre).error) / _STEP
        for other, one in zip(model.seen_of(mistake.removed(views, size + _STEP)), seen, strict=True)
    ]

    def evidence(apart: float) -> float:
        shifted = [replace(one, error=one.error + apart * rate) for one, rate in zip(seen, rates, strict=True)]
        terms = stacked_terms([model.terms_of(each) for each in shifted]).total()
        return float(model.score(terms, search.g_sensitivity))

    low, middle, high = evidence(-_APART), evidence(0.0), evidence(_APART)
    bend = (low - 2 * middle + high) / _APART**2
    if not bend > 2 / _WIDEST**2:
        return None
    return _Bowl(middle, size - (high - low) / (2 * _APART) / bend, math.sqrt(2 / bend))
