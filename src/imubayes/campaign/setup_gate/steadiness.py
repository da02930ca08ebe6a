"""How steady the outputs show a unit to be, the mistakes that only a steady unit shows, and the sizes of mistakes.

A small input, such as the Earth rate or what a temperature does, shows in a good unit only.  Mistakes that plausible
errors could conceal are found by taking the unit for as steady as its outputs show.  The steadiness of a channel is its
noise, what single rows leave out, and offsets of runs.  Each channel is judged by itself, with mountings and tables as
the whole campaign shows them.

The search takes every unit for a poor one, and linearises about mountings as stated.  Once a mistake is found,
mountings, tables, the steadiness without the mistake, and the size with its uncertainty are estimated together: the
zero of a table is determined no better than the mountings are, and an azimuth no better than the g-sensitivity of the
gyros lets the Earth rate show it.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from imubayes.campaign.setup_gate.catalogue import MISTAKES
from imubayes.campaign.setup_gate.equipment_mistakes import DECISIVE, RIVALLED, Concealed, Mistake, TableElevation
from imubayes.campaign.setup_gate.error_model import (
    G_SENSITIVITIES,
    POOR,
    Steadiness,
    stacked_terms,
    weighted,
)
from imubayes.campaign.setup_gate.evidence import ErrorModel, Seen
from imubayes.campaign.setup_gate.explanations import Explanation, told_by_name
from imubayes.campaign.setup_gate.file_mistakes import OtherUnit
from imubayes.campaign.setup_gate.reading_mistakes import DECISIVE_LATITUDE, LatitudeSign
from imubayes.campaign.setup_gate.search import ORDINARY_ERROR, Search
from imubayes.campaign.setup_gate.setup_view import RunView, feels_the_earth_alone, turns_through, views_of
from imubayes.campaign.setup_gate.thermal_mistakes import OfTemperatures, TemperatureReversed, TemperatureValue
from imubayes.foundations.campaign_data import Campaign

FACTORS = (10.0, 3.0, 1.0, 0.3, 0.1, 0.03, 0.01, 0.003, 0.001)
"""Factors of offsets of runs, and of what a linear model leaves out, that are tried."""
LOWER_NOISE = (1.0, 0.6, 0.3)
"""Noise of a channel over what the campaign states that is tried if no rows repeat a position."""
MORE_NOISE = (1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1000.0, 3000.0)
"""The same that is tried in place of a mistake in the set-up."""
_LEAST_DIFFERENCES = 8
_MEDIAN = 0.4549  # of χ² with one degree of freedom


def shown_steadiness(model: ErrorModel, views: Sequence[RunView], errors: np.ndarray) -> Steadiness:
    """Return the steadiness of most evidence for each channel.

    Parameters
    ----------
    model : of a poor unit, linear about errors near those that the campaign shows.
    errors : that the campaign shows, shape (P,).
    """
    own = errors[: model.own * len(model.channels)].reshape(-1, model.own)
    seen = [each.without_shared(errors) for each in model.seen_of(views)]
    noise, known = _noise(model, seen, views, own)
    sd = model.widths_with(G_SENSITIVITIES[-1])[: own.size].reshape(own.shape)
    one = np.ones(len(own))
    rows = _best(FACTORS, lambda factor: _evidence(model, seen, sd, Steadiness(factor * one, one, noise)))
    runs = _best(FACTORS, lambda factor: _evidence(model, seen, sd, Steadiness(rows, factor * one, noise)))
    if not known.all():
        lower = _best(LOWER_NOISE, lambda factor: _evidence(model, seen, sd, Steadiness(rows, runs, factor * one)))
        noise = np.where(known, noise, lower)
    return Steadiness(rows, runs, noise)


def noise_as_rival(model: ErrorModel, views: Sequence[RunView], errors: np.ndarray) -> Steadiness:
    """Return the noise of each channel, no less than stated, with which the outputs fit the set-up as stated best."""
    seen = [each.without_shared(errors) for each in model.seen_of(views)]
    sd = model.widths_with(G_SENSITIVITIES[-1])[: model.own * len(model.channels)].reshape(-1, model.own)
    one = np.ones(len(sd))
    noise = _best(MORE_NOISE, lambda factor: _evidence(model, seen, sd, Steadiness(one, one, factor * one)))
    return Steadiness(noise=noise)


def _best(factors: tuple[float, ...], evidence: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """Return the factor of least −2 log evidence for each channel, (K,); the evidence is of factors (F, 1)."""
    return np.array(factors)[np.argmin(evidence(np.array(factors)[:, None]), axis=0)]


def _evidence(model: ErrorModel, seen: Sequence[Seen], own: np.ndarray, steadiness: Steadiness) -> np.ndarray:
    """Return −2 log evidence of each channel by itself, up to a constant, with each of F steadinesses, shape (F, K)."""
    noise, rows = (np.asarray(each)[..., None] for each in (steadiness.noise, steadiness.rows))
    spread = (model.run_offset * steadiness.runs)[..., None]
    count = model.own
    moments, score = np.zeros((1, len(own), count + 1, count + 1)), np.zeros((1, len(own)))
    for run in seen:
        variance = noise**2 * model.white(run) + rows**2 * model.left_out(run) + run.unknown
        weight = np.where(run.there, 1 / variance, 0.0)
        found = weighted(run.design[:, :, :count], run.error, weight, np.ones_like(run.along), spread)
        moments = moments + found.moments
        score = score + found.volume + np.sum(np.where(run.there, np.log(variance), 0.0), axis=-1)
    lower = np.linalg.cholesky(np.eye(count) + own[:, :, None] * moments[..., :-1, :-1] * own[:, None, :])
    solved = np.linalg.solve(lower, (own * moments[..., :-1, -1])[..., None])[..., 0]
    score = score + moments[..., -1, -1] - np.sum(solved**2, axis=-1)
    return score + 2 * np.log(np.diagonal(lower, axis1=-2, axis2=-1)).sum(axis=-1)


def _noise(
    model: ErrorModel, seen: Sequence[Seen], views: Sequence[RunView], own: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the noise of each channel over the stated one, and whether successive rows in one position show it.

    Half the median square of the differences of their residuals over that of a normal deviate; 1 if these are few.
    """
    found: list[np.ndarray] = []
    for run, view in zip(seen, views, strict=True):
        left = run.error - (run.design[:, :, : own.shape[1]] @ own[:, :, None])[:, :, 0]
        white = model.white(run)
        left = np.where(run.there & (white > 0), left, np.nan)
        squares = np.diff(left, axis=1) ** 2 / (white[:, 1:] + white[:, :-1])
        found.append(squares[:, view.repeats()])
    squares = np.concatenate(found, axis=1)
    enough = np.isfinite(squares).sum(axis=1) >= _LEAST_DIFFERENCES
    shown = [np.nanmedian(each) if known else _MEDIAN for each, known in zip(squares, enough, strict=True)]
    return np.maximum(np.sqrt(np.array(shown) / _MEDIAN), LOWER_NOISE[-1]), enough


STOPPING = 100.0
"""Support beyond which a hidden mistake stops a fit; up to it a warning says it.  Its evidence rests on how steady the
unit is taken to be, which errors that no model lists make too much of."""
MOST_MISFIT_LEFT, MOST_MISFIT_OF_TEMPERATURES = 2.0, 1.25
"""Misfit per output of a unit that is taken for steady, up to which a correction explains its outputs, and up to which
one of temperatures does.  Of a unit that is taken for too steady any correction explains something."""
WORTH_TRYING = 4.0
"""Gain of a hidden mistake in a unit as steady as its outputs show, from which it is tried in a steadier one."""
LEVELS = (
    (1.0, 1.0, 0), (3.0, 3.0, 0), (1.0, 1.0, 1), (1.0, 0.3, 2), (0.3, 0.3, 2), (1.0, 0.1, 3), (0.3, 0.1, 4),
    (1.0, 0.03, 5),
)  # fmt: skip
"""Degrees of steadiness: factors of what rows leave out and of offsets of runs, to what each channel shows by itself,
and the degree below, if a mistake has to be supported as well; the first is a poor unit.  A mistake makes channels
look less steady than they are."""
LEVELS_OF_TUMBLES = ((1.0, 1.0, 0), (0.3, 0.3, 0), (0.1, 0.1, 1), (0.03, 0.03, 2), (0.01, 0.01, 3))
"""The same, to a poor unit, of gyros that feel the Earth rate alone: few rows show no steadiness of their own.  That a
gyro repeats from run to run as well as from row to row is not known: offsets of runs as in a poor unit rival a mistake
that does not gain more by `STOPPING`."""
_SCORING_STEPS = 4


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
    likeliest = levels.likeliest(_concealed(campaign, levels[first], views), first, stated)
    likeliest += levels.likeliest([rival for each in likeliest for rival in each.mistake.rivals()], first, stated)
    strongest = _strongest(likeliest)
    small = [x.support for x in strongest if x.mistake.negligible(campaign, x.size, x.gain)]
    # Beside what is too small to be said nothing else is said that the outputs do not distinguish from it.
    least = max(small, default=-math.inf) + DECISIVE
    said = [each for each in strongest if each.support > least and _is_sayable(each, campaign)]
    return [each for each in said if not levels[0].passes_for_noise(each.mistake)]


def _concealed(campaign: Campaign, search: Search, views: Sequence[RunView]) -> list[Mistake]:
    """Return the mistakes that plausible errors may conceal in a campaign."""
    one_input = feels_the_earth_alone(campaign, views) or all(turns_through(view) for view in views)
    where = Concealed.BY_ONE_INPUT if one_input else Concealed.BY_INPUTS
    kinds = [kind for kind in MISTAKES if where in kind.concealed]
    doubted = {most: search.suspects(most) for most in {kind.of_doubted_runs for kind in kinds} if most}
    return [each for kind in kinds for each in kind.suspected(campaign, views) if _is_tried(each, doubted)]


def _strongest(found: Sequence[Explanation]) -> list[Explanation]:
    """Return those of possible size and about the most support.

    A mistake too weak to be reported is not reported under another name, and neither is what is impossible.
    """
    least = max((each.support for each in found), default=0.0) - DECISIVE
    return [each for each in told_by_name([x for x in found if x.mistake.possible(x.size)]) if each.support > least]


def _is_sayable(found: Explanation, campaign: Campaign) -> bool:
    """Whether a mistake is supported well enough to be said."""
    if found.support <= found.mistake.bar(campaign):
        return False
    return not found.rivalled or found.gain > RIVALLED * len(campaign.channels)


class SteadinessLevels:
    """The searches in units of rising steadiness, each made when it is first asked for: a poor unit, and `LEVELS`."""

    def __init__(self, campaign: Campaign):
        self.campaign = campaign
        self.shown, self.centre = POOR, None
        tumbled = feels_the_earth_alone(campaign, views_of(campaign))
        self.levels = LEVELS_OF_TUMBLES if tumbled else LEVELS
        # Mountings off by a degree need a second step, and a steady unit determines them better than a poor one.
        for step in range(_SCORING_STEPS):
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
        """Return the correction of a mistake at the level of most evidence; None if it explains nothing.

        The outputs of a unit look no steadier with a mistake than without, so that no level below the `first`, that of
        most evidence for the set-up as stated, is tried.  The error of a linear model is not independent from row to
        row, and the steadiest unit makes too much of it: one level below the mistake has to be supported as well.

        No correction may ask of a unit what no unit does.  A wrong rate shrinks the errors that a rate makes, and gains
        evidence by that while a bias takes its place.  A column is said to run backwards
        if outputs that may drift determine it as well.

        Parameters
        ----------
        tried : the correction at each level if it fits.
        stated : −2 log evidence of the set-up as stated.
        """
        if not tried:
            return None
        score, level, best = min(tried, key=lambda each: each.score)
        gain, rival = stated - score, stated
        if self.tumbled:
            rival = self.unsteady - (STOPPING - DECISIVE)
        if isinstance(mistake, (OfTemperatures, OtherUnit)):
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

    def likeliest(self, mistakes: Sequence[Mistake], first: int, stated: float) -> list[Explanation]:
        """Return the corrections of mistakes that explain something, each at its level of most evidence."""
        found = zip(mistakes, self.tried(mistakes, first), strict=True)
        return [*filter(None, (self.steadiest(mistake, own, stated) for mistake, own in found))]

    def tried(self, mistakes: Sequence[Mistake], first: int) -> list[list[Tried]]:
        """Return the correction of each mistake at each level, from the first, if it fits."""
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
    return MOST_MISFIT_OF_TEMPERATURES if isinstance(mistake, OfTemperatures) else MOST_MISFIT_LEFT


def _is_tried(mistake: Mistake, doubted: Mapping[int, set[int]]) -> bool:
    """Whether a mistake of elevation is that of a table as a whole, and one of whole records that of doubted runs."""
    if mistake.of_doubted_runs:
        return doubted[mistake.of_doubted_runs].issuperset(mistake.scope.runs)
    return not (isinstance(mistake, TableElevation) and mistake.scope.section == "run")


_STEP = math.radians(0.01)  # of the derivative by the size; a ratio is as small a number as an angle in rad
_APART = math.radians(1.0)
_LONGEST = math.radians(10.0)  # of one step to the best size
_WIDEST = math.radians(30.0)  # standard deviation; beyond, the evidence is no parabola of the size
_NEWTON_STEPS = 5
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
    if not found.mistake.estimated:
        return found
    views = views_of(campaign)
    steadiness = _shown(campaign, found.mistake.removed(views, found.size))
    size, bowl = found.size, _bowl(campaign, steadiness, found.mistake, views, found.size)
    if bowl is None:
        return found
    usual = [each for each in found.mistake.usual(views) if abs(math.remainder(each - size, 2 * math.pi)) < _STEP]
    for _ in range(0 if usual else _NEWTON_STEPS):
        longest = _LONGEST * found.mistake.per_radian
        nearer = size + float(np.clip(bowl.best - size, -longest, longest))
        tried = _bowl(campaign, steadiness, found.mistake, views, nearer)
        if tried is None or tried.least > bowl.least:
            break
        size, bowl = nearer, tried
        if abs(bowl.best - size) < _SETTLED * bowl.sd:
            break
    return replace(found, size=_as_usual(found.mistake, views, size, bowl), uncertainty=bowl.sd)


def _as_usual(mistake: Mistake, views: Sequence[RunView], size: float, bowl: _Bowl) -> float:
    """Return a usual size in place of the best one if the outputs hardly distinguish the two."""
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
    """Return the evidence near a size, with all other errors at their best; None if the outputs do not determine it."""
    unit = mistake.per_radian
    search, centre = Search(campaign, steadiness, mistake.removed(views, size)), np.zeros(0)
    for _ in range(2):
        centre = search.model.estimates(search.total)
        search = Search(campaign, steadiness, search.views, centre)
    model = search.model
    seen = model.seen_of(search.views)
    # How the size moves the outputs less what is predicted with mounting and table at the centre.
    rates = [
        (other.without_shared(centre).error - one.without_shared(centre).error) / _STEP
        for other, one in zip(model.seen_of(mistake.removed(views, size + _STEP * unit)), seen, strict=True)
    ]

    def evidence(apart: float) -> float:
        moved = [replace(one, error=one.error + apart * rate) for one, rate in zip(seen, rates, strict=True)]
        if isinstance(mistake, TemperatureValue):  # it moves what outputs respond with
            moved = model.seen_of(mistake.removed(views, size + apart * unit))
        terms = stacked_terms([model.terms_of(each) for each in moved]).total()
        return float(model.score(terms, search.g_sensitivity))

    low, middle, high = evidence(-_APART), evidence(0.0), evidence(_APART)
    bend = (low - 2 * middle + high) / _APART**2
    if not bend > 2 / _WIDEST**2:
        return None
    return _Bowl(middle, size - unit * (high - low) / (2 * _APART) / bend, unit * math.sqrt(2 / bend))
