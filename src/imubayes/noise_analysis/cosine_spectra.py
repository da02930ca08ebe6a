"""Cosine coefficients of a record, the statistics of the likelihood, and the variance that each noise term gives them.

The terms, with their two-sided spectra S(f) of the rate and Allan variances (IEEE Std 952, annex B and C):

    term            coefficient   S(f)                  σ²(τ)
    quantisation    Q             τ₀ Q² (2πf)²          3 Q²/τ²
    white           N             N²                    N²/τ
    flicker         B             B²/(2πf)              (2 ln 2/π) B²
    random walk     K             K²/(2πf)²             K² τ/3
    Gauss–Markov    σ, T          2σ²T/(1 + (2πfT)²)    exponential covariance σ² exp(−t/T)
    ramp            R             (deterministic)       R² τ²/2

Samples are those of the discrete processes: white and quantisation independent values, flicker the fractional sum of
order ½ of white noise (Kasdin, Proc. IEEE 83 (1995), 802), random walk a sum of independent increments.

White noise and a random walk of unknown level are uncorrelated in the cosine basis (DCT-II without its constant) for
any length of the record: the basis diagonalises the second difference with free ends.  The other noises are nearly so,
and the exact variance of every coefficient is known, per unit of the squared coefficient of the term.  There is no
leakage to correct, unlike in a periodogram.

The squares of the cosine coefficients are kept on two levels.  The record is cut into blocks.  Within blocks the
squares of each coefficient are summed over all complete blocks; the means of the blocks form the coarse level, one
series per stretch between gaps.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from scipy.fft import dct, dst

from imubayes.noise_analysis.running_sum import CHUNK, RunningSum

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
    ramp : shape (K,), coefficient of a ramp of 1 per second; 0 in bins of several coefficients, where it is negligible.
    coefficient : shape (K,), the coefficient itself where the bin has one.
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


_DIRECT = 32  # lags of block means summed exactly; beyond, block averaging is a second-order correction


class NoiseTerm(StrEnum):
    """A noise term of a static record."""

    QUANTISATION = "quantisation"
    WHITE = "white"
    FLICKER = "flicker"
    RANDOM_WALK = "random_walk"
    MARKOV = "gauss_markov"
    RAMP = "ramp"


@dataclass(frozen=True)
class Averages:
    """Consecutive means of `block` samples at `interval` s, `count` of them; samples themselves where block is 1."""

    count: int
    block: int
    interval: float
    thinning: float = 1.0


def coefficient_variance(term: NoiseTerm, averages: Averages, correlation_time: float = math.nan) -> np.ndarray:
    """Return the variance of the cosine coefficients of orders 1 … count − 1, for a squared coefficient of 1.

    Parameters
    ----------
    term : any but the ramp.
    correlation_time : T of a Gauss–Markov process, s.
    """
    return _VARIANCES[term](averages, correlation_time)


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
        found.append(_from_lags(removed[block : 2 * block]))
    twice = np.concatenate([[0.0], np.cumsum(np.cumsum(removed))])
    centre = block * np.arange(1, longest + 1)
    means = (twice[centre + block] - 2 * twice[centre] + twice[centre - block]) / block
    found += [_binned(_from_lags(means[: level.means]), level) for level in statistics.coarse]
    return found


def allan_shape(term: NoiseTerm, tau: np.ndarray, correlation_time: float = math.nan) -> np.ndarray:
    """Return the Allan variance of a term per squared coefficient at averaging times in s, shape (K,).

    Source: IEEE Std 952, annex C.
    """
    if term is NoiseTerm.MARKOV:
        x = tau / correlation_time
        small = x**2 * (x / 3 - x**2 / 4)  # series of the bracket, where it would cancel
        bracket = np.where(x < 1e-3, small, x - 0.5 * (3 - 4 * np.exp(-x) + np.exp(-2 * x)))
        return 2 * bracket / x**2
    shapes = {
        NoiseTerm.QUANTISATION: 3 / tau**2,
        NoiseTerm.WHITE: 1 / tau,
        NoiseTerm.FLICKER: np.full_like(tau, 2 * math.log(2) / math.pi),
        NoiseTerm.RANDOM_WALK: tau / 3,
        NoiseTerm.RAMP: tau**2 / 2,
    }
    return shapes[term]


def _binned(variance: np.ndarray, level: CoarseLevel) -> np.ndarray:
    return np.add.reduceat(variance, level.first - 1) / level.count


def _half_angle(averages: Averages) -> np.ndarray:
    """Return 4 sin²(πk/2n), the eigenvalues of the second difference with free ends."""
    order = np.arange(1, averages.count)
    return 4 * np.sin(np.pi * order / (2 * averages.count)) ** 2


def _white(averages: Averages, _: float) -> np.ndarray:
    return np.full(averages.count - 1, averages.thinning / (averages.block * averages.interval))


def _quantisation(averages: Averages, _: float) -> np.ndarray:
    # Differences of independent angles: the second difference with fixed ends, which differs from that with free ends
    # in the two corners.
    eigenvalue = _half_angle(averages)
    corners = 4 / averages.count * (1 - eigenvalue / 4)
    return (eigenvalue + corners) / (averages.block * averages.interval) ** 2


def _random_walk(averages: Averages, _: float) -> np.ndarray:
    # Differences of block means are triangular sums of increments: their covariance is 1 − c × (second difference).
    eigenvalue = _half_angle(averages)
    overlap = (1 - 1 / averages.block**2) / 6
    return averages.interval * averages.block * (1 - overlap * eigenvalue) / eigenvalue


def _flicker(averages: Averages, _: float) -> np.ndarray:
    lag = np.arange(averages.count * averages.block if averages.block == 1 else (_DIRECT + 1) * averages.block)
    # The variogram of the fractional sum of order ½ in closed form: (2/π) Σ_(j ≤ l) 1/(2j − 1).
    variogram = 2 / math.pi * np.concatenate([[0.0], np.cumsum(1 / (2 * lag[1:] - 1.0))])
    if averages.block > 1:
        variogram = _variogram_of_means(variogram, averages)
    return _from_lags(-variogram[: averages.count])


def _variogram_of_means(variogram: np.ndarray, averages: Averages) -> np.ndarray:
    """Return the variogram of block means of flicker noise, shape (count,), from that of samples."""
    m, count = averages.block, averages.count
    lag = np.arange(-(m - 1), m)
    weight = (m - np.abs(lag)) / m**2
    within = float(weight @ variogram[np.abs(lag)])
    near = min(count, _DIRECT)
    found = np.empty(count)
    found[:near] = [float(weight @ variogram[np.abs(k * m + lag)]) for k in range(near)]
    far = m * np.arange(near, count, dtype=float)
    # Σ 1/(2j − 1) = ½ (ln l + γ) + ln 2 + 1/(48 l²) + …; averaging adds half the second derivative × (m² − 1)/6.
    with np.errstate(divide="ignore"):
        smooth = (np.log(far) + np.euler_gamma) / 2 + math.log(2) + 1 / (48 * far**2) - (m**2 - 1) / (24 * far**2)
    found[near:] = 2 / math.pi * smooth
    return found - within


def _markov(averages: Averages, correlation_time: float) -> np.ndarray:
    m, step = averages.block, averages.interval / correlation_time
    lag = np.arange(averages.count, dtype=float)
    if m == 1:
        return _from_lags(np.exp(-lag * step))
    gain = math.expm1(-m * step) / (m * math.expm1(-step))
    covariance = gain**2 * np.exp(-(np.maximum(lag - 1, 0) * m + 1) * step)
    apart = np.arange(1, m)
    covariance[0] = (m + 2 * float((m - apart) @ np.exp(-apart * step))) / m**2
    return _from_lags(covariance)


def _from_lags(covariance: np.ndarray) -> np.ndarray:
    """Return the variances of cosine coefficients 1 … n − 1 from the (generalised) covariance at lags 0 … n − 1.

    A coefficient's weights u_i have the autocorrelation a(l) = ((n − l) cos(φl) − sin(φl)/sin φ)/n with φ = πk/n, so
    the variance is c(0) + 2 Σ_l c(l) a(l): a cosine and a sine transform.  As Σ_i u_i = 0, the same holds with minus
    the variogram for c.
    """
    n = len(covariance)
    lag = np.arange(n)
    even = np.concatenate([[0.0], ((n - lag) * covariance)[1:], [0.0]])
    cosine = dct(even, type=1)[1:n]
    sine = dst(covariance[1:], type=1)
    angle = np.pi * np.arange(1, n) / n
    return covariance[0] + (cosine - sine / np.sin(angle)) / n


_VARIANCES: dict[NoiseTerm, Callable[[Averages, float], np.ndarray]] = {
    NoiseTerm.QUANTISATION: _quantisation,
    NoiseTerm.WHITE: _white,
    NoiseTerm.FLICKER: _flicker,
    NoiseTerm.RANDOM_WALK: _random_walk,
    NoiseTerm.MARKOV: _markov,
}
