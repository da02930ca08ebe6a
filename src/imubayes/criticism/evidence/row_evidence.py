"""What explains some rows: single causes, the form of the leading explanation, and an offset of their own.

A cause of some rows is judged by how well it predicts them from all others, against that nothing is missing: p(some |
others, cause) / p(some | others), the factor by which these rows change its odds in the one evidence, times its prior
odds.  With all rows chosen this is the log odds of the ranking.  The noise is held.  Where the model correlates rows in
time, a row counts by what it adds to those before it.
"""

import math
from collections.abc import Collection
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from imubayes.criticism.evidence.free_forms import AMPLITUDES
from imubayes.criticism.evidence.hypothesis_evidence import Solved
from imubayes.criticism.evidence.linear_problem import UNEXPECTED
from imubayes.criticism.evidence.model_search import FormScan, states_noise
from imubayes.criticism.evidence.posterior_summary import ExplanationPosterior
from imubayes.criticism.evidence.proposals import Screen, conditional


@dataclass(frozen=True)
class RowOdds:
    """Natural logarithms of the odds of what explains some rows, against that nothing is missing.

    Attributes
    ----------
    effects : of each effect alone, its forms and channels together.
    form : of the form, or wrong record, of the leading explanation; None without one.
    offset : that the rows of each channel are off by something of their own; None if that was not asked.
    """

    effects: dict[str, float]
    form: float | None
    offset: float | None


class RowEvidence:
    """What explains rows that are chosen, from the hypotheses of a search."""

    def __init__(self, posterior: ExplanationPosterior):
        self.posterior, self.of = posterior, posterior.of
        self._screen = Screen(posterior.of)

    @cached_property
    def nothing(self) -> Solved:
        """That nothing is missing, at the most probable noise that the model states."""
        return self.of.solved(self.posterior.search.best(states_noise))

    @cached_property
    def alone(self) -> dict[int, float]:
        """The log odds of each variant alone by all rows, the largest first."""
        return {n: gain for gain, n in self._screen.singles(conditional(self.of, self.nothing))}

    def odds(self, chosen: np.ndarray, without: Collection[str] = (), *, offset: bool = True) -> RowOdds:
        """Return what explains chosen entries.

        Parameters
        ----------
        chosen : shape (E,), bool.
        without : effects that are left out.
        offset : whether an offset of these entries is weighed, which all entries have not.
        """
        others = self.by_others(chosen)
        by_rest = {n: gain for gain, n in self._screen.singles(conditional(self.of, others))}
        terms: dict[str, list[tuple[float, float, float]]] = {}
        for n, gain in self.alone.items():
            variant = self.of.variants[n]
            if variant.effect not in without:
                terms.setdefault(variant.effect, []).append((variant.log_odds, gain, by_rest[n]))
        odds: dict[str, float] = {}
        for effect, each in terms.items():
            prior, by_all, by_others = np.logaddexp.reduce(np.array(each), axis=0).tolist()
            odds[effect] = prior + by_all - by_others
        return RowOdds(odds, self.form_odds(others), self._offset_odds(chosen) if offset else None)

    def by_others(self, chosen: np.ndarray) -> Solved:
        """Return that nothing is missing by the rows that are not chosen, (E,) bool: chosen ones have no weight.

        Channels without chosen rows stay as they are, with the Gram matrices that are there.
        """
        of, at = self.of, self.nothing.at
        weight = {
            k: at.weight.get(k, np.ones(len(of.problem.rows[k].entry))) * ~chosen[of.problem.rows[k].entry]
            for k in of.unit_of
            if chosen[of.problem.rows[k].entry].any()
        }
        return of.solved(replace(at, weight={**at.weight, **weight}), self.nothing.scale)

    @cached_property
    def _scan(self) -> FormScan:
        """What forms gain beside that nothing is missing, by all rows."""
        return FormScan(self.of, self.nothing)

    def _offset_odds(self, chosen: np.ndarray) -> float:
        """Return the log odds that the chosen rows of each channel are off by something of their own.

        With the prior probability and the amplitudes of the free forms of the evidence.
        """
        found = math.log(UNEXPECTED / 2)
        for k in self.of.unit_of:
            rows = self.of.problem.rows[k]
            mask = chosen[rows.entry]
            if mask.any():
                gains = self._scan.grams([(rows.root * mask)[:, None]], k).gains(AMPLITUDES)
                found += float(np.logaddexp.reduce(gains[0])) - math.log(len(AMPLITUDES))
        return found

    def form_odds(self, others: Solved) -> float | None:
        """Return the log odds of the form, or wrong record, of the leading explanation; None without one."""
        form = self.posterior.top.hypothesis.form
        if form is None:
            return None
        return form.log_prior + self._scan.exact(form) - FormScan(self.of, others).exact(form)
