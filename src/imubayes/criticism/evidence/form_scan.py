"""Which form to add to a hypothesis: quick gains of all forms and wrong inputs beside it, its noise held.

Forms of one channel and width are whitened, projected and decomposed together; a form of several channels is first
scored as if these were apart, and the best are scored exactly.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from imubayes.criticism.evidence.free_forms import ChosenForm, FormColumns, FormHypothesis
from imubayes.criticism.evidence.hypothesis import EvidenceOf, Solved
from imubayes.criticism.evidence.linear_problem import NEGLIGIBLE
from imubayes.criticism.evidence.proposals import base_columns
from imubayes.criticism.evidence.wrong_input_forms import WrongRows

_AT_ONCE = 160
"""Forms that are decomposed together, and the likeliest ones whose gain is exact."""


@dataclass(frozen=True)
class _Grams:
    """V (m, k, k) and u (m, k) of m forms on one channel, with their products with what takes part, (m, k, n)."""

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
        gains = self._gains(forms)
        quick: list[tuple[float, ChosenForm]] = []
        for n, form in enumerate(forms):
            parts = {k: gains[n, k] for k in form.columns}
            quick.append(_likeliest(form, tuple(parts), sum(parts.values(), np.zeros(len(form.amplitudes)))))
            if len(parts) > 1 and form.wrong is None:
                quick += [_likeliest(form, (k,), part) for k, part in parts.items()]
        quick.sort(key=lambda each: -each[0])
        exact = [(gain if len(form.channels) == 1 else self._exact(form), form) for gain, form in quick[:_AT_ONCE]]
        return sorted(exact, key=lambda each: -each[0])

    def _gains(self, forms: Sequence[FormHypothesis]) -> dict[tuple[int, int], np.ndarray]:
        """Return the gain of each form on each of its channels, (A,)."""
        found: dict[tuple[int, int], np.ndarray] = {}
        for k in self.of.unit_of:
            alike: dict[tuple[int, int, tuple[float, ...]], list[int]] = {}
            for n, form in enumerate(forms):
                if k in form.columns:
                    own = form.columns[k]
                    alike.setdefault((id(own.every), own.width, form.amplitudes), []).append(n)
            for (_, _, amplitudes), members in alike.items():
                columns = [forms[n].columns[k] for n in members]
                for place, gain in enumerate(self._gains_of(columns, k, amplitudes)):
                    found[members[place], k] = gain
        return found

    def _gains_of(
        self, columns: Sequence[FormColumns], channel: int, amplitudes: Sequence[float]
    ) -> Iterator[np.ndarray]:
        """Yield the gains of forms of one width on a channel; those of forms of single runs are found at once."""
        every = columns[0].every
        if every is not None:
            yield from self._grams_of_runs(every, channel).gains(amplitudes)[[each.series for each in columns]]
            return
        for first in range(0, len(columns), _AT_ONCE):
            some = [each.make() for each in columns[first : first + _AT_ONCE]]
            yield from self._grams(some, channel).gains(amplitudes)

    def _white(self, columns: np.ndarray, channel: int) -> np.ndarray:
        at = self.at
        return self.of.whiten(at.hypothesis, columns, channel, at.weight.get(channel)) / self.scale[channel]

    def _grams(self, columns: Sequence[np.ndarray], channel: int) -> _Grams:
        """Return the Gram matrices of forms of one width on a channel."""
        k, width = channel, columns[0].shape[1]
        white = self._white(np.concatenate(columns, axis=1), k)
        apart = white.reshape(len(white), -1, width).transpose(1, 2, 0)
        across = (white.T @ self._through[k]).reshape(-1, width, self._root.shape[1])
        return _Grams(apart @ apart.swapaxes(1, 2), (white.T @ self._residual[k]).reshape(-1, width), across)

    def _grams_of_runs(self, every: np.ndarray, channel: int) -> _Grams:
        """Return the Gram matrices of forms of single runs that share columns; no noise reaches from run to run."""
        white, starts = self._white(every, channel), [start for start, _ in self.of.problem.rows[channel].series]
        beside, width = np.column_stack([white, self._residual[channel], self._through[channel]]), every.shape[1]
        joined = np.stack([np.add.reduceat(one[:, None] * beside, starts) for one in white.T], axis=1)
        return _Grams(joined[:, :, :width], joined[:, :, width], joined[:, :, width + 1 :])

    def _exact(self, form: ChosenForm) -> float:
        """Return the gain of a form with its channels together, its prior probability included."""
        own, right = np.zeros((form.width, form.width)), np.zeros(form.width)
        across = np.zeros((form.width, self._root.shape[1]))
        for k in form.channels:
            span, part = form.span(k), self._grams([form.form.columns[k].make()], k)
            own[span, span] += part.own[0]
            right[span] += part.right[0]
            across[span] += part.across[0]
        whole = _Grams(own[None], right[None], across[None])
        return float(whole.gains([form.amplitude])[0, 0]) + form.log_prior

    def rows(self, wrong: WrongRows) -> Iterator[tuple[float, ChosenForm]]:
        """Yield the best wrong row of each column and amplitude, with its gain."""
        count, gain = len(wrong.run), {k: self._gain(k) for k in self.of.unit_of}
        for name, columns in wrong.columns.items():
            own, right, through = np.zeros(count), np.zeros(count), np.zeros((count, self._root.shape[1]))
            for k in self.of.unit_of:
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


def _likeliest(form: FormHypothesis, channels: tuple[int, ...], gains: np.ndarray) -> tuple[float, ChosenForm]:
    """Return a form at its likeliest amplitude, with its gain and prior probability."""
    best = int(np.argmax(gains)) if len(gains) else 0
    chosen = ChosenForm(form, form.amplitudes[best], channels)
    return (float(gains[best]) if math.isfinite(gains[best]) else -math.inf) + chosen.log_prior, chosen
