"""The search for the mistake that explains why a campaign does not show what its set-up says.

Evidence of the set-up as stated is compared with that of every suspected correction.
"""

import copy
import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from imubayes.campaign.setup_gate.catalogue import MISTAKES
from imubayes.campaign.setup_gate.drift_rivals import score_with_drift
from imubayes.campaign.setup_gate.equipment_mistakes import DECISIVE, Mistake
from imubayes.campaign.setup_gate.error_model import (
    G_SENSITIVITIES,
    POOR,
    NormalTerms,
    Steadiness,
    stacked_terms,
)
from imubayes.campaign.setup_gate.evidence import ErrorModel
from imubayes.campaign.setup_gate.explanations import (
    Explanation,
    alike_in_support,
    distinct,
    equally_good,
    of_different_records,
    told_by_name,
)
from imubayes.campaign.setup_gate.file_mistakes import OtherUnit
from imubayes.campaign.setup_gate.reading_mistakes import ChannelGain
from imubayes.campaign.setup_gate.setup_view import CarryingAxes, RunView, views_of
from imubayes.campaign.setup_gate.thermal_mistakes import TemperatureReversed
from imubayes.foundations.campaign_data import Campaign

ORDINARY_MISFIT, ORDINARY_ERROR = 1.0, 3.5
"""Misfit per output, and largest error in standard deviations, up to which a campaign is valid.  What is left out of
the linear model is assumed several times as large as it is in good units: shipped campaigns, hidden effects included,
have a misfit of 0.01 to 0.4 and errors within 1.6 standard deviations."""
LEAST_SHARE = 0.98
"""Least share of the excess misfit that the correction of a mistake removes."""
MOST_MISTAKES = 3
"""Mistakes that are looked for together."""
TRIED_FIRST, TRIED_NEXT = 4, 1
"""How many of the best are tried as the first of several, and as each one after it: every trial is a search."""
_STEPS = 3
_TURNED_FAR = 30.0
"""Misfit per output up to which squares of plausible rotations may make it; a larger one is that of a mistake."""
_REFINEMENTS, _REMEMBERED = 4, 256
_SUSPECTS = 5  # runs whose own mistakes are tried
_AT_ONCE = 2**19  # numbers in the terms of campaigns that are judged together: four megabytes

type Identity = tuple[bytes | str | float, ...]
type Key = tuple[int, Identity]
"""The place of a run, and the identity of its corrected view."""


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
        self.nearest: Explanation | None = None
        self.views = views_of(campaign) if views is None else tuple(views)
        if not self.views:
            return
        self.model = ErrorModel(campaign, steadiness=steadiness, centre=centre)
        self.seen = list(self.model.seen_in_parts(self.views))
        self._judge()

    def as_steady_as(self, steadiness: Steadiness) -> "Search":
        """Return the search in a unit of another steadiness."""
        found = copy.copy(self)
        found.model = self.model.as_steady_as(steadiness)
        found._judge()
        return found

    def _judge(self) -> None:
        """Judge the campaign as stated."""
        self.known: dict[Key, NormalTerms] = {}
        self.terms = self.model.terms_of_parts(len(self.views), self.seen)
        self.total = self.terms.total()
        fit = self.model.fit(self.total)
        self.stated = float(fit.score.min())
        self.g_sensitivity = G_SENSITIVITIES[int(np.argmin(fit.score))]
        self.misfit = float(fit.misfit[-1] / np.maximum(self.total.values, 1))

    @property
    def ordinary(self) -> bool:
        """Whether the campaign shows what its set-up says, within plausible errors."""
        largest = float(np.abs(self.model.errors(self.total)).max())
        return self.misfit < ORDINARY_MISFIT and largest < ORDINARY_ERROR

    def several_mistakes(self, most: int, tried: int = TRIED_FIRST) -> list[tuple[Explanation, ...]]:
        """Return the fewest mistakes that explain the outputs together; none if so many do not.

        Where none does, the `nearest` is one whose correction takes most of the misfit away, and leaves too much.

        Parameters
        ----------
        most : mistakes together.
        tried : how many of the best are tried as the first of several.
        """
        found = told_by_name([each for each in self._suspected() if each.support > DECISIVE])
        explaining = [each for each in found if self._explains(each) and not self._passes(each.mistake)]
        if whole := self._verified(explaining):
            return [equally_good(whole)]
        self.nearest = max(explaining, key=lambda each: each.support, default=None)
        if most == 1:
            return []
        # The first of several need not be the one that gains most: two wrong files may look like one wrong table.
        partial = list(distinct(sorted(found, key=lambda each: -each.support)))[:tried]
        corrected = [Search(self.campaign, views=each.mistake.removed(self.views, each.size)) for each in partial]
        further = [search.several_mistakes(most - 1, TRIED_NEXT) for search in corrected]
        chains = [[(each,), *rest] for each, rest in zip(partial, further, strict=True) if rest]
        chains = [chain for chain in chains if of_different_records(chain)]
        return min(chains, key=lambda chain: (len(chain), -sum(equal[0].support for equal in chain)), default=[])

    def _suspected(self) -> list[Explanation]:
        suspects = self.suspects()
        found = self.explain(
            [
                mistake
                for kind in MISTAKES
                for mistake in (kind.suspected(self.campaign, self.views) if kind.gross else ())
                if mistake.scope.section != "run" or suspects.issuperset(mistake.scope.runs)
            ]
        )
        return [each for each in found if each.mistake.possible(each.size)]

    def _explains(self, found: Explanation) -> bool:
        excess, left = self.misfit - ORDINARY_MISFIT / 2, found.misfit - ORDINARY_MISFIT / 2
        return found.misfit < ORDINARY_MISFIT or left < (1 - LEAST_SHARE) * excess

    def _verified(self, found: Sequence[Explanation]) -> list[Explanation]:
        """Return the most probable explanations whose correction, made in the campaign, lets it agree.

        A correction that takes away nearly all of a gross misfit may leave a gross one: it is not the mistake.  One
        that leaves a unit or a table poorer than its grade is taken if no other is left.
        """
        groups = [*alike_in_support(found)]
        for group in groups:
            agreeing = [each for each in group if self._agrees_without(each)]
            if agreeing:
                return agreeing
        poorer = ([each for each in group if each.misfit < ORDINARY_MISFIT] for group in groups)
        return next(filter(None, poorer), [])

    def _agrees_without(self, found: Explanation) -> bool:
        """Return whether the campaign agrees with a mistake corrected.

        One that changes no view, a run of another unit, has no correction but errors of that run alone: its misfit.
        """
        corrected = self.corrected(found)
        same = all(one is other for one, other in zip(corrected.views, self.views, strict=True))
        return found.misfit < ORDINARY_MISFIT if same else corrected.agrees

    def corrected(self, found: Explanation) -> "Search":
        """Return the campaign with a mistake corrected, judged again."""
        return Search(self.campaign, views=found.mistake.removed(self.views, found.size))

    @property
    def agrees(self) -> bool:
        """Whether the campaign shows what its set-up says, or what plausible errors that turn far make of it.

        Squares of rotations by some degrees are beyond what a model that is linear about zero leaves out.
        """
        search = self
        for _ in range(_STEPS):
            if search.ordinary or search.misfit > _TURNED_FAR:
                break
            search = Search(search.campaign, views=search.views, centre=search.model.estimates(search.total))
        return search.ordinary

    def passes_for_noise(self, mistake: Mistake) -> bool:
        """Whether errors as many times as large as the outputs of a mistaken unit explain as much.

        Outputs divided by a factor have smaller errors; a mistaken unit shows in the response to the input.
        """
        if not isinstance(mistake, ChannelGain) or mistake.factor < 1:
            return False
        factors = np.array([mistake.factor if place in mistake.places else 1.0 for place in self.model.places])
        larger = self.as_steady_as(Steadiness(factors, factors, factors))
        return self.explain([mistake])[0].gain < self.stated - larger.stated + DECISIVE

    def disagreements(self) -> list[tuple[str, float]]:
        """Return the runs that disagree with the others and their misfit per output, worst first."""
        if self.ordinary:
            return []
        model = ErrorModel(self.campaign, gross=True)
        terms = model.terms_of_parts(len(self.views), self.seen)
        whole = terms.total()
        surprise = (model.misfit(whole) - model.misfit(whole - terms)) / np.maximum(terms.values, 1)
        found = zip((view.name for view in self.views), surprise.tolist(), strict=True)
        return sorted((each for each in found if each[1] > DECISIVE), key=lambda each: -each[1])

    def suspects(self, most: int = _SUSPECTS) -> set[int]:
        """Return the places of the runs that agree least with all others: those that raise their misfit most."""
        rest = self.model.misfit(self.total - self.terms)
        surprise = (self.misfit * self.total.values - rest) / np.maximum(self.terms.values, 1)
        return set(np.argsort(-surprise, kind="stable")[:most].tolist())

    def explain(self, mistakes: Sequence[Mistake]) -> list[Explanation]:
        """Return the best size of each mistake and what its correction gains; all are evaluated together."""
        best = [SizedMistake(mistake, size) for mistake, size in zip(mistakes, self._best_sizes(mistakes), strict=True)]
        found = self._explained(best)
        usual = [(k, each) for k, trial in enumerate(best) for each in trial.usual(self.views)]
        least = [each.gain - each.mistake.as_usual for each in found]
        # The nearest usual size that does as well is taken for the best one.
        chosen: dict[int, Explanation] = {}
        for (k, _), each in zip(usual, self._explained([each for _, each in usual]), strict=True):
            off = abs(each.size - best[k].size)
            if each.gain > least[k] and (k not in chosen or off < abs(chosen[k].size - best[k].size)):
                chosen[k] = each
        return [chosen.get(k, each) for k, each in enumerate(found)]

    def _explained(self, trials: Sequence["SizedMistake"]) -> list[Explanation]:
        """Return what corrections gain."""

        def judged(terms: NormalTerms) -> np.ndarray:
            fit = self.model.fit(terms)
            gain, misfit = self.stated - fit.score.min(axis=-1), fit.misfit[:, -1] / np.maximum(terms.values, 1)
            return np.stack([gain, misfit], axis=1)

        found = self._judged(trials, judged)
        for k, trial in enumerate(trials):
            if isinstance(trial.mistake, OtherUnit):
                found[k] = self._apart(trial.mistake)
        both = zip(trials, found.tolist(), strict=True)
        return [Explanation(trial.mistake, float(trial.size), gain, misfit) for trial, (gain, misfit) in both]

    def _apart(self, mistake: OtherUnit) -> tuple[float, float]:
        """Return the gain and the misfit per output if the run is of another unit."""
        (place,) = mistake.scope.runs
        fits = [self.model.fit(each) for each in (self.total - self.terms[place], self.terms[place])]
        gain = self.stated - sum(float(each.score.min()) for each in fits)
        return gain, sum(float(each.misfit[-1]) for each in fits) / max(float(self.total.values), 1.0)

    def _judged(self, trials: Sequence["SizedMistake"], judge: Callable[[NormalTerms], np.ndarray]) -> np.ndarray:
        """Return what a function makes of the terms of corrected campaigns, a share of them at a time."""
        each = len(self.views) * (self.model.size + 1) ** 2
        shares = itertools.batched(trials, max(1, _AT_ONCE // each))
        return np.concatenate([np.zeros((0, 2)), *(judge(self._corrected(share)) for share in shares)])

    def error_left(self, mistake: Mistake, size: float) -> float:
        """Return the largest error with a mistake corrected, in standard deviations of the errors of valid set-ups."""
        return float(np.abs(self.model.errors(self._corrected([SizedMistake(mistake, size)])[0])).max())

    def _best_sizes(self, mistakes: Sequence[Mistake]) -> list[float]:
        """Return the size of least misfit of each mistake, 0 if it has none, by parabolas about the best of a grid.

        The misfit is a single wave in an angle, so that a coarse grid finds the basin of its minimum; terms quadratic
        in g make it two, and every basin is tried.  If the Earth rate alone determines the size, a large g-sensitivity
        passes for its vertical part, and the evidence decides.
        """
        sized = [(k, each) for k, each in enumerate(mistakes) if each.grid()]
        least = iter(self._least([SizedMistake(each, size) for _, each in sized for size in each.grid()]))
        basins: list[tuple[int, Basin]] = []
        for k, each in sized:
            tried = {size: next(least) for size in each.grid()}
            starts = minima(tried) if self.model.squares else [min(tried, key=lambda size: tried[size])]
            step = float(np.min(np.diff(sorted(each.grid())))) / 2
            basins += [(k, Basin(each, dict(tried), start, step)) for start in starts]
        self._narrow([basin for _, basin in basins])
        sizes = [0.0] * len(mistakes)
        for k, of in itertools.groupby(basins, key=lambda each: each[0]):
            sizes[k] = min((basin for _, basin in of), key=lambda basin: basin.tried[basin.best]).best
        return sizes

    def _narrow(self, basins: Sequence["Basin"]) -> None:
        """Find the minimum of each basin."""
        for _ in range(_REFINEMENTS):
            basins = [each for each in basins if not each.settled]
            for sizes in (Basin.sides, Basin.vertex):
                trials = [(each, size) for each in basins for size in sizes(each)]
                least = self._least([SizedMistake(each.mistake, size) for each, size in trials])
                for (each, size), found in zip(trials, least, strict=True):
                    each.tried[size] = found
            for each in basins:
                each.narrow()

    def _least(self, trials: Sequence["SizedMistake"]) -> list[float]:
        """Return what the best size makes least: the misfit, or −2 log evidence with the g-sensitivity as stated."""

        def judged(terms: NormalTerms) -> np.ndarray:
            fit = self.model.fit(terms, (self.g_sensitivity, G_SENSITIVITIES[-1]))
            return np.stack([fit.misfit[:, 1], fit.score[:, 0]], axis=1)

        found = self._judged(trials, judged).tolist()
        return [both[trial.mistake.by_evidence] for trial, both in zip(trials, found, strict=True)]

    def rival(self, mistake: Mistake) -> float:
        """Return −2 log evidence of what passes for a mistake in the temperatures of the set-up as stated.

        That is a unit whose outputs hardly follow the temperature or, if a single run is concerned, biases and scale
        factors of that run unlike those of others.
        """
        rivals = [self.stated if isinstance(mistake, OtherUnit) else self.model.score(self.total, compensated=True)]
        if mistake.scope.section == "run":
            total = self.total
            for place in mistake.scope.runs:
                loose = self.model.terms_of(self.model.seen(self.views[place]), loose=True)
                total = total - self.terms[place] + loose
            rivals.append(self.model.score(total))
        return float(min(rivals))

    def with_drift(self, mistake: TemperatureReversed) -> tuple[float, float]:
        """Return −2 log evidence if the outputs of the run of a mistake drift: as stated, and corrected."""
        (place,) = mistake.scope.runs
        stated, rest = self.views[place], self.total - self.terms[place]
        corrected = mistake.corrected(self.views, place, 0.0)
        return score_with_drift(self.model, stated, rest), score_with_drift(self.model, corrected, rest)

    def _passes(self, mistake: Mistake) -> bool:
        """Whether what is no mistake explains the outputs as well: noise, or a drift in place of a reversed column."""
        if isinstance(mistake, TemperatureReversed):
            stated, corrected = self.with_drift(mistake)
            return stated - corrected < DECISIVE
        return self.passes_for_noise(mistake)

    def _corrected(self, trials: Sequence["SizedMistake"]) -> NormalTerms:
        """Return the terms of the campaign with each of some corrections.

        The same correction is tried of a run, of its table and its mounting.
        """
        keys: list[list[Key]] = []
        new: dict[Key, RunView] = {}
        for trial in trials:
            keys.append([])
            for place in trial.mistake.scope.runs:
                view = trial.mistake.corrected(self.views, place, trial.size)
                key = (place, _identity(view, self.views[place]))
                keys[-1].append(key)
                if key not in self.known:
                    new[key] = view
        terms = self.model.terms_of_parts(len(new), self.model.seen_in_parts(list(new.values())))
        self.known |= {key: terms[k] for k, key in enumerate(new)}
        found = stacked_terms([self.known[key] for own in keys for key in own])
        for key in list(self.known)[: max(0, len(self.known) - _REMEMBERED)]:
            del self.known[key]
        places = [place for trial in trials for place in trial.mistake.scope.runs]
        stated = self.terms[places]
        # Rows without stimulus, at the end of a shifted run, count like the others on average.
        found = found.scaled(np.where(found.values > 0, stated.values / np.maximum(found.values, 1), 1.0))
        rescaled = [t.mistake.rescaled(self.views[place]) for t in trials for place in t.mistake.scope.runs]
        starts = np.cumsum([0, *(len(own) for own in keys[:-1])])
        return self.total + (found.with_volume(2 * np.array(rescaled)) - stated).sums(starts)


@dataclass(frozen=True)
class SizedMistake:
    """A mistake of a size, to be corrected."""

    mistake: Mistake
    size: float

    def usual(self, views: Sequence[RunView]) -> list["SizedMistake"]:
        """Return the same with each usual size nearby."""
        apart = ((each, math.remainder(each - self.size, 2 * math.pi)) for each in self.mistake.usual(views))
        return [SizedMistake(self.mistake, each) for each, off in apart if abs(off) <= self.mistake.usual_within]


@dataclass
class Basin:
    """The search for a minimum in one basin.

    Attributes
    ----------
    tried : size → what the best size makes least.
    best : of these sizes.
    step : to either side of it, between which a parabola is drawn.
    """

    mistake: Mistake
    tried: dict[float, float]
    best: float
    step: float
    settled: bool = False

    def sides(self) -> tuple[float, float]:
        """Return the sizes to either side."""
        return self.best - self.step, self.best + self.step

    def vertex(self) -> tuple[float]:
        """Return the minimum of the parabola, the best size if it has none."""
        low, middle, high = (self.tried[size] for size in (self.best - self.step, self.best, self.best + self.step))
        bend = low - 2 * middle + high
        return (self.best + self.step * float(np.clip((low - high) / 2 / bend, -1, 1)) if bend > 0 else self.best,)

    def narrow(self) -> None:
        """Go on about the best of the sizes, unless it is hardly better."""
        before, (low, high) = self.tried[self.best], self.sides()
        self.best = min((low, *self.vertex(), self.best, high), key=lambda size: self.tried[size])
        self.settled = before - self.tried[self.best] < self.mistake.settled
        self.step /= 6


def minima(tried: dict[float, float]) -> list[float]:
    """Return the sizes of a grid of angles at which a function is no larger than at its neighbours."""
    sizes = sorted(tried)
    around = zip(sizes, [sizes[-1], *sizes], [*sizes[1:], sizes[0]], strict=False)
    return [size for size, low, high in around if tried[size] <= min(tried[low], tried[high])]


def _identity(view: RunView, stated: RunView) -> Identity:
    """Return what distinguishes a corrected view from others of the same run."""
    found: list[bytes | str | float] = []
    as_stated = vars(stated)
    for name, value in vars(view).items():
        if value is as_stated[name]:
            continue
        found.append(name)
        if isinstance(value, np.ndarray):
            found.append(value.tobytes())
        elif isinstance(value, CarryingAxes):
            found += [value.angle.tobytes(), value.rate.tobytes()]
        elif isinstance(value, Mapping):
            found += [part for name, array in value.items() for part in (name, array.tobytes())]
        else:
            found.append(value)
    return tuple(found)
