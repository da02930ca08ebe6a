"""Cosine coefficients of a record, the statistics of the likelihood, and the variance of noise terms at their levels.

White noise and a random walk of unknown level are uncorrelated in the cosine basis (DCT-II without its constant) for
any length of the record: the basis diagonalises the second difference with free ends.  The other noises are nearly so,
and the exact variance of every coefficient is known, per unit of the squared coefficient of the term.  There is no
leakage to correct, unlike in a periodogram.

The squares of the cosine coefficients are kept on two levels.  The record is cut into blocks.  Within blocks the
squares of each coefficient are summed over all complete blocks; the means of the blocks form the coarse level, one
series per stretch between gaps.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.fft import dct

from imubayes_recordings.noise_analysis.noise_terms import (
    Averages,
    NoiseTerm,
    coefficient_variance,
    variances_from_lags,
)
from imubayes_recordings.noise_analysis.running_sum import CHUNK, RunningSum

_MOST_MEANS = 1 << 14
_SHORT_BLOCK = 16  # with missing samples, so that enough blocks are complete
_LEAST_MEANS = 8
_COMPLETE = 0.5  # blocks with fewer of their samples have no mean, and blocks are shortened until as many are whole
_SINGLE, _BIN = 64, 1.02  # the first coefficients stay single, further ones are joined in narrow bins


@dataclass(frozen=True)
class FineLevel:
    """Coefficients within blocks.

    Attributes
    ----------
    order : shape (K,), k = 1 … block − 1.
    power : shape (K,), sum of the squared coefficients over the complete blocks, output units squared.
    blocks : their number.
    """

    order: np.ndarray
    power: np.ndarray
    blocks: int


@dataclass(frozen=True)
class CoarseLevel:
    """Coefficients of the block means of one stretch without gaps.

    Attributes
    ----------
    means : number of block means.
    first, last : shape (K,), orders of the coefficients joined in each bin.
    power : shape (K,), sum of their squares.
    ramp : shape (K,), coefficient of a ramp of 1 per second; 0 in bins of several coefficients, if it is negligible.
    coefficient : shape (K,), the coefficient itself if the bin has one.
    thinning : mean of the ratio of samples to samples present of the means, at least 1.
    """

    means: int
    first: np.ndarray
    last: np.ndarray
    power: np.ndarray
    ramp: np.ndarray
    coefficient: np.ndarray
    thinning: float

    @property
    def count(self) -> np.ndarray:
        """Number of coefficients in each bin, shape (K,)."""
        return self.last - self.first + 1


@dataclass(frozen=True)
class CosineStatistics:
    """All that the likelihood uses of a record.

    Attributes
    ----------
    interval : sampling interval, s.
    samples : number of samples on the grid.
    block : samples per block.
    slope : slope taken out beforehand, output units per second.
    fine : coefficients within blocks; None with blocks of one sample.
    coarse : coefficients of the block means, stretch by stretch.
    """

    interval: float
    samples: int
    block: int
    slope: float
    fine: FineLevel | None
    coarse: tuple[CoarseLevel, ...]


@dataclass(frozen=True)
class _Blocks:
    mean: np.ndarray
    present: np.ndarray
    slope: float


def cosine_statistics(record: RunningSum) -> CosineStatistics:
    """Return the cosine statistics of a record, in one or two passes over its running sum."""
    block = _block_length(record)
    blocks = _block_means(record, block)
    coarse = tuple(_coarse(blocks, first, stop, block, record.interval) for first, stop in _stretches(blocks, block))
    fine = _fine(record, block, blocks) if block > 1 else None
    return CosineStatistics(record.interval, record.samples, block, blocks.slope, fine, coarse)


def _block_length(record: RunningSum) -> int:
    """Return the samples per block, a power of two: few means, and most blocks complete."""
    block = 1
    while record.samples > block * _MOST_MEANS:
        block *= 2
    if record.holes is None:
        return block
    # An isolated missing sample spoils a block; a long gap spoils only the blocks in it.
    share = len(record.holes.start) / record.samples
    block = max(block, _SHORT_BLOCK)
    while block > _SHORT_BLOCK and block * share > _COMPLETE:
        block //= 2
    return block


def _block_means(record: RunningSum, block: int) -> _Blocks:
    """Return the mean and the number of samples of every whole block, and the slope of a line through the means."""
    count = record.samples // block
    mean, present = np.empty(count), np.empty(count, dtype=np.int64)
    size = max(1, CHUNK // block)
    for first in range(0, count, size):
        here = min(size, count - first)
        edge = record.read(first * block, here * block + 1)[::block]
        missing = np.diff(record.missing_before(block * (first + np.arange(here + 1))))
        present[first : first + here] = block - missing
        mean[first : first + here] = np.diff(edge) / np.maximum(block - missing, 1)
    used = present >= _COMPLETE * block
    time = np.arange(count, dtype=float)[used]
    centred = time - time.mean() if len(time) else time
    slope = float(centred @ mean[used]) / float(centred @ centred) if len(time) > 2 else 0.0
    return _Blocks(mean, present, slope / (block * record.interval))


def _stretches(blocks: _Blocks, block: int) -> list[tuple[int, int]]:
    """Return first and one past the last block of every stretch with means."""
    used = np.concatenate([[False], blocks.present >= _COMPLETE * block, [False]])
    edges = np.flatnonzero(np.diff(used.astype(np.int8)))
    pairs = zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)
    return [(first, stop) for first, stop in pairs if stop - first >= _LEAST_MEANS]


def _coarse(blocks: _Blocks, first: int, stop: int, block: int, interval: float) -> CoarseLevel:
    means = stop - first
    time = block * interval * np.arange(means)
    coefficient = _coefficients(blocks.mean[first:stop] - blocks.slope * time)
    ramp = _coefficients(time)
    edges = _bin_edges(means)
    single = np.diff(edges) == 1
    return CoarseLevel(
        means,
        edges[:-1],
        edges[1:] - 1,
        np.add.reduceat(coefficient**2, edges[:-1] - 1),
        np.where(single, ramp[edges[:-1] - 1], 0.0),
        np.where(single, coefficient[edges[:-1] - 1], 0.0),
        float(np.mean(block / blocks.present[first:stop])),
    )


def _coefficients(values: np.ndarray) -> np.ndarray:
    """Return the orthonormal cosine coefficients of orders 1 … n − 1 along the last axis."""
    return np.asarray(dct(values, type=2, norm="ortho", axis=-1))[..., 1:]


def _bin_edges(means: int) -> np.ndarray:
    """Return the first order of each bin, and one past the last order."""
    edges = list(range(1, min(_SINGLE, means)))
    while edges[-1] < means:
        edges.append(min(means, max(edges[-1] + 1, int(edges[-1] * _BIN))))
    return np.array(edges)


def _fine(record: RunningSum, block: int, blocks: _Blocks) -> FineLevel | None:
    """Return the coefficients within the complete blocks, the slope taken out."""
    whole = np.flatnonzero(blocks.present == block)
    if not len(whole):
        return None
    ramp = blocks.slope * record.interval * np.arange(block)
    power = np.zeros(block - 1)
    size = max(1, CHUNK // block)
    for first in range(0, len(blocks.present), size):
        here = min(size, len(blocks.present) - first)
        complete = blocks.present[first : first + here] == block
        samples = np.diff(record.read(first * block, here * block + 1)).reshape(here, block)[complete]
        power += np.sum(_coefficients(samples - ramp) ** 2, axis=0)
    return FineLevel(np.arange(1, block), power, len(whole))


def level_variances(
    term: NoiseTerm, statistics: CosineStatistics, correlation_time: float = math.nan
) -> list[np.ndarray]:
    """Return the variance of a term per squared coefficient at the fine level, if any, and at each coarse level."""
    found = []
    if statistics.fine is not None:
        within = Averages(statistics.block, 1, statistics.interval)
        found.append(coefficient_variance(term, within, correlation_time))
    for level in statistics.coarse:
        means = Averages(level.means, statistics.block, statistics.interval, level.thinning)
        found.append(_binned(coefficient_variance(term, means, correlation_time), level))
    return found


def removed_shares(statistics: CosineStatistics, bands: Sequence[tuple[float, float]]) -> list[np.ndarray]:
    """Return the part of white noise that a record without some bands of frequency lacks, at each level.

    Block means alias, and coefficients within short blocks are wide: a band takes part of coefficients far from it.

    Parameters
    ----------
    bands : ends in Hz.
    """
    block, longest = statistics.block, max((level.means for level in statistics.coarse), default=1)
    lag = np.abs(np.arange(-block, max(longest, 1) * block)).astype(float)
    removed = np.zeros(len(lag))
    for low, high in bands:
        # Σ over a band of cosines: its autocovariance, in units of that of white noise.
        low, high = (2 * min(max(end, 0.0) * statistics.interval, 0.5) for end in (low, high))
        removed += high * np.sinc(high * lag) - low * np.sinc(low * lag)
    found = []
    if statistics.fine is not None:
        found.append(variances_from_lags(removed[block : 2 * block]))
    twice = np.concatenate([[0.0], np.cumsum(np.cumsum(removed))])
    centre = block * np.arange(1, longest + 1)
    means = (twice[centre + block] - 2 * twice[centre] + twice[centre - block]) / block
    found += [_binned(variances_from_lags(means[: level.means]), level) for level in statistics.coarse]
    return found


def _binned(variance: np.ndarray, level: CoarseLevel) -> np.ndarray:
    return np.add.reduceat(variance, level.first - 1) / level.count
