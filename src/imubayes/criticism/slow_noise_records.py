"""Records of channels with correlated noise, and the shapes that their noise may have.

The model has one family of noise; a record may have another, and what wanders otherwise than the model says passes for
effects.  Shapes are white noise, with Gauss–Markov noise, or with flicker noise and random walk (IEEE Std 952).  The
one of largest restricted likelihood whitens the record.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from itertools import product
from typing import Literal

import numpy as np
import scipy  # loads its parts when they are first used

from imubayes.criticism import thresholds
from imubayes.criticism.candidate_effects import Responses
from imubayes.criticism.projection import Projection, Whitening
from imubayes.inference.fitted_model import Fit
from imubayes.noise.base import SeriesNoise, SlowNoise

WanderingNoise = Literal["", "rival", "instead"]
"""Whether noise that wanders otherwise than the model says explains what is found: not, as well, or better."""
_SMALLEST = 1e-300


@dataclass(frozen=True)
class SlowRecords:
    """The records of one channel.

    Attributes
    ----------
    entries : of each record, in the order of time.
    white : shape (N,), variance of white noise, relative.
    scatter : from row to row, output units.
    misfit : shape (N,), over the scatter.
    free : shape (N, k), orthonormal: what the model absorbs, and the offset of each record.
    markov : whether the model has Gauss–Markov noise alone, no noise in continuous time.
    """

    entries: tuple[np.ndarray, ...]
    white: np.ndarray
    scatter: float
    misfit: np.ndarray
    free: np.ndarray
    markov: bool = True

    @property
    def lengths(self) -> tuple[int, ...]:
        """Number of rows of each record."""
        return tuple(len(own) for own in self.entries)

    def split(self, values: np.ndarray) -> list[np.ndarray]:
        """Return values (N, …) of each record."""
        return np.split(values, np.cumsum(self.lengths)[:-1])

    def directions(self, columns: np.ndarray) -> np.ndarray:
        """Return the directions, (N, d), in which effects of responses (E, C) act here past what the model absorbs."""
        here = columns[np.concatenate(self.entries)]
        here = here[:, np.any(here != 0, axis=0)]
        here = here / np.linalg.norm(here, axis=0)
        left, lengths, _ = np.linalg.svd(here - self.free @ (self.free.T @ here), full_matrices=False)
        return left[:, lengths**2 > thresholds.SLOW_RETAINED_MIN]

    def noises(self) -> Iterator["WhitenedRecords"]:
        """Yield the records whitened by each shape of the noise."""
        white = self.split(self.white)
        for share, added in slow_covariances(max(self.lengths)):
            lower = tuple(np.linalg.cholesky(np.diag(share * own) + added[: len(own), : len(own)]) for own in white)
            yield WhitenedRecords.of(self, lower)

    def likeliest(self, beside: np.ndarray | None = None) -> tuple[np.ndarray, ...]:
        """Return the Cholesky factors of the likeliest covariance, its scale included, over the scatter.

        Parameters
        ----------
        beside : directions (N, d) of an effect that is there.
        """
        judged = [(self._square(noise, beside), noise) for noise in self.noises()]
        square, best = max(judged, key=lambda each: float(each[1].log_likelihood(each[0])[0]))
        freedom = best.freedom - (0 if beside is None else beside.shape[1])
        return tuple(lower * np.sqrt(square[0] / freedom) for lower in best.lower)

    def log_odds(self, beside: np.ndarray) -> float:
        """Return by how much an effect of directions (N, d) in noise of the model's family is likelier than any noise.

        The difference of the largest log likelihoods; 0 where the effect does not act.
        """
        if not beside.shape[1]:
            return 0.0
        alone, with_effect = -np.inf, -np.inf
        for number, noise in enumerate(self.noises()):
            alone = max(alone, float(noise.log_likelihood(self._square(noise))[0]))
            if not self.markov or number <= len(thresholds.SLOW_SHARES) * len(thresholds.SLOW_CORRELATIONS):
                with_effect = max(with_effect, float(noise.log_likelihood(self._square(noise, beside))[0]))
        return with_effect - alone

    def _square(self, noise: "WhitenedRecords", beside: np.ndarray | None = None) -> np.ndarray:
        """Return the sum of squares, (1,), that whitened records leave, beside an effect where one is given."""
        left = noise.left(self.misfit[:, None])
        if beside is not None and beside.shape[1]:
            span, _ = np.linalg.qr(noise.left(beside))
            left = left - span @ (span.T @ left)
        return np.sum(left**2, axis=0)


@dataclass(frozen=True)
class WhitenedRecords:
    """Records whitened by a shape of the noise.

    Attributes
    ----------
    lower : Cholesky factor of the covariance of each record.
    basis : shape (N, k), orthonormal: what the model absorbs.
    log_determinant : half of that of the restricted likelihood.
    """

    records: SlowRecords
    lower: tuple[np.ndarray, ...]
    basis: np.ndarray
    log_determinant: float

    @classmethod
    def of(cls, records: SlowRecords, lower: tuple[np.ndarray, ...]) -> "WhitenedRecords":
        """Whiten the records by Cholesky factors."""
        basis, upper = np.linalg.qr(_solved(records, lower, records.free))
        determinant = sum(float(np.log(np.diag(each)).sum()) for each in lower)
        return cls(records, lower, basis, determinant + float(np.log(np.abs(np.diag(upper))).sum()))

    @property
    def freedom(self) -> int:
        """Degrees of freedom of the residual."""
        return len(self.basis) - self.basis.shape[1]

    def left(self, columns: np.ndarray) -> np.ndarray:
        """Return columns (N, C) whitened, less what the model absorbs."""
        white = _solved(self.records, self.lower, columns)
        return white - self.basis @ (self.basis.T @ white)

    def log_likelihood(self, square: np.ndarray) -> np.ndarray:
        """Return the restricted log likelihood of sums of squares, the scale at its best."""
        return -self.log_determinant - 0.5 * self.freedom * np.log(np.maximum(square, _SMALLEST))


def _solved(records: SlowRecords, lower: tuple[np.ndarray, ...], columns: np.ndarray) -> np.ndarray:
    each = zip(lower, records.split(columns), strict=True)
    return np.concatenate([scipy.linalg.solve_triangular(factor, own, lower=True) for factor, own in each])


def slow_records(projection: Projection, responses: Responses) -> dict[int, SlowRecords]:
    """Return the records of the channels whose model has correlated noise, by the place of the channel.

    Channels with a record of many rows, and those with short ones alone, are left out.
    """
    found = {place: _records_of(projection, responses, place) for place in with_slow_noise(projection.fitted)}
    return {place: records for place, records in found.items() if records is not None}


def slow_whitening(
    projection: Projection, records: Mapping[int, SlowRecords], beside: Mapping[int, np.ndarray]
) -> Whitening:
    """Return a further whitening of the entries, by the likeliest noise in place of that of the model.

    Parameters
    ----------
    projection : without a further whitening.
    beside : channel → directions of an effect that is there.
    """
    steps: list[tuple[np.ndarray, np.ndarray]] = []
    for place, own in records.items():
        longest, count = max(own.lengths), len(projection.fitted.model.entries)
        unit = np.zeros((count, longest))
        for entries in own.entries:
            unit[entries, np.arange(len(entries))] = 1.0
        modelled = projection.turn.whiten(unit)
        for entries, lower in zip(own.entries, own.likeliest(beside.get(place)), strict=True):
            # From rows that the model whitened back to outputs, and on to rows that the likeliest noise whitens.
            outputs = np.linalg.inv(modelled[entries, : len(entries)])
            steps.append((entries, scipy.linalg.solve_triangular(own.scatter * lower, outputs, lower=True)))

    def whiten(white: np.ndarray) -> np.ndarray:
        result = white.copy()
        for entries, step in steps:
            result[entries] = step @ white[entries]
        return result

    return whiten


def with_slow_noise(fitted: Fit) -> list[int]:
    """Return the places of the channels whose model has correlated noise."""
    model = fitted.model
    slow = [each for each in model.assembly.effects if issubclass(each.effect_class, (SeriesNoise, SlowNoise))]
    names = {name for each in slow for name in each.channels}
    return [place for place, channel in enumerate(model.campaign.channels) if channel.name in names]


def _records_of(projection: Projection, responses: Responses, channel: int) -> SlowRecords | None:
    problem, entries, turn = projection.fitted.model.problem, projection.fitted.model.entries, projection.turn
    used = np.concatenate([np.asarray(problem.observations.weight) > 0, [False]])
    groups = [group[used[group]] for group in turn.series[entries.channel[turn.series[:, 0]] == channel]]
    lengths = [len(own) for own in groups]
    if not thresholds.SLOW_LEAST_ROWS <= max(lengths, default=0) <= thresholds.SLOW_MOST_ROWS:
        return None
    groups = [own for own in groups if len(own) > 1]
    every = np.concatenate(groups)
    misfit = responses.misfit[every]
    steps = np.concatenate([np.diff(responses.misfit[own]) for own in groups])
    scatter = max(float(np.median(np.abs(steps))) / thresholds.NORMAL_MAD / np.sqrt(2), _SMALLEST)
    free = _free(responses.jacobian[every] / scatter, [len(own) for own in groups])
    if len(every) - free.shape[1] < thresholds.SLOW_LEAST_ROWS // 2:
        return None
    name = projection.fitted.model.campaign.channels[channel].name
    in_continuous_time = any(
        issubclass(each.effect_class, SlowNoise) and name in each.channels
        for each in projection.fitted.model.assembly.effects
    )
    white = 1 / np.asarray(entries.samples, dtype=float)[every]
    return SlowRecords(tuple(groups), white / white.mean(), scatter, misfit / scatter, free, not in_continuous_time)


def _free(jacobian: np.ndarray, lengths: list[int]) -> np.ndarray:
    """Return an orthonormal basis of what the data determine better than the priors do, and of the offsets."""
    directions, sizes, _ = np.linalg.svd(jacobian, full_matrices=False)
    offsets = scipy.linalg.block_diag(*(np.ones((length, 1)) / np.sqrt(length) for length in lengths))
    whole = np.concatenate([directions[:, sizes > 1], offsets], axis=1)
    basis, sizes, _ = np.linalg.svd(whole, full_matrices=False)
    return basis[:, sizes > np.sqrt(thresholds.SLOW_RETAINED_MIN)]


@cache
def slow_covariances(rows: int) -> tuple[tuple[float, np.ndarray], ...]:
    """Return the shapes of the noise: share of white noise, and the covariance of the rest, (rows, rows)."""
    place = np.arange(rows)
    apart = np.abs(place[:, None] - place)
    walk = np.minimum(place[:, None], place) + 0.5
    flicker = _flicker(rows)
    found = [(1.0, np.zeros((rows, rows)))]
    for share, correlation in product(thresholds.SLOW_SHARES, thresholds.SLOW_CORRELATIONS):
        found.append((1 - share, share * correlation**apart))
    for b, k in product(thresholds.SLOW_FLICKERS, thresholds.SLOW_WALKS):
        if b or k:
            found.append((1.0, b * flicker + k * walk))
    return tuple(found)


def _flicker(rows: int) -> np.ndarray:
    """Return the covariance of flicker noise, the fractional sum of order ½ of white noise (Kasdin 1995)."""
    order = np.arange(1, 2 * rows)
    weights = np.concatenate([[1.0], np.cumprod((order - 0.5) / order)])
    # The record begins when the sum has run for as long as it lasts.
    summed = np.array([np.pad(weights[: rows + place + 1][::-1], (0, rows - place - 1)) for place in range(rows)])
    return summed @ summed.T
