"""The search for the mistake that explains why a campaign does not show what its set-up says.

Evidence of the set-up as stated is compared with that of every suspected correction.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields

import numpy as np

from imubayes.campaign.setup_gate.drift_rivals import score_with_drift
from imubayes.campaign.setup_gate.evidence import ErrorModel, NormalTerms, total
from imubayes.campaign.setup_gate.mistakes import MISTAKES, Mistake
from imubayes.campaign.setup_gate.outer_axes import CarryingAxes
from imubayes.campaign.setup_gate.outer_mistakes import AxisZero
from imubayes.campaign.setup_gate.plausible_errors import POOR, Steadiness
from imubayes.campaign.setup_gate.run_view import RunView, views_of
from imubayes.campaign.setup_gate.temperature_mistakes import TEMPERATURE_MISTAKES, TemperatureReversed
from imubayes.campaign.setup_gate.unit_mistakes import UNIT_MISTAKES, ChannelGain
from imubayes.campaign.setup_gate.wrong_rates import RateFactor
from imubayes.campaign_data import Campaign

ORDINARY_MISFIT, ORDINARY_ERROR = 1.0, 3.5
"""Misfit per output, and largest error in standard deviations, up to which a campaign is valid.  What is left out of
the linear model is assumed several times as large as it is in good units: shipped campaigns, hidden effects included,
have a misfit of 0.01 to 0.4 and errors within 1.6 standard deviations."""
DECISIVE = 25.0
"""Gain in twice the log evidence, less the `unlikelihood` of a mistake, for it to be named: odds of e^12 to 1 outweigh
some thousand suspected mistakes and priors of 1 in 100."""
LEAST_SHARE = 0.98
"""Least share of the excess misfit that the correction of a mistake removes."""
MOST_MISTAKES = 3
"""Mistakes that are looked for together."""
TRIED_FIRST, TRIED_NEXT = 4, 1
"""How many of the best are tried as the first of several, and as each one after it: every trial is a search."""
EQUIVALENT = 10.0
"""Mistakes whose gain is within this of the best are equally good explanations; of hidden ones, `DECISIVE`."""
_REFINEMENTS, _REMEMBERED = 4, 256
_SETTLED = 0.01  # of twice the log likelihood: a tenth of a standard deviation of the size
_SUSPECTS = 5  # runs whose own mistakes are tried


@dataclass(frozen=True)
class Explanation:
    """A mistake and its size, and by how much its correction raises twice the log evidence.

    Attributes
    ----------
    misfit : per output with the correction.
    rival : gain of what passes for the mistake in a valid set-up.
    stopping : support beyond which the mistake stops a fit.
    uncertainty : standard deviation of the size; 0 where there is none.
    """

    mistake: Mistake
    size: float
    gain: float
    misfit: float
    rival: float = 0.0
    stopping: float = DECISIVE
    uncertainty: float = 0.0

    @property
    def support(self) -> float:
        """The gain less what speaks against the mistake beforehand."""
        return self.gain - self.mistake.unlikelihood

    @property
    def rivalled(self) -> bool:
        """Whether the outputs do not tell the mistake from what passes for it in a valid set-up."""
        return self.rival > 0 and self.gain < self.rival + DECISIVE


def equally_good(found: Sequence[Explanation], within: float = EQUIVALENT) -> tuple[Explanation, ...]:
    """Return the best explanations, the first of each kind and scope, and those that are like them."""
    best = max(each.support for each in found)
    equal = [each for each in found if each.support >= best - within]
    like = [each for each in found if any(each.mistake.like(other.mistake) for other in equal)]
    first = [each for each in like if not any(other.mistake.like(each.mistake) for other in equal)]
    return tuple(_distinct([*first, *sorted(equal, key=lambda each: -each.support), *like]))


def _support(first: Explanation, rest: Sequence[tuple[Explanation, ...]]) -> float:
    return first.support + sum(equal[0].support for equal in rest)


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
        found = [each for each in self._suspected() if each.support > DECISIVE and each.mistake.possible(each.size)]
        whole = [each for each in found if self._explains(each) and not self._passes(each)]
        if whole:
            return [equally_good(whole)]
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
        return Search(self.campaign, views=found.mistake.removed(self.views, found.size))

    def _suspected(self) -> Iterator[Explanation]:
        suspects = self.suspects()
        for kind in (*MISTAKES, AxisZero, *UNIT_MISTAKES, RateFactor, *TEMPERATURE_MISTAKES):
            for mistake in kind.suspected(self.campaign, self.views):
                if mistake.scope.section != "run" or suspects.issuperset(mistake.scope.runs):
                    yield self.explain(mistake)

    def _explains(self, found: Explanation) -> bool:
        excess, left = self.misfit - ORDINARY_MISFIT / 2, found.misfit - ORDINARY_MISFIT / 2
        return found.misfit < ORDINARY_MISFIT or left < (1 - LEAST_SHARE) * excess

    def passes_for_noise(self, mistake: Mistake) -> bool:
        """Whether errors as many times as large as the outputs of a mistaken unit explain as much.

        Outputs divided by a factor have smaller errors; a mistaken unit shows in the response to the input.
        """
        if not isinstance(mistake, ChannelGain) or mistake.factor < 1:
            return False
        factors = np.array([mistake.factor if place in mistake.places else 1.0 for place in self.model.places])
        larger = Search(self.campaign, Steadiness(factors, factors, factors), self.views, self.model.centre)
        return self.explain(mistake).gain < self.stated - larger.stated + DECISIVE

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
            if (well := self.stated - self.model.score(also)) > gain - mistake.as_usual:
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

        The misfit is a single wave in an angle, so that a coarse grid finds the basin of its minimum; terms quadratic
        in g make it two, and every basin is tried.  Where the Earth rate alone tells the size, a large g-sensitivity
        passes for its vertical part, and the evidence decides.
        """
        judged = self._evidence_as_stated if mistake.by_evidence else self.model.misfit
        tried = {size: judged(self._corrected(mistake, base, size)) for size in mistake.sizes}
        starts = [min(tried, key=lambda size: tried[size])]
        if self.model.squares:
            sizes = sorted(tried)
            around = zip(sizes, [sizes[-1], *sizes], [*sizes[1:], sizes[0]], strict=False)
            starts = [size for size, low, high in around if tried[size] <= min(tried[low], tried[high])] or starts
        found = [self._refined(mistake, base, dict(tried), start) for start in starts]
        return min(found, key=lambda each: each[1])[0]

    def _refined(
        self, mistake: Mistake, base: NormalTerms, tried: dict[float, float], best: float
    ) -> tuple[float, float]:
        """Return the size at the minimum next to one of the grid, and what is least there."""
        judged = self._evidence_as_stated if mistake.by_evidence else self.model.misfit
        step = float(np.min(np.diff(sorted(mistake.sizes)))) / 2
        for _ in range(_REFINEMENTS):
            before = tried[best]
            for near in (best - step, best + step):
                tried[near] = judged(self._corrected(mistake, base, near))
            low, middle, high = tried[best - step], tried[best], tried[best + step]
            bend = low - 2 * middle + high
            vertex = best + step * float(np.clip((low - high) / 2 / bend, -1, 1)) if bend > 0 else best
            tried[vertex] = judged(self._corrected(mistake, base, vertex))
            best = min((best - step, vertex, best, best + step), key=lambda size: tried[size])
            if before - tried[best] < _SETTLED:
                break
            step /= 6
        return best, tried[best]

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

    def with_drift(self, mistake: TemperatureReversed) -> tuple[float, float]:
        """Return −2 log evidence where the outputs of the run of a mistake drift: as stated, and corrected."""
        (place,) = mistake.scope.runs
        stated, rest = self.views[place], self.total - self.terms[place]
        views = (stated, mistake.corrected(self.views, place, 0.0))
        as_stated, corrected = (score_with_drift(self.model, view, rest) for view in views)
        return as_stated, corrected

    def _passes(self, found: Explanation) -> bool:
        """Whether what is no mistake explains the outputs as well."""
        return self.passes_for_noise(found.mistake) or self.passes_for_drift(found.mistake)

    def passes_for_drift(self, mistake: Mistake) -> bool:
        """Whether outputs that may drift do not tell that a column of temperatures is reversed."""
        if not isinstance(mistake, TemperatureReversed):
            return False
        stated, corrected = self.with_drift(mistake)
        return stated - corrected < DECISIVE

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
            if len(self.known) >= _REMEMBERED:
                del self.known[next(iter(self.known))]
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
        elif isinstance(value, CarryingAxes):
            found += [value.angle.tobytes(), value.rate.tobytes()]
        elif isinstance(value, Mapping):
            found += [part for name, array in value.items() for part in (name, array.tobytes())]
        else:
            found.append(value)
    return tuple(found)
