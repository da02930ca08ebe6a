"""Stretches of a record that are no rest of the sensor: steps on the floor, a lift, a hand on the bench.

They are left out on request: a record that is loud at times may be a sensor that is.  A stretch is one of many equal
parts of the record.  It is contaminated if the scatter of its samples, or its mean beside those around it, is far
beyond what the typical part has; the parts beside it go with it, since a disturbance begins and ends within a part.
Noise of all kinds that the terms describe is in the typical part as well, slow noise in the scatter of the means.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy  # loads its parts when they are first used

from imubayes.foundations.numerics import true_stretches
from imubayes_recordings.noise_analysis.running_sum import RunningSum, from_parts

_PARTS = 1024  # of a record, of at least
_SAMPLES = 32
_LOUD = 3.0  # times the median of the mean square differences; by chance 1e-12 at 32 samples and Gaussian noise
_AWAY = 8.0  # robust standard deviations of a mean from the median of those around it
_AROUND = 9
_MOST = 0.3  # share of the record beyond which the typical part is no rest either
_NORMAL = 0.6745  # median of |x| of a standard normal x


@dataclass(frozen=True)
class Contamination:
    """Stretches that were left out: how many, their share of the record, and when the loudest was from the start."""

    count: int
    share: float
    loudest_s: float


def without_contamination(record: RunningSum) -> tuple[RunningSum, Contamination | None]:
    """Return a record without contaminated stretches, and what they are; None if there are none, or too many."""
    size = max(_SAMPLES, record.samples // _PARTS)
    square, mean = (np.array(each) for each in zip(*_levels(record, size), strict=True))
    known = np.isfinite(square) & (square > 0)
    if known.sum() < _AROUND:
        return record, None
    filled = np.interp(np.arange(len(mean)), np.flatnonzero(known), mean[known])
    apart = filled - scipy.ndimage.median_filter(filled, _AROUND, mode="nearest")
    scale = float(np.median(np.abs(apart[known]))) / _NORMAL
    ratio = np.where(known, square / np.median(square[known]), 0.0)
    bad = (ratio > _LOUD) | (np.abs(apart) > _AWAY * scale)
    bad = np.convolve(bad, np.ones(3), mode="same") > 0
    share = float(bad.mean())
    if not bad.any() or share > _MOST:
        return record, None
    cleaned = from_parts(_emptied_parts(record, bad, size), record.interval, record.resolution)
    return cleaned, Contamination(len(true_stretches(bad)), share, float(np.argmax(ratio)) * size * record.interval)


def _levels(record: RunningSum, size: int) -> Iterator[tuple[float, float]]:
    """Yield the mean square difference of neighbouring samples and the mean of each part, NaN where mostly missing."""
    for first in range(0, record.samples, size):
        values = record.values(first, min(size, record.samples - first))
        step = np.diff(values)
        there = np.isfinite(step)
        if there.sum() < size // 4:
            yield np.nan, np.nan
        else:
            yield float(np.mean(step[there] ** 2)), float(np.nanmean(values))


def _emptied_parts(record: RunningSum, bad: np.ndarray, size: int) -> Iterator[np.ndarray]:
    for first, values in record.chunks():
        part = (first + np.arange(len(values))) // size
        yield np.where(bad[part], np.nan, values + record.shift)
