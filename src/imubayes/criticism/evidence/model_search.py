"""Best-first search over explanations: effects are added, removed and swapped, noise and forms varied.

The search ends when no hypothesis is near.  Every hypothesis within `NEAR` nats of the best of its kind is expanded:
with and without a form.  Members are swapped at the noise of the full hypothesis, since a missing effect inflates the
noise of what lacks it.

Which form to add to a hypothesis is decided by quick gains of all forms and wrong inputs beside it, its noise held.
Forms of one channel and width are whitened, projected and decomposed together.  A form of several channels is first
scored as if these were apart, and the best are scored exactly.  The coefficients of a wrong input are the same on all
channels: it is scored exactly at once, since none of the channels may determine them alone.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np

from imubayes.criticism.evidence.effect_variants import visible
from imubayes.criticism.evidence.free_forms import ChosenForm, FormHypothesis
from imubayes.criticism.evidence.hypothesis_evidence import Evaluated, EvidenceOf, Hypothesis, Solved
from imubayes.criticism.evidence.linear_problem import NEGLIGIBLE, LinearProblem
from imubayes.criticism.evidence.noise_structures import SCALED, TAILED, NoiseOfUnit, NoiseStructure, NoiseUnit
from imubayes.criticism.evidence.proposals import Screen, base_columns, conditional, log_likelihood, residuals
from imubayes.criticism.evidence.wrong_input_forms import WrongRows
from imubayes.criticism.explanation_records import NEAR

_AT_ONCE = 160
"""Forms that are decomposed together, and the most probable ones whose gain is exact."""


@dataclass(frozen=True)
class FormGrams:
    """V (m, k, k) and u (m, k) of m forms on some channels, with their products with what takes part, (m, k, n)."""

    own: np.ndarray
    right: np.ndarray
    across: np.ndarray

    def gains(self, amplitudes: Sequence[float]) -> np.ndarray:
        """Return the log evidence of coefficients with standard deviations `amplitudes`, (m, A)."""
        squares, axes = np.linalg.eigh(self.own - self.across @ self.across.swapaxes(1, 2))
        whole = np.trace(self.own, axis1=1, axis2=2)[:, None]
        told = squares > NEGLIGIBLE * np.maximum(whole, np.finfo(float).tiny)
        along = np.where(told, (axes.swapaxes(1, 2) @ self.right[:, :, None])[:, :, 0] ** 2, 0.0)[:, None, :]
        squares = np.where(told, squares, 0.0)[:, None, :]
        variance = np.square(amplitudes)[None, :, None]
        return 0.5 * np.sum(along * variance / (1 + variance * squares) - np.log1p(variance * squares), axis=2)

    def of(self, places: Sequence[int]) -> "FormGrams":
        """Return those of some forms."""
        return FormGrams(self.own[places], self.right[places], self.across[places])

    def plus(self, other: "FormGrams") -> "FormGrams":
        """Return those of the same forms on these and further channels, with the same coefficients on all."""
        return FormGrams(self.own + other.own, self.right + other.right, self.across + other.across)


class FormScan:
    """Quick gains of every form beside a hypothesis without one."""

    def __init__(self, of: EvidenceOf, solved: Solved):
        at = solved.at
        self.of, self.at, self.scale = of, at, solved.scale
        squares, axes = np.linalg.eigh(solved.covariance)
        self._root = axes * np.sqrt(np.maximum(squares, 0.0))
        self._places = {k: of.taking_part(k, at.columns, at.hypothesis.form) for k in of.unit_of}
        self._bases = {k: base_columns(of, at, k) / self.scale[k] for k in of.unit_of}
        self._residual = {k: b[:, -1] - b[:, :-1] @ solved.mean[self._places[k]] for k, b in self._bases.items()}
        self._through = {k: b[:, :-1] @ self._root[self._places[k]] for k, b in self._bases.items()}

    def best(self, forms: Sequence[FormHypothesis]) -> list[tuple[float, ChosenForm]]:
        """Return forms with their gains against no form, prior probabilities included, the largest first."""
        gains, wrong = self._gains_apart(forms), self._gains_of_wrong(forms)
        quick: list[tuple[float, ChosenForm]] = []
        for n, form in enumerate(forms):
            if n in wrong:
                quick.append(_likeliest(form, tuple(form.columns), wrong[n]))
                continue
            parts = {k: gains[n, k] for k in form.columns}
            quick.append(_likeliest(form, tuple(parts), sum(parts.values(), np.zeros(len(form.amplitudes)))))
            if len(parts) > 1:
                quick += [_likeliest(form, (k,), part) for k, part in parts.items()]
        quick.sort(key=lambda each: -each[0])
        exact = [(self.exact(form) if _is_apart(form) else gain, form) for gain, form in quick[:_AT_ONCE]]
        return sorted(exact, key=lambda each: -each[0])

    def _gains_apart(self, forms: Sequence[FormHypothesis]) -> dict[tuple[int, int], np.ndarray]:
        """Return the gain of each form outside the catalogue on each of its channels, (A,)."""
        chosen = [n for n, form in enumerate(forms) if form.wrong is None]
        found: dict[tuple[int, int], np.ndarray] = {}
        for k in self.of.unit_of:
            for members, grams in self._grams_of(forms, chosen, k):
                gains = grams.gains(forms[members[0]].amplitudes)
                found |= {(n, k): gain for n, gain in zip(members, gains, strict=True)}
        return found

    def _gains_of_wrong(self, forms: Sequence[FormHypothesis]) -> dict[int, np.ndarray]:
        """Return the gain of each wrong input on all of its channels together, (A,): its coefficients are the same."""
        chosen = [n for n, form in enumerate(forms) if form.wrong is not None]
        whole: dict[int, FormGrams] = {}
        for k in self.of.unit_of:
            for members, grams in self._grams_of(forms, chosen, k):
                for place, n in enumerate(members):
                    one = grams.of([place])
                    whole[n] = whole[n].plus(one) if n in whole else one
        return {n: grams.gains(forms[n].amplitudes)[0] for n, grams in whole.items()}

    def _grams_of(
        self, forms: Sequence[FormHypothesis], chosen: Sequence[int], channel: int
    ) -> Iterator[tuple[list[int], FormGrams]]:
        """Yield the Gram matrices of chosen forms on a channel, those of one width and amplitudes together."""
        alike: dict[tuple[int, int, tuple[float, ...]], list[int]] = {}
        for n in chosen:
            if channel in forms[n].columns:
                own = forms[n].columns[channel]
                alike.setdefault((id(own.every), own.width, forms[n].amplitudes), []).append(n)
        for members in alike.values():
            columns = [forms[n].columns[channel] for n in members]
            every = columns[0].every
            if every is not None:
                yield members, self._grams_of_runs(every, channel).of([each.series for each in columns])
                continue
            for first in range(0, len(columns), _AT_ONCE):
                some = [each.make() for each in columns[first : first + _AT_ONCE]]
                yield members[first : first + _AT_ONCE], self.grams(some, channel)

    def _white(self, columns: np.ndarray, channel: int) -> np.ndarray:
        at = self.at
        return self.of.whiten(at.hypothesis, columns, channel, at.weight.get(channel)) / self.scale[channel]

    def grams(self, columns: Sequence[np.ndarray], channel: int) -> FormGrams:
        """Return the Gram matrices of forms of one width on a channel."""
        k, width = channel, columns[0].shape[1]
        white = self._white(np.concatenate(columns, axis=1), k)
        apart = white.reshape(len(white), -1, width).transpose(1, 2, 0)
        across = (white.T @ self._through[k]).reshape(-1, width, self._root.shape[1])
        return FormGrams(apart @ apart.swapaxes(1, 2), (white.T @ self._residual[k]).reshape(-1, width), across)

    def _grams_of_runs(self, every: np.ndarray, channel: int) -> FormGrams:
        """Return the Gram matrices of forms of single runs that share columns; no noise reaches from run to run."""
        white, starts = self._white(every, channel), [start for start, _ in self.of.problem.rows[channel].series]
        beside, width = np.column_stack([white, self._residual[channel], self._through[channel]]), every.shape[1]
        joined = np.stack([np.add.reduceat(one[:, None] * beside, starts) for one in white.T], axis=1)
        return FormGrams(joined[:, :, :width], joined[:, :, width], joined[:, :, width + 1 :])

    def exact(self, form: ChosenForm) -> float:
        """Return the gain of a form with its channels together, its prior probability included."""
        own, right = np.zeros((form.width, form.width)), np.zeros(form.width)
        across = np.zeros((form.width, self._root.shape[1]))
        for k in form.channels:
            span, part = form.span(k), self.grams([form.form.columns[k].make()], k)
            own[span, span] += part.own[0]
            right[span] += part.right[0]
            across[span] += part.across[0]
        whole = FormGrams(own[None], right[None], across[None])
        return float(whole.gains([form.amplitude])[0, 0]) + form.log_prior

    def rows(self, wrong: WrongRows) -> Iterator[tuple[float, ChosenForm]]:
        """Yield the best wrong row of each column and amplitude, with its gain."""
        count, gain = len(wrong.run), {k: self._gain(k) for k in self.of.unit_of}
        for name, columns in wrong.columns.items():
            own, right, through = np.zeros(count), np.zeros(count), np.zeros((count, self._root.shape[1]))
            for k in columns:
                row, white = wrong.row[k], columns[k] * gain[k] / self.scale[k]
                np.add.at(own, row, white**2)
                np.add.at(right, row, white * self._residual[k])
                np.add.at(through, row, white[:, None] * self._through[k])
            left = np.maximum(own - np.sum(through**2, axis=1), 0.0)
            for amplitude in wrong.amplitudes:
                variance = amplitude**2
                gains = 0.5 * variance * right**2 / (1 + variance * left) - 0.5 * np.log1p(variance * left)
                best = int(np.argmax(gains))
                form = wrong.form(name, best)
                chosen = ChosenForm(form, amplitude, tuple(form.columns))
                yield float(gains[best]) + chosen.log_prior, chosen

    def _gain(self, channel: int) -> np.ndarray | float:
        """Return the change of a whitened row by itself, (n,): what it does to later rows is left to the evaluation."""
        correlations = self.of.problem.rows[channel].correlations
        return correlations[self.of.noise(self.at.hypothesis, channel).size].gain if correlations else 1.0


def _is_apart(form: ChosenForm) -> bool:
    """Return whether a form has coefficients of its own on each of several channels."""
    return len(form.channels) > 1 and form.form.wrong is None


def _likeliest(form: FormHypothesis, channels: tuple[int, ...], gains: np.ndarray) -> tuple[float, ChosenForm]:
    """Return a form at its most probable amplitude, with its gain and prior probability."""
    best = int(np.argmax(gains)) if len(gains) else 0
    chosen = ChosenForm(form, form.amplitudes[best], channels)
    return (float(gains[best]) if math.isfinite(gains[best]) else -math.inf) + chosen.log_prior, chosen


LARGE = 50.0
"""Nats of an effect that is taken before any other is looked for."""
PROPOSED = 3 * NEAR
"""Nats below the best within which a quick gain is worth an evaluation, which differs from it by a few nats."""
_BREADTH, _FORMS = 7, 4
"""Additions, pairs, swaps and forms that are evaluated about a hypothesis."""
_MOST_EXPANDED, _PAIRED_UP_TO = 24, 2
"""Hypotheses that are expanded, and effects of those to which pairs are added."""


class ModelSearch:
    """A search, and all hypotheses that it has evaluated.

    Parameters
    ----------
    heard : called with the search after each hypothesis that it evaluates.
    """

    def __init__(self, problem: LinearProblem, heard: "Callable[[ModelSearch], None]" = lambda _: None):
        self.of, self._heard = EvidenceOf(problem), heard
        self.forms: Sequence[FormHypothesis] = ()
        self.wrong_rows: WrongRows | None = None
        empty = self.of.evaluate(Hypothesis((), self.of.stated))
        as_known = self.of.solved(empty, np.ones(len(problem.rows)))
        self.of.variants = visible(self.of.variants, conditional(self.of, as_known).own)
        self._screen = Screen(self.of)
        self._expanded: set[Hypothesis] = set()
        self._scanned: set[Hypothesis] = set()

    def about(self, problem: LinearProblem) -> "ModelSearch":
        """Return a search of the same campaign linearised elsewhere, which the same listener hears."""
        return ModelSearch(problem, self._heard)

    @property
    def known(self) -> list[Evaluated]:
        """All evaluated hypotheses."""
        return list(self.of.known.values())

    def best(self, which: Callable[[Evaluated], bool] = lambda _: True) -> Evaluated:
        """Return the most probable hypothesis that is possible, of those that fulfil a condition."""
        return max((each for each in self.known if possible(each) and which(each)), key=lambda each: each.log_posterior)

    @cached_property
    def _as_fitted(self) -> Evaluated:
        """That nothing is missing, with correlations in time as stated or as fitted, whichever is likelier."""
        empty = self.of.evaluate(Hypothesis((), self.of.stated))
        fitted = self.of.evaluate(Hypothesis((), self.of.as_fitted), empty)
        return max(empty, fitted, key=lambda each: each.log_posterior)

    @cached_property
    def large_effects(self) -> Evaluated:
        """The hypothesis with every effect that stands far out, one after the other, at the noise as stated."""
        at = self._as_fitted
        while True:
            singles = self._screen.singles(conditional(self.of, self.of.solved(at)))
            gain, variant = next(
                ((g, n) for g, n in singles if self._allowed(at.hypothesis.including(n))), (-np.inf, -1)
            )
            new = self._get(at.hypothesis.including(variant), at) if gain > LARGE else None
            if new is None or new.log_posterior < at.log_posterior + LARGE:
                return at
            at = new

    def run(self, forms: Sequence[FormHypothesis] = (), wrong_rows: WrongRows | None = None) -> "ModelSearch":
        """Search, with forms outside the catalogue and wrong inputs, and return itself."""
        self.forms, self.wrong_rows = forms, wrong_rows
        empty = self._as_fitted
        # Outliers distort parameters, and are seen only if all channels bound them at once.
        others = [tuple(_first(unit, each) for unit in self.of.units) for each in (SCALED, TAILED)]
        starts = [one for noise in others if (one := self._get(Hypothesis((), noise))) is not None]
        start = max((empty, *starts), key=lambda each: each.log_posterior)
        large, none = self._vary_noise(self.large_effects), self._vary_noise(start)
        if large.log_posterior < none.log_posterior + LARGE:
            self._expand(self.best(states_noise))
            self._expand(self.best(lambda each: not each.hypothesis.variants))
            self._expand_at_less_noise()
        self._vary_noise(self.best(_pure))
        self._grow(_pure, _MOST_EXPANDED)
        for _ in range(2):
            self._scan_forms()
            self._expand_beyond_priors()
            formed = [each for each in self.known if _formed(each)]
            near = max((each.log_posterior for each in formed), default=-np.inf)
            if near < self.best().log_posterior - PROPOSED:
                break
            self._vary_noise(max(formed, key=lambda each: each.log_posterior))
            self._grow(_formed, _MOST_EXPANDED // 2)
            self._grow(_pure, _MOST_EXPANDED // 4)
        self._vary_noise(self.best())
        top = self.best()
        for each in top.hypothesis.variants:
            self._get(top.hypothesis.without(each), top)
        return self

    def _get(self, hypothesis: Hypothesis, start: Evaluated | None = None) -> Evaluated | None:
        try:
            found = self.of.evaluate(hypothesis, start)
        except np.linalg.LinAlgError:
            return None
        self._heard(self)
        return found

    def _allowed(self, hypothesis: Hypothesis) -> bool:
        variants = [self.of.variants[each] for each in hypothesis.variants]
        return not any(one.excludes(other) for one, other in combinations(variants, 2))

    def _try(self, hypothesis: Hypothesis, start: Evaluated) -> None:
        if self._allowed(hypothesis):
            self._get(hypothesis, start)

    # ---- noise ----

    def _vary_noise(self, at: Evaluated) -> Evaluated:
        """Return the most probable noise about a hypothesis: structures, then scatters, one unit after the other."""
        for _ in range(2):
            before = at
            for place, unit in enumerate(self.of.units):
                for choices in (unit.structures, unit.scatters, unit.sizes):
                    at = self._likeliest(at, place, choices(at.hypothesis.noise[place]))
            if at is before:
                break
        return at

    def _likeliest(self, at: Evaluated, place: int, choices: Sequence[NoiseOfUnit]) -> Evaluated:
        """Return the most probable of some choices of noise in a unit.

        Those that the residual excludes are not tried, and of a family none after one that is worse.
        """
        residual, channels = residuals(self.of, at), self.of.units[place].channels
        quick = {each: log_likelihood(self.of, residual, channels, each) for each in choices}
        present, worse = at.hypothesis.noise[place], set[str]()
        own = quick.get(present, max(quick.values()))
        for choice in sorted(quick, key=lambda each: -quick[each]):
            if quick[choice] < own - NEAR:
                break
            if choice == present or choice.family in worse:
                continue
            new = self._get(at.hypothesis.with_noise(place, choice), at)
            if new is not None and new.log_posterior > at.log_posterior + 1e-9:
                at = new
            else:
                worse.add(choice.family)
        return at

    # ---- effects ----

    def _expand_at_less_noise(self) -> None:
        """Expand the empty hypothesis with the least noise of each unit that has more: what noise absorbs shows there.

        The best additions get the noise that is most probable with them.
        """
        at = self.best(_no_effects)
        for place, unit in enumerate(self.of.units):
            least = min(unit.stated, key=lambda each: each.scatter)
            if at.hypothesis.noise[place] == least:
                continue
            quiet = self._get(at.hypothesis.with_noise(place, least), at)
            if quiet is None:
                continue
            self._expand(quiet)
            noise = quiet.hypothesis.noise
            found = [each for each in self.known if each.hypothesis.noise == noise and each.hypothesis.variants]
            if found:
                self._vary_noise(max(found, key=lambda each: each.log_posterior))

    def _expand(self, at: Evaluated) -> None:
        """Evaluate what lies about a hypothesis: an effect more, a pair more, one less, one or two in place of one."""
        self._expanded.add(at.hypothesis)
        likelihood = conditional(self.of, self.of.solved(at))
        singles = [each for each in self._screen.singles(likelihood) if each[0] > -PROPOSED]
        allowed = [each for each in singles if self._allowed(at.hypothesis.including(each[1]))]
        for _, variant in allowed[:_BREADTH]:
            self._get(at.hypothesis.including(variant), at)
        if len(at.hypothesis.variants) < _PAIRED_UP_TO:
            for gain, pair in self._screen.pairs(likelihood, [n for _, n in allowed[: 4 * _BREADTH]])[:_BREADTH]:
                if gain > -PROPOSED:
                    self._try(at.hypothesis.including(*pair), at)
        for variant in at.hypothesis.variants:
            self._swap(at, variant)

    def _swap(self, at: Evaluated, variant: int) -> None:
        less = self._get(at.hypothesis.without(variant), at)
        if less is None:
            return
        likelihood = conditional(self.of, self.of.solved(less, at.scale))
        singles = self._screen.singles(likelihood)
        for _, other in singles[:_BREADTH]:
            self._try(less.hypothesis.including(other), at)
        if len(less.hypothesis.variants) < _PAIRED_UP_TO:
            for _, pair in self._screen.pairs(likelihood, [n for _, n in singles[: 4 * _BREADTH]])[:_BREADTH]:
                self._try(less.hypothesis.including(*pair), at)

    def _expand_beyond_priors(self) -> None:
        """Expand the most probable prior that is too narrow: an effect that it forbids is found beside it."""
        found = [each for each in self.known if beyond_prior(each) and each.hypothesis not in self._expanded]
        stated = self.best(states_noise).log_posterior
        best = max(found, key=lambda each: each.log_posterior, default=None)
        if best is not None and best.log_posterior > stated + LARGE:
            self._expand(best)
            self._vary_noise(self.best(beyond_prior))

    def _grow(self, which: Callable[[Evaluated], bool], most: int) -> None:
        for _ in range(most):
            mine = [each for each in self.known if which(each)]
            top = max(each.log_posterior for each in mine)
            todo = [each for each in mine if each.hypothesis not in self._expanded and each.log_posterior > top - NEAR]
            if not todo:
                return
            self._expand(max(todo, key=lambda each: each.log_posterior))
            new = self.best(which)
            if new.log_posterior > top:
                self._vary_noise(new)

    # ---- forms ----

    def _scan_forms(self) -> None:
        """Add forms to the most probable effects, to those less each, and to none at the noise as known or least."""
        best = self.best(_pure)
        without = [self._get(best.hypothesis.without(each), best) for each in best.hypothesis.variants]
        for less in without:
            # An effect that stands far out is swapped for a form if one is expanded.
            if less is not None and less.log_posterior > best.log_posterior - LARGE:
                self._add_forms(less, best.scale)
        self._add_forms(best, best.scale)
        none, stated = self._get(Hypothesis((), best.hypothesis.noise), best), self.best(states_noise)
        if none is not None:
            self._add_forms(none, best.scale)
        self._add_forms(stated, np.minimum(1.0, best.scale))
        # A scatter between runs absorbs a wrong record as it does an effect.
        quiet = tuple(min(unit.stated, key=lambda each: each.scatter) for unit in self.of.units)
        if (least := self._get(Hypothesis((), quiet), stated)) is not None:
            self._add_forms(least, np.minimum(1.0, best.scale))

    def _add_forms(self, at: Evaluated, scale: np.ndarray) -> None:
        if at.hypothesis in self._scanned:
            return
        self._scanned.add(at.hypothesis)
        scan = FormScan(self.of, self.of.solved(at, scale))
        rows = [] if self.wrong_rows is None else sorted(scan.rows(self.wrong_rows), key=lambda each: -each[0])
        found, seen = scan.best(self.forms), set[tuple[object, ...]]()
        wrong = sorted([*rows, *(each for each in found if each[1].form.wrong is not None)], key=lambda each: -each[0])
        for proposed, most in (found, _FORMS), (wrong, _FORMS // 2):
            told = 0
            for gain, form in proposed:
                key = form.form.name, form.form.run, form.form.row, form.channels
                if gain < -PROPOSED / 2 or told >= most:
                    break
                if key not in seen:
                    seen.add(key)
                    told += self._with_form(at, form)

    def _with_form(self, at: Evaluated, form: ChosenForm) -> bool:
        """Evaluate a form, with amplitudes beside it as well; return whether it is possible."""
        hypothesis = at.hypothesis
        first = self._get(Hypothesis(hypothesis.variants, hypothesis.noise, form), at)
        if first is not None and not possible(first):
            return False
        amplitudes = form.form.amplitudes
        place = amplitudes.index(form.amplitude)
        for other in amplitudes[max(place - 1, 0) : place + 2]:
            self._get(Hypothesis(hypothesis.variants, hypothesis.noise, form.at(other)), first or at)
        return True


def _first(unit: NoiseUnit, structure: NoiseStructure) -> NoiseOfUnit:
    """Return the noise of a structure; of a unit that has none of it, as stated."""
    return next((each for each in unit.choices if each.rows == structure), unit.as_fitted)


def _pure(each: Evaluated) -> bool:
    return each.hypothesis.form is None


def _formed(each: Evaluated) -> bool:
    return each.hypothesis.form is not None and possible(each)


def possible(found: Evaluated) -> bool:
    """Return whether a record can be wrong by what a hypothesis says.

    An impossible size is nothing to look about: the noise beside it is not that of what comes after it.
    """
    form = found.hypothesis.form
    if form is None or form.form.wrong is None:
        return True
    return form.form.wrong.possible(found.mean[len(found.columns) :] * form.form.unit)


def beyond_prior(each: Evaluated) -> bool:
    """Return whether a hypothesis is that a prior is too narrow."""
    form = each.hypothesis.form
    return form is not None and form.form.wrong is not None and form.form.wrong.form == "prior"


def _no_effects(each: Evaluated) -> bool:
    return _pure(each) and not each.hypothesis.variants


def states_noise(each: Evaluated) -> bool:
    """Return whether a hypothesis is that nothing is missing."""
    return _no_effects(each) and all(noise.stated for noise in each.hypothesis.noise)
