"""Best-first search: effects are added, removed and swapped, noise and forms varied, until no hypothesis is near.

Every hypothesis within `NEAR` nats of the best of its kind is expanded: with and without a form.  Members are
swapped at the noise of the full hypothesis, since a missing effect inflates the noise of what lacks it.
"""

from collections.abc import Callable, Sequence
from functools import cached_property
from itertools import combinations

import numpy as np

from imubayes.criticism.evidence.effect_variants import visible
from imubayes.criticism.evidence.evidence_record import NEAR
from imubayes.criticism.evidence.form_scan import FormScan
from imubayes.criticism.evidence.free_forms import ChosenForm, FormHypothesis
from imubayes.criticism.evidence.hypothesis import Evaluated, EvidenceOf, Hypothesis
from imubayes.criticism.evidence.linear_problem import LinearProblem
from imubayes.criticism.evidence.noise_structures import SCALED, TAILED, NoiseOfUnit, NoiseStructure
from imubayes.criticism.evidence.proposals import Screen, conditional, log_likelihood, residuals
from imubayes.criticism.evidence.wrong_input_forms import WrongRows

LARGE = 50.0
"""Nats of an effect that is taken before any other is looked for."""
PROPOSED = 3 * NEAR
"""Nats below the best within which a quick gain is worth an evaluation, which differs from it by a few nats."""
_BREADTH, _FORMS = 7, 4
"""Additions, pairs, swaps and forms that are evaluated about a hypothesis."""
_MOST_EXPANDED, _PAIRED_UP_TO = 24, 2
"""Hypotheses that are expanded, and effects of those to which pairs are added."""


class ModelSearch:
    """A search, and all hypotheses that it has evaluated."""

    def __init__(self, problem: LinearProblem):
        self.of = EvidenceOf(problem)
        self.forms: Sequence[FormHypothesis] = ()
        self.wrong_rows: WrongRows | None = None
        empty = self.of.evaluate(Hypothesis((), self.of.stated))
        as_known = self.of.solved(empty, np.ones(len(problem.rows)))
        self.of.variants = visible(self.of.variants, conditional(self.of, as_known).own)
        self._screen = Screen(self.of)
        self._expanded: set[Hypothesis] = set()
        self._scanned: set[Hypothesis] = set()

    @property
    def known(self) -> list[Evaluated]:
        """All evaluated hypotheses."""
        return list(self.of.known.values())

    def best(self, which: Callable[[Evaluated], bool] = lambda _: True) -> Evaluated:
        """Return the likeliest hypothesis of those that fulfil a condition."""
        return max((each for each in self.known if which(each)), key=lambda each: each.log_posterior)

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
        # Outliers distort parameters, and are seen only where all channels bound them at once.
        others = [tuple(_first(unit.choices, each) for unit in self.of.units) for each in (SCALED, TAILED)]
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
            return self.of.evaluate(hypothesis, start)
        except np.linalg.LinAlgError:
            return None

    def _allowed(self, hypothesis: Hypothesis) -> bool:
        variants = [self.of.variants[each] for each in hypothesis.variants]
        return not any(one.excludes(other) for one, other in combinations(variants, 2))

    def _try(self, hypothesis: Hypothesis, start: Evaluated) -> None:
        if self._allowed(hypothesis):
            self._get(hypothesis, start)

    # ---- noise ----

    def _vary_noise(self, at: Evaluated) -> Evaluated:
        """Return the likeliest noise about a hypothesis: structures, then scatters, one unit after the other."""
        for _ in range(2):
            before = at
            for place, unit in enumerate(self.of.units):
                for choices in (unit.structures, unit.scatters, unit.sizes):
                    at = self._likeliest(at, place, choices(at.hypothesis.noise[place]))
            if at is before:
                break
        return at

    def _likeliest(self, at: Evaluated, place: int, choices: Sequence[NoiseOfUnit]) -> Evaluated:
        """Return the likeliest of some choices of noise in a unit.

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

        The best additions get the noise that is likeliest with them.
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
        """Add the best forms to the likeliest effects, to those less each, and to none at the noise as known."""
        best = self.best(_pure)
        without = [self._get(best.hypothesis.without(each), best) for each in best.hypothesis.variants]
        for less in without:
            # An effect that stands far out is swapped for a form where one is expanded.
            if less is not None and less.log_posterior > best.log_posterior - LARGE:
                self._add_forms(less, best.scale)
        self._add_forms(best, best.scale)
        none, stated = self._get(Hypothesis((), best.hypothesis.noise), best), self.best(states_noise)
        if none is not None:
            self._add_forms(none, best.scale)
        self._add_forms(stated, np.minimum(1.0, best.scale))

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
                    told += 1
                    self._with_form(at, form)

    def _with_form(self, at: Evaluated, form: ChosenForm) -> None:
        """Evaluate a form, with amplitudes beside it as well."""
        hypothesis = at.hypothesis
        first = self._get(Hypothesis(hypothesis.variants, hypothesis.noise, form), at)
        amplitudes = form.form.amplitudes
        place = amplitudes.index(form.amplitude)
        for other in amplitudes[max(place - 1, 0) : place + 2]:
            self._get(Hypothesis(hypothesis.variants, hypothesis.noise, form.at(other)), first or at)


def _first(choices: Sequence[NoiseOfUnit], structure: NoiseStructure) -> NoiseOfUnit:
    return next(each for each in choices if each.rows == structure)


def _pure(each: Evaluated) -> bool:
    return each.hypothesis.form is None


def _formed(each: Evaluated) -> bool:
    return each.hypothesis.form is not None


def _no_effects(each: Evaluated) -> bool:
    return _pure(each) and not each.hypothesis.variants


def states_noise(each: Evaluated) -> bool:
    """Tell whether a hypothesis is that nothing is missing."""
    return _no_effects(each) and all(noise.stated for noise in each.hypothesis.noise)
