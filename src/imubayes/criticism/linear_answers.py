"""Questions to a diagnosed fit that linear algebra answers: what explains some rows, and what causes would do.

Both rest on what the diagnosis has made already.  Rows are ranked by the likelihood of its one evidence, beside the
likeliest hypothesis without an effect: a cause acts in the chosen rows alone, and the parameters of the model are as
all rows tell them.  With all rows chosen this is the log odds of the ranking.  A preview is the least squares at the
noise known beforehand that predicts Δχ² in the diagnosis.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from imubayes.adequacy.known_noise_fit import KnownNoisePoint, whitened_rows
from imubayes.criticism.diagnose import ExplainedFit
from imubayes.criticism.evidence.effect_variants import gain_of_coefficients
from imubayes.criticism.evidence.free_forms import AMPLITUDES
from imubayes.criticism.evidence.hypothesis import Solved
from imubayes.criticism.evidence.linear_problem import UNEXPECTED
from imubayes.criticism.evidence.model_search import states_noise
from imubayes.criticism.evidence.proposals import Screen, base_columns, conditional
from imubayes.criticism.formula_search import ResidualFormula, find_formula
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
    """Causes of chosen rows, the likeliest first, with the probabilities of noise alone and of an offset of them.

    `offset` is None where all rows are chosen, of which an offset is a bias.
    """

    causes: tuple[RankedCause, ...]
    nothing: float
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

    def rank(self, chosen: np.ndarray, without: Sequence[str] = ()) -> RowsRanking:
        """Return how probable single causes of chosen entries, (E,) bool, are; some effects left out."""
        of, odds = self.explained.of, dict[str, float]()
        for gain, n in self._screen.singles(conditional(of, self._nothing, chosen)):
            effect = of.variants[n].effect
            if effect not in without:
                odds[effect] = float(np.logaddexp(odds.get(effect, -math.inf), gain))
        offset = None if chosen[self.entries].all() else self._offset_gain(chosen)
        every = [0.0, *odds.values(), *([] if offset is None else [offset])]
        whole = float(np.logaddexp.reduce(every))
        ranked = sorted(odds.items(), key=lambda pair: -pair[1])[:_MOST_RANKED]
        causes = tuple(RankedCause(effect=e, probability=math.exp(o - whole), log_odds=o) for e, o in ranked)
        return RowsRanking(causes, math.exp(-whole), None if offset is None else math.exp(offset - whole))

    def _offset_gain(self, chosen: np.ndarray) -> float:
        """Return the log odds that each channel of the chosen rows is off by something outside the catalogue.

        With the prior probability and the amplitudes of the free forms of the evidence.
        """
        of, solved, gain = self.explained.of, self._nothing, math.log(UNEXPECTED / 2)
        for k in of.unit_of:
            rows, here = of.problem.rows[k], solved.at.hypothesis
            mask = chosen[rows.entry]
            if not mask.any():
                continue
            weight, scale = solved.at.weight.get(k), solved.scale[k]
            column = of.whiten(here, (rows.root * mask)[:, None], k, weight)[:, 0] / scale
            base = base_columns(of, solved.at, k) / scale
            where = of.taking_part(k, solved.at.columns, here.form)
            through = column @ base[:, :-1]
            left = column @ column - through @ solved.covariance[np.ix_(where, where)] @ through
            right = column @ (base[:, -1] - base[:, :-1] @ solved.mean[where])
            own, widths = np.array([[max(float(left), 0.0)]]), np.array(AMPLITUDES)[:, None]
            gains = gain_of_coefficients(own, np.array([float(right)]), widths, np.zeros(1, dtype=int))
            gain += float(np.logaddexp.reduce(gains)) - math.log(len(AMPLITUDES))
        return gain

    def formula(self, channel: str) -> ResidualFormula | None:
        """Return the simplest formula for what the model leaves of a channel; None where no term is worth its odds."""
        names = [each.name for each in self.explained.of.problem.channels]
        if channel not in names:
            raise input_error(
                f"no channel '{channel}'", "formula", closest_first(channel, names), "choose one of these"
            )
        at, posterior = self._nothing.at, self.explained.posterior
        return find_formula(
            self.explained.of, at, at.scale, posterior.fitted, self.explained.known, names.index(channel)
        )

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
        for _, n in self._screen.singles(conditional(of, self._nothing)):
            found.setdefault(of.variants[n].effect, n)
        return found

    def _columns(self, effect: str) -> tuple[np.ndarray, np.ndarray]:
        """Return the responses (E, C) to the coefficients of an effect, plain and whitened."""
        if effect not in self._white:
            if effect not in self.variants:
                allowed = closest_first(effect, self.variants)
                raise input_error(f"'{effect}' is no cause here", "preview", allowed, "choose one of the list")
            of = self.explained.of
            variant = of.variants[self.variants[effect]]
            scan = of.problem.candidates[variant.response].scan
            own = [each for each in self.explained.responses.candidates if each.scan.effect == effect]
            response = next((each for each in own if each.scan == scan), own[0])
            names = {of.problem.coefficients[k].parameter.name for k in variant.places}
            here = [k for k, each in enumerate(response.coefficients) if each.parameter.name in names]
            columns = response.columns[:, here]
            self._white[effect] = columns, whitened_rows(self.fit.model.problem, self.point.h, columns)
        return self._white[effect]

    def with_causes(self, effects: Sequence[str]) -> KnownNoisePoint:
        """Return the fit at the noise known beforehand with causes beside; raises InputError for an unknown one."""
        if not effects:
            return self.point
        plain, white = zip(*map(self._columns, effects), strict=True)
        return self.point.with_columns(np.concatenate(plain, axis=1), np.concatenate(white, axis=1))
