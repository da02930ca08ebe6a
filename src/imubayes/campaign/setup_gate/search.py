"""The search for the mistake that explains why a campaign does not show what its set-up says.

Evidence of the set-up as stated is compared with that of every suspected correction.  The misfit of the linear model of
plausible errors tells a campaign without gross mistakes.  There only the mistakes are tried that such errors could
conceal, and the unit is taken for as steady as its outputs show (`hidden_mistakes`).
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields

import numpy as np

from imubayes.campaign.setup_gate.evidence import ErrorModel, NormalTerms, total
from imubayes.campaign.setup_gate.mistakes import MISTAKES, Mistake, TableAzimuth, TableElevation, TableZero
from imubayes.campaign.setup_gate.plausible_errors import POOR, Steadiness
from imubayes.campaign.setup_gate.run_view import RunView, feels_the_earth_alone, turns_through, views_of
from imubayes.campaign.setup_gate.shown_steadiness import shown_steadiness
from imubayes.campaign.setup_gate.site_mistakes import LATITUDE_MISTAKES, LatitudeSign, LatitudeValue
from imubayes.campaign.setup_gate.temperature_mistakes import TEMPERATURE_MISTAKES
from imubayes.campaign.setup_gate.unit_mistakes import UNIT_MISTAKES, AngleUnit, ChannelGain, RateUnit
from imubayes.campaign_data import Campaign

ORDINARY_MISFIT, ORDINARY_ERROR = 1.0, 3.5
"""Misfit per output, and largest error in standard deviations, up to which a campaign is valid.  What is left out of
the linear model is assumed several times as large as it is in good units: shipped campaigns, hidden effects included,
have a misfit of 0.01 to 0.4 and errors within 1.6 standard deviations."""
DECISIVE = 25.0
"""Gain in twice the log evidence, less the `unlikelihood` of a mistake, for it to be named: odds of e^12 to 1 outweigh
some thousand suspected mistakes and priors of 1 in 100."""
STOPPING = 100.0
"""The same for a hidden mistake to stop a fit; up to it a warning says it.  Its evidence rests on how steady the unit
is taken to be, which errors that no model lists make too much of."""
DECISIVE_LATITUDE = 8.0
"""The same for the sign of the latitude where several gyros show it, which is a single suspected mistake; up to
`DECISIVE` it is a warning."""
MOST_MISFIT_LEFT, MOST_MISFIT_OF_TEMPERATURES = 2.0, 1.25
"""Misfit per output of a unit that is taken for steady, up to which a correction explains its outputs, and up to which
one of temperatures does.  Of a unit that is taken for too steady any correction explains something."""
WORTH_TRYING = 4.0
"""Gain of a hidden mistake in a unit as steady as its outputs show, from which it is tried in a steadier one."""
AS_USUAL = 6.0
"""Evidence that a usual angle may fall short of the best one to be named in its place."""
LEAST_TURN = math.radians(25.0)
"""Least error of an azimuth that is doubted where plausible errors would explain the outputs as well: the Earth rate
of a tactical gyro tells no less."""
LEAST_LATITUDE = math.radians(15.0)
"""The same of a latitude: what a linear model leaves out moved that of a valid campaign by 9 degrees."""
LEAST_TILT = math.radians(2.0)
"""The same of an elevation: smaller ones pass for errors that the linear model leaves out."""
LEAST_ZERO = math.radians(4.0)
"""The same of a zero, beside which a loose mounting may be turned about the axis."""
LEAST_SHARE = 0.98
"""Least share of the excess misfit that the correction of a mistake removes."""
MOST_MISTAKES = 3
"""Mistakes that are looked for together."""
TRIED_FIRST, TRIED_NEXT = 4, 1
"""How many of the best are tried as the first of several, and as each one after it: every trial is a search."""
EQUIVALENT = 10.0
"""Mistakes whose gain is within this of the best are equally good explanations; of hidden ones, `DECISIVE`."""
RIVALLED = 49.0
"""Gain per channel beyond which a mistake in temperatures is said, as a warning, although other biases in a run explain
the outputs as well: a bias off by seven plausible standard deviations.  Valid campaigns gained up to 26."""
LEVELS = (
    (1.0, 1.0, 0), (3.0, 3.0, 0), (1.0, 1.0, 1), (1.0, 0.3, 2), (0.3, 0.3, 2), (1.0, 0.1, 3), (0.3, 0.1, 4),
    (1.0, 0.03, 5),
)  # fmt: skip
"""Degrees of steadiness: factors of what rows leave out and of offsets of runs, to what each channel shows by itself,
and the degree below, where a mistake has to be supported as well; the first is a poor unit.  A mistake makes channels
look less steady than they are."""
LEVELS_OF_TUMBLES = ((1.0, 1.0, 0), (0.3, 0.3, 0), (0.1, 0.1, 1), (0.03, 0.03, 2), (0.01, 0.01, 3))
"""The same, to a poor unit, of gyros that feel the Earth rate alone: few rows, of which terms quadratic in g make one
pattern, show no steadiness of their own."""
_STEPS = 4
_REFINEMENTS = 4
_SUSPECTS = 5  # runs whose own mistakes are tried


@dataclass(frozen=True)
class Explanation:
    """A mistake and its size, and by how much its correction raises twice the log evidence.

    Attributes
    ----------
    misfit : per output with the correction.
    rival : gain of what passes for the mistake in a valid set-up.
    stopping : support beyond which the mistake stops a fit.
    """

    mistake: Mistake
    size: float
    gain: float
    misfit: float
    rival: float = 0.0
    stopping: float = DECISIVE

    @property
    def support(self) -> float:
        """The gain less what speaks against the mistake beforehand."""
        return self.gain - self.mistake.unlikelihood

    @property
    def rivalled(self) -> bool:
        """Whether the outputs do not tell the mistake from what passes for it in a valid set-up."""
        return self.rival > 0 and self.gain < self.rival + DECISIVE


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
    if search.ordinary:
        hidden = hidden_mistakes(campaign)
        return Judgement((_equally_good(hidden, DECISIVE),) if hidden else (), search.misfit)
    if found := search.several_mistakes(1):
        return Judgement(tuple(found), search.misfit)
    if hidden := hidden_mistakes(campaign):
        return Judgement((_equally_good(hidden, DECISIVE),), search.misfit)
    if found := search.several_mistakes(MOST_MISTAKES):
        return Judgement(tuple(found), search.misfit)
    return Judgement(misfit=search.misfit, unexplained=tuple(search.disagreements()))


def _equally_good(found: Sequence[Explanation], within: float = EQUIVALENT) -> tuple[Explanation, ...]:
    """Return the best explanations, the first of each kind and scope."""
    best = max(each.support for each in found)
    equal = [each for each in found if each.support >= best - within]
    like = [each for each in found if isinstance(each.mistake, RateUnit) and _is_like(each.mistake, equal)]
    return tuple(_distinct([*like, *sorted(equal, key=lambda each: -each.support)]))


def _is_like(mistake: RateUnit, found: Sequence[Explanation]) -> bool:
    return any(mistake.like(each.mistake) for each in found)


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
        concealed = (*MISTAKES, ChannelGain, AngleUnit, *LATITUDE_MISTAKES, *TEMPERATURE_MISTAKES)
    found = [
        best
        for kind in concealed
        for mistake in kind.suspected(campaign, views)
        if _is_of_equipment(mistake) and (best := levels.steadiest(mistake, first, stated)) is not None
    ]
    found = [each for each in found if each.support > _bar(each.mistake, campaign) and not _small(each, campaign)]
    return [each for each in found if not each.rivalled or each.gain > RIVALLED * len(campaign.channels)]


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
        self.made: dict[int, Search] = {}

    def __getitem__(self, level: int) -> "Search":
        if level not in self.made:
            steadiness = self.shown.poor() if level == 0 else self.shown.times(*self.levels[level][:2])
            self.made[level] = Search(self.campaign, steadiness, centre=self.centre)
        return self.made[level]

    def of_most_evidence(self) -> tuple[int, float]:
        """Return the level of most evidence for the set-up as stated that fits, and −2 log of the most evidence."""
        scores: dict[int, float] = {}
        for level, (_, _, below) in enumerate(self.levels):
            if below < 1 or (below in scores and self[below].misfit < MOST_MISFIT_LEFT):
                scores[level] = self[level].stated
        adequate = [level for level in scores if self[level].misfit < MOST_MISFIT_LEFT] or [0]
        return min(adequate, key=lambda level: scores[level]), min(scores.values())

    def steadiest(self, mistake: Mistake, first: int, stated: float) -> Explanation | None:
        """Return the correction of a mistake at the level of most evidence; None where it explains nothing.

        The outputs of a unit look no steadier with a mistake than without, so that no level below the `first`, that of
        most evidence for the set-up as stated, is tried.  What a linear model leaves out is not independent from row to
        row, and the steadiest unit makes too much of it: one level below the mistake has to be supported as well.

        No correction may ask of a unit what no unit does.  A wrong rate shrinks the errors that a rate makes, and gains
        evidence by that while a bias takes its place.

        Parameters
        ----------
        stated : −2 log evidence of the set-up as stated.
        """
        tried = self._tried(mistake, first)
        if not tried:
            return None
        score, level, best = min(tried, key=lambda each: each[0])
        gain, rival = stated - score, stated
        if isinstance(mistake, TEMPERATURE_MISTAKES):
            rival = min(self[tried_at].rival(mistake) for _, tried_at, _ in tried)
        elif gain > DECISIVE_LATITUDE and not self._holds_below(level, mistake):
            return None
        if gain > DECISIVE_LATITUDE and not self[0].error_left(mistake, best.size) < ORDINARY_ERROR:
            return None
        return Explanation(mistake, best.size, gain, best.misfit, max(0.0, stated - rival), STOPPING)

    def _tried(self, mistake: Mistake, first: int) -> list[tuple[float, int, Explanation]]:
        """Return −2 log evidence, level and correction at each level where the correction fits."""
        most = MOST_MISFIT_OF_TEMPERATURES if isinstance(mistake, TEMPERATURE_MISTAKES) else MOST_MISFIT_LEFT
        tried: list[tuple[float, int, Explanation]] = []
        fitting = set(range(first))
        for level in range(first, len(self.levels)):
            if level > first and self.levels[level][2] not in fitting:
                continue
            found = self[level].explain(mistake)
            if found.gain < WORTH_TRYING and not tried and not isinstance(mistake, LatitudeSign):
                break
            if found.misfit < most:
                fitting.add(level)
                tried.append((self[level].stated - found.gain, level, found))
        return tried

    def _holds_below(self, level: int, mistake: Mistake) -> bool:
        # A sign has no size that would adapt to what is left out.
        bar = 0.0 if isinstance(mistake, LatitudeSign) else DECISIVE
        below = self.levels[level][2]
        return not below or self[below].explain(mistake).support > bar


def _is_of_equipment(mistake: Mistake) -> bool:
    """Whether a mistake is that of a table as a whole, where it is one of elevation."""
    return not (isinstance(mistake, TableElevation) and mistake.scope.section == "run")


def _small(found: Explanation, campaign: Campaign) -> bool:
    if isinstance(found.mistake, LatitudeValue):
        return abs(found.size - campaign.site.latitude) < LEAST_LATITUDE
    least = LEAST_ZERO if isinstance(found.mistake, TableZero) else LEAST_TILT
    least = LEAST_TURN if isinstance(found.mistake, TableAzimuth) else least
    return isinstance(found.mistake, (TableAzimuth, TableElevation, TableZero)) and abs(found.size) < least


def _support(first: Explanation, rest: Sequence[tuple[Explanation, ...]]) -> float:
    return first.support + sum(equal[0].support for equal in rest)


def _bar(mistake: Mistake, campaign: Campaign) -> float:
    several = len(campaign.of_kind("gyro")) > 1
    return DECISIVE_LATITUDE if isinstance(mistake, LatitudeSign) and several else DECISIVE


def _distinct(found: Sequence[Explanation]) -> Iterator[Explanation]:
    """Yield the first explanation of each kind and scope."""
    seen = set()
    for each in found:
        key = (each.mistake.kind, each.mistake.scope, each.mistake.variant)
        if key not in seen:
            seen.add(key)
            yield each


class Search:
    """Evidence of a campaign as stated, and of corrected ones."""

    def __init__(
        self,
        campaign: Campaign,
        steadiness: Steadiness = POOR,
        views: Sequence[RunView] | None = None,
        centre: np.ndarray | None = None,
    ):
        self.campaign = campaign
        self.views = views_of(campaign) if views is None else tuple(views)
        if not self.views:
            return
        self.model = ErrorModel(campaign, steadiness=steadiness, centre=centre)
        self.known: dict[tuple[int, tuple[bytes | str | float, ...]], NormalTerms] = {}
        self.terms = [self.model.terms(view) for view in self.views]
        self.total = total(self.terms)
        self.stated = self.model.score(self.total)
        self.g_sensitivity = self.model.best_g_sensitivity(self.total)
        self.misfit = self.model.misfit(self.total) / max(self.total.values, 1)

    @property
    def ordinary(self) -> bool:
        """Whether the campaign shows what its set-up says, within plausible errors."""
        largest = float(np.abs(self.model.errors(self.total)).max())
        return self.misfit < ORDINARY_MISFIT and largest < ORDINARY_ERROR

    def several_mistakes(self, most: int, tried: int = TRIED_FIRST) -> list[tuple[Explanation, ...]]:
        """Return the fewest mistakes that explain the outputs together; none where so many do not.

        Parameters
        ----------
        most : mistakes together.
        tried : how many of the best are tried as the first of several.
        """
        found = [each for each in self._suspected() if each.support > DECISIVE]
        whole = [each for each in found if self._explains(each)]
        if whole:
            return [_equally_good(whole)]
        if most == 1:
            return []
        # The first of several need not be the one that gains most: two wrong files may look like one wrong table.
        partial = list(_distinct(sorted(found, key=lambda each: -each.support)))[:tried]
        chains = [(each, self._corrected_by(each).several_mistakes(most - 1, TRIED_NEXT)) for each in partial]
        chains = [(each, rest) for each, rest in chains if rest]
        if not chains:
            return []
        first, rest = min(chains, key=lambda chain: (len(chain[1]), -_support(chain[0], chain[1])))
        return [(first,), *rest]

    def _corrected_by(self, found: Explanation) -> "Search":
        """Return the search in the campaign without a mistake."""
        views = list(self.views)
        for place in found.mistake.scope.runs:
            views[place] = found.mistake.corrected(self.views, place, found.size)
        return Search(self.campaign, views=views)

    def _suspected(self) -> Iterator[Explanation]:
        suspects = self.suspects()
        for kind in (*MISTAKES, *UNIT_MISTAKES, *TEMPERATURE_MISTAKES):
            for mistake in kind.suspected(self.campaign, self.views):
                if mistake.scope.section != "run" or suspects.issuperset(mistake.scope.runs):
                    yield self.explain(mistake)

    def _explains(self, found: Explanation) -> bool:
        excess, left = self.misfit - ORDINARY_MISFIT / 2, found.misfit - ORDINARY_MISFIT / 2
        return found.misfit < ORDINARY_MISFIT or left < (1 - LEAST_SHARE) * excess

    def disagreements(self) -> list[tuple[str, float]]:
        """Return the runs that disagree with the others and their misfit per output, worst first."""
        if self.ordinary:
            return []
        model = ErrorModel(self.campaign, gross=True)
        terms = [model.terms(view) for view in self.views]
        whole = total(terms)
        misfit = model.misfit(whole)
        found = [
            (view.name, (misfit - model.misfit(whole - own)) / max(own.values, 1))
            for view, own in zip(self.views, terms, strict=True)
        ]
        return sorted((each for each in found if each[1] > DECISIVE), key=lambda each: -each[1])

    def suspects(self) -> set[int]:
        """Return the places of the runs that agree least with all others."""
        surprise = [self._surprise(terms) for terms in self.terms]
        return set(sorted(range(len(surprise)), key=lambda k: -surprise[k])[:_SUSPECTS])

    def _surprise(self, terms: NormalTerms) -> float:
        """Return by how much a run raises the misfit of all others, per output."""
        rest = self.model.misfit(self.total - terms)
        return (self.misfit * self.total.values - rest) / max(terms.values, 1)

    def explain(self, mistake: Mistake) -> Explanation:
        """Return the best size of a mistake and what its correction gains."""
        base = self._without_runs_of(mistake)
        size = self._best_size(mistake, base) if mistake.sizes else 0.0
        terms = self._corrected(mistake, base, size)
        gain = self.stated - self.model.score(terms)
        for usual in mistake.usual(self.views):
            if abs(math.remainder(usual - size, 2 * math.pi)) > mistake.usual_within:
                continue
            also = self._corrected(mistake, base, usual)
            if (well := self.stated - self.model.score(also)) > gain - AS_USUAL:
                size, terms, gain = usual, also, well
                break
        return Explanation(mistake, float(size), gain, self.model.misfit(terms) / max(terms.values, 1))

    def error_left(self, mistake: Mistake, size: float) -> float:
        """Return the largest error with a mistake corrected, in standard deviations of the errors of valid set-ups."""
        corrected = self._corrected(mistake, self._without_runs_of(mistake), size)
        return float(np.abs(self.model.errors(corrected)).max())

    def _without_runs_of(self, mistake: Mistake) -> NormalTerms:
        """Return the terms of all runs but those that a mistake concerns."""
        base = self.total
        for place in mistake.scope.runs:
            base = base - self.terms[place]
        return base

    def _best_size(self, mistake: Mistake, base: NormalTerms) -> float:
        """Return the size of least misfit, by parabolas about the best of the grid.

        The misfit is a single wave in an angle, so that a coarse grid finds the basin of its minimum.  Where the Earth
        rate alone tells the size, a large g-sensitivity passes for its vertical part, and the evidence decides.
        """
        judged = self._evidence_as_stated if mistake.by_evidence else self.model.misfit
        tried = {size: judged(self._corrected(mistake, base, size)) for size in mistake.sizes}
        best = min(tried, key=lambda size: tried[size])
        step = float(np.min(np.diff(sorted(mistake.sizes)))) / 2
        for _ in range(_REFINEMENTS):
            for near in (best - step, best + step):
                tried[near] = judged(self._corrected(mistake, base, near))
            low, middle, high = tried[best - step], tried[best], tried[best + step]
            bend = low - 2 * middle + high
            vertex = best + step * float(np.clip((low - high) / 2 / bend, -1, 1)) if bend > 0 else best
            tried[vertex] = judged(self._corrected(mistake, base, vertex))
            best = min(tried, key=lambda size: tried[size])
            step /= 6
        return best

    def rival(self, mistake: Mistake) -> float:
        """Return −2 log evidence of what passes for a mistake in the temperatures of the set-up as stated.

        That is a unit whose outputs hardly follow the temperature or, where a single run is concerned, biases and scale
        factors of that run unlike those of others.
        """
        rivals = [self.model.score(self.total, compensated=True)]
        if mistake.scope.section == "run":
            (place,) = mistake.scope.runs
            loose = self.model.terms(self.views[place], loose=True)
            rivals.append(self.model.score(self.total - self.terms[place] + loose))
        return min(rivals)

    def _evidence_as_stated(self, terms: NormalTerms) -> float:
        """Return −2 log of the evidence with the g-sensitivity that the set-up as stated shows."""
        return self.model.score(terms, self.g_sensitivity)

    def _corrected(self, mistake: Mistake, base: NormalTerms, size: float) -> NormalTerms:
        terms = base
        for place in mistake.scope.runs:
            terms = terms + self._terms(mistake, place, size)
        return terms

    def _terms(self, mistake: Mistake, place: int, size: float) -> NormalTerms:
        found = self._seen(mistake, place, size)
        whole = self.terms[place].values
        # Rows without stimulus, at the end of a shifted run, count like the others on average.
        found = found if found.values in (whole, 0) else found.scaled(whole / found.values)
        return found.with_volume(2 * mistake.rescaled(self.views[place]))

    def _seen(self, mistake: Mistake, place: int, size: float) -> NormalTerms:
        """Return the terms of a corrected run; the same correction is tried of a run, of its table and its mounting."""
        view = mistake.corrected(self.views, place, size)
        key = (place, _identity(view, self.views[place]))
        if key not in self.known:
            self.known[key] = self.model.terms(view)
        return self.known[key]


def _identity(view: RunView, stated: RunView) -> tuple[bytes | str | float, ...]:
    """Return what tells a corrected view from others of the same run."""
    found: list[bytes | str | float] = []
    for each in fields(RunView):
        value = getattr(view, each.name)
        if value is getattr(stated, each.name):
            continue
        found.append(each.name)
        if isinstance(value, np.ndarray):
            found.append(value.tobytes())
        elif isinstance(value, Mapping):
            found += [part for name, array in value.items() for part in (name, array.tobytes())]
        else:
            found.append(value)
    return tuple(found)
