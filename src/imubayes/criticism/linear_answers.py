"""Questions to a diagnosed fit that linear algebra answers: what explains some rows, and what causes would do.

Both rest on what the diagnosis has made already.  A cause of some rows is judged by how well it predicts them from all
others, against that nothing is missing: p(some | others, cause) / p(some | others), the factor by which these rows
change its odds in the one evidence, times its prior odds.  With all rows chosen this is the log odds of the ranking.
The noise is held.  Where the model correlates rows in time, a row counts by what it adds to those before it.

A preview is the least squares at the noise known beforehand that predicts Δχ² in the diagnosis.
"""

import math
import threading
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from imubayes.adequacy.known_noise_fit import KnownNoisePoint, whitened_rows
from imubayes.criticism.diagnose import ExplainedFit
from imubayes.criticism.drawn_shape import DrawnCurve, drawn_shape, likest
from imubayes.criticism.evidence.free_forms import AMPLITUDES
from imubayes.criticism.evidence.hypothesis_evidence import Solved
from imubayes.criticism.evidence.linear_problem import UNEXPECTED
from imubayes.criticism.evidence.model_search import FormScan, states_noise
from imubayes.criticism.evidence.proposals import Screen, conditional
from imubayes.criticism.formula_search import ResidualFormula, find_formula, terms_beside, terms_of
from imubayes.foundations.errors import closest_first, input_error
from imubayes.foundations.progress import Tell
from imubayes.foundations.records import Record

_MOST_RANKED = 12


class RankedCause(Record):
    """A cause of chosen rows, with its probability among single effects, an offset of these rows, and none."""

    effect: str
    probability: float
    log_odds: float


@dataclass(frozen=True)
class RowsRanking:
    """Causes of chosen rows, the likeliest first, and the probabilities of what else they may be.

    Attributes
    ----------
    nothing : of noise alone.
    form : of the form outside the catalogue, or the wrong record, of the leading explanation; None without one.
    offset : of an offset of these rows alone; None where all rows are chosen, of which an offset is a bias.
    """

    causes: tuple[RankedCause, ...]
    nothing: float
    form: float | None
    offset: float | None


class LinearAnswers:
    """A diagnosed fit, and what it answers without a refit.

    Attributes
    ----------
    explained : the diagnosed fit.
    entries : shape (E,) bool, which count.
    """

    def __init__(self, explained: ExplainedFit):
        self.explained, self.fit = explained, explained.fit
        observations, entries = self.fit.model.problem.observations, self.fit.model.entries
        self.entries = (np.asarray(observations.weight) > 0) & ~np.asarray(entries.closing)
        self._white: dict[str, tuple[np.ndarray, np.ndarray]] = {}
        self._evidence = threading.Lock()  # it keeps the columns used last, which two threads must not do at once

    def prepare(self, tell: Tell) -> None:
        """Make ready what every question needs, so that the first one is answered as fast as the others."""
        tell("preparing previews")
        for effect in self.variants:
            self._columns(effect)

    # ---- what explains selected rows ----

    @cached_property
    def _nothing(self) -> Solved:
        of = self.explained.of
        return of.solved(self.explained.posterior.search.best(states_noise))

    @cached_property
    def _screen(self) -> Screen:
        return Screen(self.explained.of)

    @cached_property
    def _of_all(self) -> dict[int, float]:
        """The log odds of each variant alone by all rows."""
        return {n: gain for gain, n in self._screen.singles(conditional(self.explained.of, self._nothing))}

    def _others(self, chosen: np.ndarray) -> Solved:
        """Return that nothing is missing by the rows that are not chosen: chosen ones have no weight.

        Channels without chosen rows stay as they are, with the Gram matrices that are there.
        """
        of, at = self.explained.of, self._nothing.at
        weight = {
            k: at.weight.get(k, np.ones(len(of.problem.rows[k].entry))) * ~chosen[of.problem.rows[k].entry]
            for k in of.unit_of
            if chosen[of.problem.rows[k].entry].any()
        }
        return of.solved(replace(at, weight={**at.weight, **weight}), self._nothing.scale)

    def rank(self, chosen: np.ndarray, without: Sequence[str] = ()) -> RowsRanking:
        """Return how probable single causes of chosen entries, (E,) bool, are; some effects left out."""
        with self._evidence:
            return self._ranked(chosen, without)

    def _ranked(self, chosen: np.ndarray, without: Sequence[str]) -> RowsRanking:
        of, others = self.explained.of, self._others(chosen)
        by_rest = {n: gain for gain, n in self._screen.singles(conditional(of, others))}
        terms: dict[str, list[tuple[float, float, float]]] = {}
        for n, gain in self._of_all.items():
            variant = of.variants[n]
            if variant.effect not in without:
                terms.setdefault(variant.effect, []).append((variant.log_odds, gain, by_rest[n]))
        odds: dict[str, float] = {}
        for effect, each in terms.items():
            prior, by_all, by_others = np.logaddexp.reduce(np.array(each), axis=0).tolist()
            odds[effect] = prior + by_all - by_others
        form = self._form_odds(others)
        offset = None if chosen[self.entries].all() else self._offset_odds(chosen)
        whole = float(
            np.logaddexp.reduce([0.0, *odds.values(), *(each for each in (form, offset) if each is not None)])
        )
        ranked = sorted(odds.items(), key=lambda pair: -pair[1])[:_MOST_RANKED]
        causes = tuple(RankedCause(effect=e, probability=math.exp(o - whole), log_odds=o) for e, o in ranked)
        rest = (None if each is None else math.exp(each - whole) for each in (form, offset))
        return RowsRanking(causes, math.exp(-whole), *rest)

    @cached_property
    def _scan(self) -> FormScan:
        """What forms gain beside that nothing is missing, by all rows."""
        return FormScan(self.explained.of, self._nothing)

    def _offset_odds(self, chosen: np.ndarray) -> float:
        """Return the log odds that the chosen rows of each channel are off by something of their own.

        With the prior probability and the amplitudes of the free forms of the evidence.
        """
        of, found = self.explained.of, math.log(UNEXPECTED / 2)
        for k in of.unit_of:
            rows = of.problem.rows[k]
            mask = chosen[rows.entry]
            if mask.any():
                gains = self._scan.grams([(rows.root * mask)[:, None]], k).gains(AMPLITUDES)
                found += float(np.logaddexp.reduce(gains[0])) - math.log(len(AMPLITUDES))
        return found

    def _form_odds(self, others: Solved) -> float | None:
        """Return the log odds of the form, or wrong record, of the leading explanation; None without one."""
        form = self.explained.posterior.top.hypothesis.form
        if form is None:
            return None
        return form.log_prior + self._scan.exact(form) - FormScan(self.explained.of, others).exact(form)

    def formula(self, channel: str, drawing: DrawnCurve | None = None) -> ResidualFormula | None:
        """Return the simplest formula for what the model leaves of a channel, or the one that is like a drawing.

        None where no term is worth its odds; a drawing is its own term where no other is like it.
        """
        names = [each.name for each in self.explained.of.problem.of_channels]
        if channel not in names:
            raise input_error(
                f"no channel '{channel}'", "formula", closest_first(channel, names), "choose one of these"
            )
        fitted, known, place = self.explained.posterior.fitted, self.explained.known, names.index(channel)
        with self._evidence:
            of, at = self.explained.of, self._nothing.at
            if drawing is None:
                return find_formula(of, at, at.scale, fitted, known, place)
            drawn = drawn_shape(drawing, known, fitted.model.campaign.site.gravity)
            own = terms_of(fitted, [each for each in known if each.name == drawing.over], place)
            return likest(terms_beside(of, at, at.scale, fitted, [*own, drawn.term], place), drawn)

    def columns_of(self, found: ResidualFormula, drawing: DrawnCurve | None = None) -> np.ndarray:
        """Return the responses (E, T) to the terms of a formula."""
        campaign, known = self.fit.model.campaign, self.explained.known
        channel = [each.name for each in campaign.channels].index(found.channel)
        drawn = () if drawing is None else (drawn_shape(drawing, known, campaign.site.gravity).term,)
        terms = {each.expression: each.values for each in (*terms_of(self.fit, known, channel), *drawn)}
        here = self.entries & (self.fit.model.entries.channel == channel)
        return np.stack([np.where(here, terms[each.expression], 0.0) for each in found.terms], axis=1)

    # ---- what causes would do ----

    @property
    def point(self) -> KnownNoisePoint:
        """The fit at the noise known beforehand."""
        return self.explained.at_known_noise

    @cached_property
    def variants(self) -> dict[str, int]:
        """The variant that stands for each effect: of the leading explanation, or the best one alone."""
        of, found = self.explained.of, dict[str, int]()
        for slot in self.explained.posterior.slots:
            for member in slot.members:
                found.setdefault(member.effect, member.variant)
        for n in self._of_all:
            found.setdefault(of.variants[n].effect, n)
        return found

    def _columns(self, effect: str) -> tuple[np.ndarray, np.ndarray]:
        """Return the responses (E, C) to the coefficients of an effect, plain and whitened."""
        if effect not in self._white:
            if effect not in self.variants:
                allowed = closest_first(effect, self.variants)
                raise input_error(f"'{effect}' is no cause here", "preview", allowed, "choose one of the list")
            posterior = self.explained.posterior
            columns = posterior.columns_of(self.variants[effect], self.explained.responses)[1]
            self._white[effect] = columns, whitened_rows(self.fit.model.problem, self.point.h, columns)
        return self._white[effect]

    def with_causes(self, effects: Sequence[str]) -> KnownNoisePoint:
        """Return the fit at the noise known beforehand with causes beside; raises InputError for an unknown one."""
        if not effects:
            return self.point
        plain, white = zip(*map(self._columns, effects), strict=True)
        return self.point.with_columns(np.concatenate(plain, axis=1), np.concatenate(white, axis=1))
