"""Changes of the output that are no noise: outliers, steps, transients of turn-on or of temperature.

The terms of IEEE Std 952 are Gaussian, and so are the differences of neighbouring means at every averaging time (those
of the Allan variance).  One beyond many robust standard deviations of the others is no part of the noise; yet its
square enters every estimate, and the slow terms most.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from imubayes.noise_analysis.running_sum import CHUNK, RunningSum

# Chance of a normal value beyond: 2.6e-12.  With the scale known to 30 %, as from 64 differences, it is 1e-6.
THRESHOLD = 7.0
_LEAST_DIFFERENCES = 64
_LONGEST_IN_CHUNK = CHUNK // 128  # longer spans are looked at in a decimated copy of the running sum
_MOST_MISSING = 0.05  # of the samples of a span
_NORMAL = 0.674490  # third quartile: the median of the absolute value


@dataclass(frozen=True)
class SuddenChange:
    """The most striking difference of neighbouring means.

    Attributes
    ----------
    time : of the middle of the two spans, s from the start of the record.
    tau : length of either span, s.
    change : of the mean from one span to the next, output units.
    ratio : its absolute value over the robust standard deviation of such differences.
    """

    time: float
    tau: float
    change: float
    ratio: float


def sudden_change(record: RunningSum) -> SuddenChange | None:
    """Return the most striking difference of neighbouring means beyond `THRESHOLD`; None where there is none."""
    found: SuddenChange | None = None
    for first, values, missing, stride in _parts(record):
        factor = 1
        while len(values) // factor >= _LEAST_DIFFERENCES + 2:
            here = _largest(values[::factor], missing[::factor], factor * stride)
            if here is not None and (found is None or here[2] > found.ratio):
                place, change, ratio = here
                middle = (first + (place + 1) * factor * stride) * record.interval
                found = SuddenChange(middle, factor * stride * record.interval, change, ratio)
            if stride == 1 and factor >= _LONGEST_IN_CHUNK:
                break
            factor *= 2
    return found


def _parts(record: RunningSum) -> Iterator[tuple[int, np.ndarray, np.ndarray, int]]:
    """Yield place of the first value, running sum, missing samples before each value, and samples between values."""
    coarse = []
    for first in range(0, record.samples, CHUNK):
        values = record.read(first, min(CHUNK, record.samples - first) + 1)
        coarse.append(values[:-1:_LONGEST_IN_CHUNK])
        yield first, values, record.missing_before(first + np.arange(len(values))), 1
    joined = np.concatenate(coarse)
    yield 0, joined, record.missing_before(_LONGEST_IN_CHUNK * np.arange(len(joined))), _LONGEST_IN_CHUNK


def _largest(values: np.ndarray, missing: np.ndarray, span: int) -> tuple[int, float, float] | None:
    """Return place, size and ratio of the largest difference of neighbouring means, if it is beyond the threshold."""
    present = span - np.diff(missing)
    enough = present >= (1 - _MOST_MISSING) * span
    mean = np.diff(values) / np.maximum(present, 1)
    difference = np.where(enough[1:] & enough[:-1], np.diff(mean), np.nan)
    known = np.abs(difference[np.isfinite(difference)])
    scale = float(np.median(known)) / _NORMAL if len(known) >= _LEAST_DIFFERENCES else 0.0
    # Of an output that mostly repeats its last value, the scale is no measure of its noise.
    if not scale or float(known.max()) <= THRESHOLD * scale:
        return None
    place = int(np.nanargmax(np.abs(difference)))
    return place, float(difference[place]), abs(float(difference[place])) / scale
