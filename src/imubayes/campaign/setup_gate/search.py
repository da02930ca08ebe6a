"""The search for the mistake that explains why a campaign does not show what its set-up says.

Evidence of the set-up as stated is compared with that of every suspected correction.  The misfit of the linear model of
plausible errors tells a valid campaign: there only the mistakes are tried that such errors could conceal.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from imubayes.campaign.setup_gate.evidence import ErrorModel, NormalTerms, total
from imubayes.campaign.setup_gate.mistakes import MISTAKES, LatitudeSign, Mistake
from imubayes.campaign.setup_gate.run_view import views_of
from imubayes.campaign_data import Campaign

ORDINARY_MISFIT, ORDINARY_ERROR = 1.0, 3.5
"""Misfit per output, and largest error in standard deviations, up to which a campaign is valid.  What is left out of
the linear model is assumed several times as large as it is in good units: shipped campaigns, hidden effects included,
have a misfit of 0.01 to 0.4 and errors within 1.6 standard deviations."""
DECISIVE = 25.0
"""Gain in twice the log evidence for a mistake to be named: odds of e^12 to 1 outweigh some thousand suspected mistakes
and priors of 1 in 100."""
DECISIVE_LATITUDE = 10.0
"""The same for the sign of the latitude, which is a single suspected mistake; up to `DECISIVE` it is a warning."""
LEAST_SHARE = 0.98
"""Least share of the excess misfit that the correction of a mistake removes."""
EQUIVALENT = 10.0
"""Mistakes whose gain is within this of the best are equally good explanations."""
_REFINEMENTS = 4
_SUSPECTS = 5  # runs whose own mistakes are tried


@dataclass(frozen=True)
class Explanation:
    """A mistake and its size, and by how much its correction raises twice the log evidence; the misfit then."""

    mistake: Mistake
    size: float
    gain: float
    misfit: float


@dataclass(frozen=True)
class Judgement:
    """Outcome of the search.

    Attributes
    ----------
    explanations : equally good ones, the most usual mistake first; empty where there is none.
    misfit : of the set-up as stated, per output.
    unexplained : run → misfit per output of the runs that disagree, where no mistake explains it.
    """

    explanations: tuple[Explanation, ...] = ()
    misfit: float = 0.0
    unexplained: tuple[tuple[str, float], ...] = ()


def judge_setup(campaign: Campaign) -> Judgement:
    """Return the mistake in the set-up of a campaign, if its outputs show one."""
    search = Search(campaign)
    if not search.views or not search.total.values:
        return Judgement()
    found = list(search.explanations())
    if not found:
        return Judgement(misfit=search.misfit, unexplained=tuple(search.disagreements()))
    best = max(found, key=lambda each: each.gain)
    equal = [each for each in found if each.gain >= best.gain - EQUIVALENT]
    return Judgement(tuple(_distinct(equal)), search.misfit)


def _distinct(found: Sequence[Explanation]) -> Iterator[Explanation]:
    """Yield the first explanation of each kind and scope."""
    seen = set()
    for each in found:
        key = (each.mistake.kind, each.mistake.scope)
        if key not in seen:
            seen.add(key)
            yield each


class Search:
    """Evidence of a campaign as stated, and of corrected ones."""

    def __init__(self, campaign: Campaign):
        self.campaign = campaign
        self.views = views_of(campaign)
        if not self.views:
            return
        self.model = ErrorModel(campaign)
        self.terms = [self.model.terms(view) for view in self.views]
        self.total = total(self.terms)
        self.stated = self.model.score(self.total)
        self.misfit = self.model.misfit(self.total) / max(self.total.values, 1)

    @property
    def ordinary(self) -> bool:
        """Whether the campaign shows what its set-up says, within plausible errors."""
        largest = float(np.abs(self.model.errors(self.total)).max())
        return self.misfit < ORDINARY_MISFIT and largest < ORDINARY_ERROR

    def explanations(self) -> Iterator[Explanation]:
        """Yield the mistakes that explain the outputs decisively, each kind in the order of the registry."""
        latitude_only = self.ordinary
        suspects = set() if latitude_only else self.suspects()
        for kind in [LatitudeSign] if latitude_only else MISTAKES:
            for mistake in kind.suspected(self.campaign, self.views):
                if mistake.scope.section != "run" or suspects.issuperset(mistake.scope.runs):
                    found = self.explain(mistake)
                    if self._explains(found):
                        yield found

    def _explains(self, found: Explanation) -> bool:
        if isinstance(found.mistake, LatitudeSign):
            return found.gain > DECISIVE_LATITUDE
        excess, left = self.misfit - ORDINARY_MISFIT / 2, found.misfit - ORDINARY_MISFIT / 2
        return found.gain > DECISIVE and (excess <= 0 or left < (1 - LEAST_SHARE) * excess)

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
        base = self.total
        for place in mistake.scope.runs:
            base = base - self.terms[place]
        size = self._best_size(mistake, base) if mistake.sizes else 0.0
        terms = self._corrected(mistake, base, size)
        gain = self.stated - self.model.score(terms)
        return Explanation(mistake, float(size), gain, self.model.misfit(terms) / max(terms.values, 1))

    def _best_size(self, mistake: Mistake, base: NormalTerms) -> float:
        """Return the size of least misfit, by parabolas about the best of the grid.

        The misfit is a single wave in an angle, so that a coarse grid finds the basin of its minimum.
        """
        tried = {size: self.model.misfit(self._corrected(mistake, base, size)) for size in mistake.sizes}
        best = min(tried, key=lambda size: tried[size])
        step = float(np.min(np.diff(sorted(mistake.sizes)))) / 2
        for _ in range(_REFINEMENTS):
            for near in (best - step, best + step):
                tried[near] = self.model.misfit(self._corrected(mistake, base, near))
            low, middle, high = tried[best - step], tried[best], tried[best + step]
            bend = low - 2 * middle + high
            vertex = best + step * float(np.clip((low - high) / 2 / bend, -1, 1)) if bend > 0 else best
            tried[vertex] = self.model.misfit(self._corrected(mistake, base, vertex))
            best = min(tried, key=lambda size: tried[size])
            step /= 6
        return best

    def _corrected(self, mistake: Mistake, base: NormalTerms, size: float) -> NormalTerms:
        terms = base
        for place in mistake.scope.runs:
            terms = terms + self._terms(mistake, place, size)
        return terms

    def _terms(self, mistake: Mistake, place: int, size: float) -> NormalTerms:
        found = self.model.terms(mistake.corrected(self.views, place, size))
        whole = self.terms[place].values
        # Rows without stimulus, at the end of a shifted run, count like the others on average.
        found = found if found.values in (whole, 0) else found.scaled(whole / found.values)
        return found.with_volume(2 * mistake.rescaled(self.views[place]))
