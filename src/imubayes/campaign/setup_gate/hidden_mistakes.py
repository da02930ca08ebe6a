"""Mistakes that plausible errors could conceal: the unit is taken for as steady as its outputs show.

A small input, such as the Earth rate or what a temperature does, shows in a good unit only.
"""

import math
from collections.abc import Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np

from imubayes.campaign.setup_gate.evidence import ErrorModel
from imubayes.campaign.setup_gate.mistakes import MISTAKES, Mistake, TableAzimuth, TableElevation, TableZero
from imubayes.campaign.setup_gate.nominal_scales import NominalScale
from imubayes.campaign.setup_gate.plausible_errors import POOR, Steadiness
from imubayes.campaign.setup_gate.run_view import feels_the_earth_alone, turns_through, views_of
from imubayes.campaign.setup_gate.search import DECISIVE, ORDINARY_ERROR, Explanation, Search
from imubayes.campaign.setup_gate.shown_steadiness import shown_steadiness
from imubayes.campaign.setup_gate.site_mistakes import LATITUDE_MISTAKES, LatitudeSign, LatitudeValue
from imubayes.campaign.setup_gate.temperature_mistakes import TEMPERATURE_MISTAKES, TemperatureReversed
from imubayes.campaign.setup_gate.unit_mistakes import AngleUnit, ChannelGain
from imubayes.campaign_data import Campaign

STOPPING = 100.0
"""Support beyond which a hidden mistake stops a fit; up to it a warning says it.  Its evidence rests on how steady the
unit is taken to be, which errors that no model lists make too much of."""
DECISIVE_LATITUDE = 8.0
"""Support from which the sign of the latitude is named where several gyros show it: a single suspected mistake.  Up to
`DECISIVE` it is a warning."""
MOST_MISFIT_LEFT, MOST_MISFIT_OF_TEMPERATURES = 2.0, 1.25
"""Misfit per output of a unit that is taken for steady, up to which a correction explains its outputs, and up to which
one of temperatures does.  Of a unit that is taken for too steady any correction explains something."""
WORTH_TRYING = 4.0
"""Gain of a hidden mistake in a unit as steady as its outputs show, from which it is tried in a steadier one."""
LEAST_TURN = math.radians(25.0)
"""Least error of an azimuth that is doubted where plausible errors would explain the outputs as well: the Earth rate
of a tactical gyro tells no less."""
LEAST_LATITUDE = math.radians(15.0)
"""The same of a latitude: what a linear model leaves out moved that of a valid campaign by 9 degrees."""
LEAST_TILT = math.radians(2.0)
"""The same of an elevation: smaller ones pass for errors that the linear model leaves out."""
LEAST_ZERO = math.radians(4.0)
"""The same of a zero, beside which a loose mounting may be turned about the axis."""
RIVALLED = 49.0
"""Gain per channel beyond which a mistake is said, as a warning, although other biases in a run explain the outputs as
well: a bias off by seven plausible standard deviations.  Valid campaigns gained up to 26."""
LEVELS = (
    (1.0, 1.0, 0), (3.0, 3.0, 0), (1.0, 1.0, 1), (1.0, 0.3, 2), (0.3, 0.3, 2), (1.0, 0.1, 3), (0.3, 0.1, 4),
    (1.0, 0.03, 5),
)  # fmt: skip
"""Degrees of steadiness: factors of what rows leave out and of offsets of runs, to what each channel shows by itself,
and the degree below, where a mistake has to be supported as well; the first is a poor unit.  A mistake makes channels
look less steady than they are."""
LEVELS_OF_TUMBLES = ((1.0, 1.0, 0), (0.3, 0.3, 0), (0.1, 0.1, 1), (0.03, 0.03, 2), (0.01, 0.01, 3))
"""The same, to a poor unit, of gyros that feel the Earth rate alone: few rows show no steadiness of their own.  That a
gyro repeats from run to run as well as from row to row is not known: offsets of runs as in a poor unit rival a mistake
that does not gain more by `STOPPING`."""
_STEPS = 4


class Tried(NamedTuple):
    """A correction at a level of steadiness, with −2 log of its evidence."""

    score: float
    level: int
    found: Explanation


def hidden_mistakes(campaign: Campaign) -> list[Explanation]:
    """Return the mistakes that explain the outputs of a campaign decisively although plausible errors would do.

    A small input, such as the Earth rate or what a temperature does, shows in a good unit only.  How good it is follows
    from the outputs themselves: of several degrees of steadiness that of most evidence is taken, for the set-up as
    stated and for each correction.  They are factors to what each channel shows by itself.
    """
    levels = SteadinessLevels(campaign)
    first, stated = levels.of_most_evidence()
    views = levels[0].views
    concealed = (*LATITUDE_MISTAKES, TableAzimuth, TableElevation, *TEMPERATURE_MISTAKES)
    if feels_the_earth_alone(campaign, views) or all(turns_through(view) for view in views):
        concealed = (*MISTAKES, ChannelGain, AngleUnit, NominalScale, *LATITUDE_MISTAKES, *TEMPERATURE_MISTAKES)
    suspected = [each for kind in concealed for each in kind.suspected(campaign, views) if _is_of_equipment(each)]
    tried = levels.tried(suspected, first)
    best = (levels.steadiest(mistake, own, stated) for mistake, own in zip(suspected, tried, strict=True))
    found = [each for each in best if each is not None]
    return [each for each in found if _is_sayable(each, campaign) and not levels[0].passes_for_noise(each.mistake)]


def _is_sayable(found: Explanation, campaign: Campaign) -> bool:
    """Whether a mistake is supported well enough to be said."""
    if found.support <= _bar(found.mistake, campaign) or _small(found, campaign):
        return False
    return not found.rivalled or found.gain > RIVALLED * len(campaign.channels)


class SteadinessLevels:
    """The searches in units of rising steadiness, each made when it is first asked for: a poor unit, and `LEVELS`."""

    def __init__(self, campaign: Campaign):
        self.campaign = campaign
        self.shown, self.centre = POOR, None
        tumbled = feels_the_earth_alone(campaign, views_of(campaign))
        self.levels = LEVELS_OF_TUMBLES if tumbled else LEVELS
        # Mountings off by a degree need a second step, and a steady unit tells them better than a poor one.
        for step in range(_STEPS):
            search = Search(campaign, self.shown, centre=self.centre)
            if step and not tumbled:
                poor = ErrorModel(campaign, centre=self.centre)
                self.shown = shown_steadiness(poor, search.views, search.model.estimates(search.total))
            self.centre = search.model.estimates(search.total)
        self.tumbled = tumbled
        self.search = Search(campaign, centre=self.centre)
        self.made: dict[int, Search] = {}

    def __getitem__(self, level: int) -> "Search":
        if level not in self.made:
            steadiness = self.shown.poor() if level == 0 else self.shown.times(*self.levels[level][:2])
            self.made[level] = self.search.as_steady_as(steadiness)
        return self.made[level]

    @cached_property
    def unsteady(self) -> float:
        """−2 log of the most evidence for the set-up as stated with offsets of runs as in a poor unit."""
        steady = [Steadiness(POOR.rows * rows) for rows, _, _ in self.levels]
        return min(self.search.as_steady_as(each).stated for each in steady)

    def of_most_evidence(self) -> tuple[int, float]:
        """Return the level of most evidence for the set-up as stated that fits, and −2 log of the most evidence."""
        scores: dict[int, float] = {}
        for level, (_, _, below) in enumerate(self.levels):
            if below < 1 or (below in scores and self[below].misfit < MOST_MISFIT_LEFT):
                scores[level] = self[level].stated
        adequate = [level for level in scores if self[level].misfit < MOST_MISFIT_LEFT] or [0]
        return min(adequate, key=lambda level: scores[level]), min(scores.values())

    def steadiest(self, mistake: Mistake, tried: Sequence[Tried], stated: float) -> Explanation | None:
        """Return the correction of a mistake at the level of most evidence; None where it explains nothing.

        The outputs of a unit look no steadier with a mistake than without, so that no level below the `first`, that of
        most evidence for the set-up as stated, is tried.  What a linear model leaves out is not independent from row to
        row, and the steadiest unit makes too much of it: one level below the mistake has to be supported as well.

        No correction may ask of a unit what no unit does.  A wrong rate shrinks the errors that a rate makes, and gains
        evidence by that while a bias takes its place.  A column is said to run backwards
        where outputs that may drift tell it as well.

        Parameters
        ----------
        tried : the correction at each level where it fits.
        stated : −2 log evidence of the set-up as stated.
        """
        if not tried:
            return None
        score, level, best = min(tried, key=lambda each: each.score)
        gain, rival = stated - score, stated
        if self.tumbled:
            rival = self.unsteady - (STOPPING - DECISIVE)
        if isinstance(mistake, TEMPERATURE_MISTAKES):
            rival = min(self[each.level].rival(mistake) for each in tried)
            if isinstance(mistake, TemperatureReversed):
                drifting = np.array([self[each.level].with_drift(mistake) for each in tried])
                beside = float(np.subtract(*drifting.min(axis=0)))
                if beside < 0:
                    return None
                rival = min(rival, score) if beside < DECISIVE else rival
        elif gain > DECISIVE_LATITUDE and not self._holds_below(level, mistake):
            return None
        if gain > DECISIVE_LATITUDE and not self[0].error_left(mistake, best.size) < ORDINARY_ERROR:
            return None
        return Explanation(mistake, best.size, gain, best.misfit, max(0.0, stated - rival), STOPPING)

    def tried(self, mistakes: Sequence[Mistake], first: int) -> list[list[Tried]]:
        """Return the correction of each mistake at each level, from the first, where it fits."""
        found: list[list[Tried]] = [[] for _ in mistakes]
        fitting, going = [set(range(first)) for _ in mistakes], list(range(len(mistakes)))
        for level in range(first, len(self.levels)):
            due = [k for k in going if level == first or self.levels[level][2] in fitting[k]]
            explained = self[level].explain([mistakes[k] for k in due]) if due else []
            for k, each in zip(due, explained, strict=True):
                if each.gain < WORTH_TRYING and not found[k] and not isinstance(each.mistake, LatitudeSign):
                    going.remove(k)
                elif each.misfit < _most_misfit(each.mistake):
                    fitting[k].add(level)
                    found[k].append(Tried(self[level].stated - each.gain, level, each))
        return found

    def _holds_below(self, level: int, mistake: Mistake) -> bool:
        # A sign has no size that would adapt to what is left out.
        bar = 0.0 if isinstance(mistake, LatitudeSign) else DECISIVE
        below = self.levels[level][2]
        return not below or self[below].explain([mistake])[0].support > bar


def _most_misfit(mistake: Mistake) -> float:
    return MOST_MISFIT_OF_TEMPERATURES if isinstance(mistake, TEMPERATURE_MISTAKES) else MOST_MISFIT_LEFT


def _is_of_equipment(mistake: Mistake) -> bool:
    """Whether a mistake is that of a table as a whole, where it is one of elevation."""
    return not (isinstance(mistake, TableElevation) and mistake.scope.section == "run")


def _small(found: Explanation, campaign: Campaign) -> bool:
    if isinstance(found.mistake, LatitudeValue):
        return abs(found.size - campaign.site.latitude) < LEAST_LATITUDE
    if isinstance(found.mistake, NominalScale):
        return not found.mistake.stops(found.size)
    least = LEAST_ZERO if isinstance(found.mistake, TableZero) else LEAST_TILT
    least = LEAST_TURN if isinstance(found.mistake, TableAzimuth) else least
    return isinstance(found.mistake, (TableAzimuth, TableElevation, TableZero)) and abs(found.size) < least


def _bar(mistake: Mistake, campaign: Campaign) -> float:
    several = len(campaign.of_kind("gyro")) > 1
    return DECISIVE_LATITUDE if isinstance(mistake, LatitudeSign) and several else DECISIVE
