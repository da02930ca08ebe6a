"""Changes of the output that are no noise: outliers, steps, transients of turn-on or of temperature.

The terms of IEEE Std 952 are Gaussian, and so are the differences of neighbouring means at every averaging time (those
of the Allan variance).  One beyond many robust standard deviations of the others is no part of the noise; yet its
square enters every estimate, and the slow terms most.  Rare samples far from their neighbours are taken out.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy  # loads its parts when they are first used

from imubayes.noise_analysis.running_sum import CHUNK, RunningSum, from_parts

# Chance of a normal value beyond: 2.6e-12.  With the scale known to 30 %, as from 64 differences, it is 1e-6.
THRESHOLD = 7.0
_LEAST_DIFFERENCES = 64
_LONGEST_IN_CHUNK = CHUNK // 128  # longer spans are looked at in a decimated copy of the running sum
_MOST_MISSING = 0.05  # of the samples of a span
_NORMAL = 0.674490  # third quartile: the median of the absolute value
_OUTLIER = 9.0  # robust standard deviations from the median of the neighbours; no normal value in 1e17 is
_NEIGHBOURS = 11  # samples of that median: outliers of up to five samples
_RARE = 1e-3  # share of the samples; more are no outliers but the tails of the noise


@dataclass(frozen=True)
class SuddenChange:
    """The most striking difference of neighbouring means.

    Attributes
    ----------
    time_s : of the middle of the two spans, from the start of the record.
    tau_s : length of either span.
    change : of the mean from one span to the next, output units.
    ratio : its absolute value over the robust standard deviation of such differences.
    """

    time_s: float
    tau_s: float
    change: float
    ratio: float


@dataclass(frozen=True)
class OutlyingSamples:
    """Samples far from their neighbours: how many, when the largest from the start, and how large in output units."""

    count: int
    time_s: float
    size: float


def without_outliers(record: RunningSum) -> tuple[RunningSum, OutlyingSamples | None]:
    """Return a record with its outliers missing, and what they are; None where there are none."""
    places: list[np.ndarray] = []
    time = size = 0.0
    for first, values in record.chunks():
        known = np.flatnonzero(np.isfinite(values))
        if len(known) < _LEAST_DIFFERENCES:
            continue
        apart = values[known] - scipy.ndimage.median_filter(values[known], _NEIGHBOURS, mode="nearest")
        # Of an output that mostly repeats its value the scale is a step of the log.
        scale = max(float(np.median(np.abs(apart))) / _NORMAL, record.resolution)
        far = np.flatnonzero(np.abs(apart) > _OUTLIER * scale)
        places.append(first + known[far])
        if len(far) and float(np.abs(apart[far]).max()) > abs(size):
            largest = far[int(np.argmax(np.abs(apart[far])))]
            time, size = float(first + known[largest]) * record.interval, float(apart[largest])
    taken = np.concatenate(places) if places else np.zeros(0, dtype=int)
    if not len(taken) or len(taken) > max(1.0, _RARE * record.present):
        return record, None
    kept = from_parts(_emptied(record, taken), record.interval, record.resolution)
    return kept, OutlyingSamples(len(taken), time, size)


def _emptied(record: RunningSum, places: np.ndarray) -> Iterator[np.ndarray]:
    for first, values in record.chunks():
        inside = places[(places >= first) & (places < first + len(values))]
        values[inside - first] = np.nan
        yield values + record.shift


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
