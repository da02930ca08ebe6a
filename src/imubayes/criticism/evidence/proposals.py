"""What to add to a hypothesis: quick gains of every effect, of pairs and of every form, its noise held.

Conditional on a hypothesis with its scales, the likelihood of further coefficients is normal: V and u past all that
takes part are the same for every candidate, so that all are scored from one matrix.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from imubayes.criticism.evidence.free_forms import ChosenForm, FreeForm
from imubayes.criticism.evidence.hypothesis import (
    Evaluated,
    EvidenceOf,
    gain_of_coefficients,
    inverse,
    scale_mode,
    tail_log_density,
    with_scatter,
)
from imubayes.criticism.evidence.noise_structures import HeavyTails, NoiseOfUnit
from imubayes.criticism.evidence.wrong_input_forms import WrongRows

_EXACT_FORMS, _TAIL_ROUNDS = 160, 8
_LEAST_RETAINED = 1e-9
_SHOWN_SD = 3.0
"""Standard deviations at which an effect of its largest typical size would stand, to be looked for."""


@dataclass(frozen=True)
class Conditional:
    """The normal likelihood exp(uᵀb − bᵀVb/2) of every coefficient beside a hypothesis: V (C, C) and u (C,)."""

    own: np.ndarray
    right: np.ndarray


def at_scales(of: EvidenceOf, at: Evaluated, scale: np.ndarray) -> Evaluated:
    """Return a hypothesis with its linear algebra at other noise scales, (K,): a larger noise hides what is missing."""
    whole, right = np.diag(at.precision).astype(float), at.pull.copy()
    for k in of.unit_of:
        base, _ = _base(of, at, k)
        where = _where(of, at, k)
        whole[np.ix_(where, where)] += base[:, :-1].T @ base[:, :-1] / scale[k] ** 2
        right[where] += base[:, :-1].T @ base[:, -1] / scale[k] ** 2
    covariance = inverse(whole)
    return replace(at, scale=scale, covariance=covariance, mean=covariance @ right)


def _where(of: EvidenceOf, at: Evaluated, channel: int) -> np.ndarray:
    """Return the places of the columns of `_base` among all that take part."""
    here, _ = of.select(channel, at.columns)
    found, form = np.flatnonzero(here), at.hypothesis.form
    if form is not None and channel in form.channels:
        span = form.span(channel)
        found = np.concatenate([found, len(at.columns) + np.arange(span.start, span.stop)])
    return found


def _base(of: EvidenceOf, at: Evaluated, channel: int) -> tuple[np.ndarray, np.ndarray]:
    """Return whitened columns of a channel that take part, the residual last, and all that it responds to."""
    weight, form = at.weight.get(channel), at.hypothesis.form
    white = of.whitened(at.hypothesis, channel, weight)
    _, place = of.select(channel, at.columns)
    parts = [white[:, place]]
    if form is not None and channel in form.channels:
        parts.append(of.form_columns(at.hypothesis, form, channel, weight))
    return np.concatenate([*parts, white[:, -1:]], axis=1), white


def conditional(of: EvidenceOf, at: Evaluated) -> Conditional:
    """Return the likelihood of every coefficient beside a hypothesis."""
    problem, count = of.problem, len(of.problem.coefficients)
    own, right, across = np.zeros((count, count)), np.zeros(count), np.zeros((len(at.precision), count))
    every = problem.own + np.arange(count)
    for k in of.unit_of:
        gram = of.gram(at.hypothesis, k, at.weight.get(k))
        here, place = of.select(k, every)
        which, inverse = np.flatnonzero(here), 1 / at.scale[k] ** 2
        own[np.ix_(which, which)] += inverse * gram.products[np.ix_(place, place)]
        right[which] += inverse * gram.products[place, -1]
        taking, mine = of.select(k, at.columns)
        across[np.ix_(np.flatnonzero(taking), which)] += inverse * gram.products[np.ix_(mine, place)]
        form = at.hypothesis.form
        if form is not None and k in form.channels:
            columns = of.form_columns(at.hypothesis, form, k, at.weight.get(k))
            white = of.whitened(at.hypothesis, k, at.weight.get(k))
            span = _where(of, at, k)[len(mine) :]
            across[np.ix_(span, which)] += inverse * columns.T @ white[:, place]
    return Conditional(own - across.T @ at.covariance @ across, right - across.T @ at.mean)


def residuals(of: EvidenceOf, at: Evaluated) -> dict[int, np.ndarray]:
    """Return the residual of each channel at the posterior mean, (n,), in units of the noise known beforehand."""
    found, form = {}, at.hypothesis.form
    for k in of.unit_of:
        here, place = of.select(k, at.columns)
        rows = of.problem.rows[k].columns
        found[k] = rows[:, -1] - rows[:, place] @ at.mean[np.flatnonzero(here)]
        if form is not None and k in form.channels:
            own = _where(of, at, k)[len(place) :]
            found[k] = found[k] - form.form.columns[k] @ at.mean[own]
    return found


def log_likelihood(
    of: EvidenceOf, residual: dict[int, np.ndarray], channels: Sequence[int], noise: NoiseOfUnit
) -> float:
    """Return the logarithm of prior and likelihood of residuals under a noise, its scale at the mode; a screen."""
    found = noise.log_prior
    for k in channels:
        rows, own = of.problem.rows[k], residual[k]
        if isinstance(noise.rows, HeavyTails):
            degrees, scale = noise.rows.degrees, 1.0
            for _ in range(_TAIL_ROUNDS):
                weight = (degrees + 1) / (degrees + (own / scale) ** 2)
                scale = math.sqrt(float(np.mean(weight * own**2)) + 1e-12)
            found += tail_log_density(own / scale, degrees) - len(own) * math.log(scale)
            continue
        both, log_det = noise.rows.whiten(rows, np.column_stack([own, rows.offset]))
        gram = with_scatter(both[:, :1].T @ both[:, :1], rows, both[:, :1], both[:, 1], noise.scatter, log_det)
        square = max(float(gram.products[0, 0]), 1e-12)
        log_scale, term = scale_mode(square, len(own), noise.scale_sd(rows))
        found += gram.log_det + term - len(own) * log_scale - 0.5 * square * math.exp(-2 * log_scale)
        found -= 0.5 * len(own) * math.log(2 * math.pi)
    return found


class Screen:
    """Quick gains of variants and pairs from one conditional likelihood.

    Effects that the runs would not show at their largest typical size are no hypotheses: their probability would remain
    that of the prior, and together they would outweigh that nothing is missing.  They are told as undetectable.
    """

    def __init__(self, of: EvidenceOf, empty: Conditional):
        self.of, sizes = of, dict[int, list[int]]()
        for n, each in enumerate(of.variants):
            own = empty.own[np.ix_(each.places, each.places)]
            if float(np.linalg.eigvalsh(own)[-1]) >= _SHOWN_SD**2:
                sizes.setdefault(len(each.places), []).append(n)
        self._sizes = sizes
        most = max((len(each.widths) for each in of.variants), default=1)
        self._widths = np.array([(*v.widths, *[v.widths[-1]] * (most - len(v.widths))) for v in of.variants])
        self._log_share = np.array(
            [[-math.log(len(v.widths))] * len(v.widths) + [-np.inf] * (most - len(v.widths)) for v in of.variants]
        )

    def singles(self, at: Conditional) -> list[tuple[float, int]]:
        """Return the gain of every variant, its prior odds included, the largest first."""
        found: list[tuple[float, int]] = []
        for size, members in self._sizes.items():
            places = np.array([self.of.variants[n].places for n in members])
            own, right = at.own[places[:, :, None], places[:, None, :]], at.right[places]
            sign = self.of.problem.sign[places]
            gains = [
                gain_of_coefficients(own, right, np.repeat(self._widths[members, q][:, None], size, axis=1), sign)
                + self._log_share[members, q]
                for q in range(self._widths.shape[1])
            ]
            total = np.logaddexp.reduce(gains, axis=0)
            found += [(float(g) + self.of.variants[n].log_odds, n) for g, n in zip(total, members, strict=True)]
        return sorted(found, reverse=True)

    def pairs(self, at: Conditional, pool: Sequence[int]) -> list[tuple[float, tuple[int, int]]]:
        """Return the gain of every pair of a pool, over every other width, the largest first."""
        sizes: dict[tuple[int, int], list[tuple[int, int]]] = {}
        for one, other in combinations(pool, 2):
            a, b = self.of.variants[one], self.of.variants[other]
            if not a.excludes(b):
                sizes.setdefault((len(a.places), len(b.places)), []).append((one, other))
        found: list[tuple[float, tuple[int, int]]] = []
        for size, members in sizes.items():
            total = self._of_pairs(at, size, members)
            found += [
                (float(g) + self.of.variants[a].log_odds + self.of.variants[b].log_odds, (a, b))
                for g, (a, b) in zip(total, members, strict=True)
            ]
        return sorted(found, reverse=True)

    def _of_pairs(self, at: Conditional, size: tuple[int, int], members: list[tuple[int, int]]) -> np.ndarray:
        places = np.array([self.of.variants[a].places + self.of.variants[b].places for a, b in members])
        own, right = at.own[places[:, :, None], places[:, None, :]], at.right[places]
        sign = self.of.problem.sign[places]
        one, other = np.array(members).T
        gains = []
        for i in range(0, self._widths.shape[1], 2):
            for j in range(0, self._widths.shape[1], 2):
                both = np.stack([self._widths[one, i], self._widths[other, j]], axis=1)
                share = self._log_share[one, i] + self._log_share[other, j] + 2 * math.log(2)
                gains.append(gain_of_coefficients(own, right, np.repeat(both, size, axis=1), sign) + share)
        return np.asarray(np.logaddexp.reduce(gains, axis=0))


# ---- forms ----


@dataclass(frozen=True)
class _FormGram:
    """V and u of the columns of a form on one channel, past what that channel's own columns explain."""

    own: np.ndarray
    right: np.ndarray
    across: np.ndarray


@dataclass(frozen=True)
class _Screened:
    """A form with its quick gain, and the Gram matrices of its channels."""

    gain: float
    form: ChosenForm
    parts: dict[int, _FormGram]


class FormScan:
    """Quick gains of every form beside a hypothesis without one."""

    def __init__(self, of: EvidenceOf, at: Evaluated):
        self.of, self.at = of, at
        squares, axes = np.linalg.eigh(at.covariance)
        self._root = axes * np.sqrt(np.maximum(squares, 0.0))
        self._bases = {k: _base(of, at, k)[0] / at.scale[k] for k in of.unit_of}
        self._residual = {k: b[:, -1] - b[:, :-1] @ at.mean[_where(of, at, k)] for k, b in self._bases.items()}

    def _gram(self, form: ChosenForm, channel: int) -> _FormGram:
        at, k = self.at, channel
        columns = self.of.form_columns(at.hypothesis, form, k, at.weight.get(k)) / at.scale[k]
        across = self._root[_where(self.of, at, k)].T @ (self._bases[k][:, :-1].T @ columns)
        return _FormGram(columns.T @ columns, columns.T @ self._residual[k], across)

    def best(self, forms: Sequence[FreeForm]) -> list[tuple[float, ChosenForm]]:
        """Return forms with their gains against no form, the largest first; screened channel by channel."""
        quick = sorted((each for form in forms for each in self._screened(form)), key=lambda each: -each.gain)
        exact = [(_exact(each), each.form) for each in quick[:_EXACT_FORMS]]
        return sorted(exact, key=lambda each: -each[0])

    def _screened(self, form: FreeForm) -> Iterator["_Screened"]:
        """Yield a form at each amplitude, on all channels and on one alone, the channels as if they were apart."""
        parts = {k: self._gram(ChosenForm(form, 1.0, tuple(form.columns)), k) for k in form.columns}
        each = {k: _gains(part, form.amplitudes) for k, part in parts.items()}
        alone = len(parts) > 1 and form.wrong is None
        for n, amplitude in enumerate(form.amplitudes):
            whole = ChosenForm(form, amplitude, tuple(parts))
            yield _Screened(float(sum(gains[n] for gains in each.values())) + whole.log_prior, whole, parts)
            for k in parts if alone else ():
                one = ChosenForm(form, amplitude, (k,))
                yield _Screened(float(each[k][n]) + one.log_prior, one, parts)

    def rows(self, wrong: WrongRows) -> Iterator[tuple[float, ChosenForm]]:
        """Yield the best wrong row of each column and amplitude, with its gain."""
        count = len(wrong.run)
        for name, columns in wrong.columns.items():
            own, right, through = np.zeros(count), np.zeros(count), np.zeros((count, len(self.at.mean)))
            for k in self.of.unit_of:
                row, white = wrong.row[k], columns[k] / self.at.scale[k]
                np.add.at(own, row, white**2)
                np.add.at(right, row, white * self._residual[k])
                where, products = _where(self.of, self.at, k), white[:, None] * self._bases[k][:, :-1]
                for place, column in zip(where, products.T, strict=True):
                    through[:, place] += np.bincount(row, column, count)
            left = np.maximum(own - np.sum((through @ self._root) ** 2, axis=1), 0.0)
            for amplitude in wrong.amplitudes:
                variance = amplitude**2
                gain = 0.5 * variance * right**2 / (1 + variance * left) - 0.5 * np.log1p(variance * left)
                best = int(np.argmax(gain))
                form = wrong.form(name, best)
                chosen = ChosenForm(form, amplitude, tuple(form.columns))
                yield float(gain[best]) + chosen.log_prior, chosen


def _exact(screened: _Screened) -> float:
    """Return the gain of a form with its channels together, its prior probability included."""
    form, parts = screened.form, screened.parts
    if len(form.channels) == 1:
        return screened.gain
    own, right = np.zeros((form.width, form.width)), np.zeros(form.width)
    across = np.zeros((len(parts[form.channels[0]].across), form.width))
    for k in form.channels:
        span = form.span(k)
        own[span, span] += parts[k].own
        right[span] += parts[k].right
        across[:, span] += parts[k].across
    return float(_gains(_FormGram(own, right, across), [form.amplitude])[0]) + form.log_prior


def _gains(part: _FormGram, amplitudes: Sequence[float]) -> np.ndarray:
    """Return the log evidence of coefficients with standard deviations `amplitudes`, (n,).

    Directions that what takes part explains to rounding are left out: a large misfit would make them a gain.
    """
    squares, axes = np.linalg.eigh(part.own - part.across.T @ part.across)
    told = squares > _LEAST_RETAINED * max(float(np.trace(part.own)), np.finfo(float).tiny)
    along, squares = (axes.T @ part.right)[told] ** 2, squares[told]
    variance = np.square(amplitudes)[:, None]
    return 0.5 * np.sum(along * variance / (1 + variance * squares) - np.log1p(variance * squares), axis=1)
