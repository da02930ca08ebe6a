"""Offset between the clocks of a table and of a unit, in a raw log that holds the columns of both.

The outputs of a gyro repeat the rate of the table after the offset.  It is the lag of the highest correlation, and is
reported only if a shift alone explains the difference: a table that follows its command on a ramp differs from the
command in form as well.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imubayes.campaign.reduction.constant_spans import table_rates, typical_level
from imubayes.campaign.reduction.log_survey import BlockSurvey

_MOST_LAG = 0.5  # of the log
_LEAST_BLOCKS = 100
_SAME = 1.5  # of the least unexplained variance: lags as good, of which the smallest counts in a periodic motion
_EXPLAINED = 0.05  # of the unexplained variance at no lag, which a shift alone leaves at most
_ROUNDING = 1e-12
_FINE = np.arange(-1.0, 1.01, 0.05)  # blocks


@dataclass(frozen=True)
class ClockOffset:
    """How much later a channel answers the table, s, and how long the levels of the rate last, s."""

    seconds: float
    channel: str
    level: float


def clock_offset(blocks: BlockSurvey, gyros: Sequence[str]) -> ClockOffset | None:
    """Return the offset that the gyro with the highest correlation shows; None if a shift is not the explanation.

    Parameters
    ----------
    blocks : survey of the log.
    gyros : names of the gyro channels.
    """
    if blocks.interval is None or blocks.size < _LEAST_BLOCKS:
        return None
    time = blocks.mean["time_s"]
    step = float(np.median(np.diff(time)))
    even = np.arange(time[0], time[-1], step) if step > 0 and np.isfinite(time).all() else np.zeros(0)
    rate = table_rates(blocks)
    used = np.isfinite(rate)
    if len(even) < _LEAST_BLOCKS or not used.any() or not np.ptp(rate[used]) > 0:
        return None
    table, found = np.interp(even, time[used], rate[used]), []
    for name in (each for each in gyros if each in blocks.mean):
        used = np.isfinite(blocks.mean[name])
        output = np.interp(even, time[used], blocks.mean[name][used]) if used.any() else np.zeros(len(even))
        if np.ptp(output) > 0:
            lag, left, at_none = _best_lag(table, output)
            found.append((left, at_none, lag * step, name))
    if not found:
        return None
    left, at_none, seconds, name = min(found)
    return ClockOffset(seconds, name, typical_level(blocks)) if left < _EXPLAINED * at_none else None


def _best_lag(table: np.ndarray, output: np.ndarray) -> tuple[float, float, float]:
    """Return the lag of the output in samples, the share of its variance that is unexplained there, and at no lag."""
    lags, left = _unexplained(table, output)
    as_good = np.flatnonzero(left <= _SAME * left.min())
    place = int(as_good[np.argmin(np.abs(lags[as_good]))])
    lag, index = int(lags[place]), np.arange(len(table), dtype=float)
    fine = []
    for part in _FINE + lag:
        inside = (index + part >= 0) & (index + part <= len(table) - 1)
        later = np.interp(index[inside] + part, index, output)
        fine.append(1 - np.corrcoef(table[inside], later)[0, 1] ** 2)
    best = int(np.argmin(fine))
    return lag + float(_FINE[best]), float(fine[best]), float(left[lags == 0][0])


def _unexplained(table: np.ndarray, output: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return whole lags, and the share of the variance of the output that the shifted table leaves unexplained."""
    table, output, length = table - table.mean(), output - output.mean(), len(table)
    most = int(_MOST_LAG * length)
    lags = np.arange(-most, most + 1)
    # Twice the length, so that the ends do not meet; `scipy.signal` takes longer to import than a campaign to check.
    spectrum = np.fft.rfft(output, 2 * length) * np.conj(np.fft.rfft(table, 2 * length))
    both = np.fft.irfft(spectrum, 2 * length)[lags]
    count = length - np.abs(lags)

    def moments(values: np.ndarray, first: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        sums = np.concatenate([[0.0], np.cumsum(values)]), np.concatenate([[0.0], np.cumsum(values**2)])
        total, squares = (each[first + count] - each[first] for each in sums)
        return total, squares

    (x, xx), (y, yy) = moments(table, np.maximum(-lags, 0)), moments(output, np.maximum(lags, 0))
    spread = (xx - x * x / count) * (yy - y * y / count)
    # If an overlap is nearly constant, a correlation is noise.
    enough = spread > (0.1 * math.prod((float(table @ table), float(output @ output))) * (count / length) ** 2)
    explained = (both - x * y / count) ** 2 / np.where(enough, spread, 1.0)
    return lags, np.where(enough, np.maximum(1 - explained, _ROUNDING), 1.0)
