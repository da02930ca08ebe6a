"""A uniformly sampled record as its running sum on disk, with its missing samples, outliers and sudden changes.

The running sum of a rate is an angle in units of the sampling interval, that of an acceleration a velocity: the mean
over any span is a difference of two of its values.  It is kept in an unnamed scratch file and read in chunks.

Outliers, steps and transients of turn-on or of temperature are changes of the output that are no noise.  The terms of
IEEE Std 952 are Gaussian, and so are the differences of neighbouring means at every averaging time (those of the Allan
variance).  One beyond many robust standard deviations of the others is no part of the noise; yet its square enters
every estimate, and the slow terms most.  Rare samples far from their neighbours are taken out.
"""

import tempfile
import weakref
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import IO

import numpy as np
import scipy  # loads its parts when they are first used

from imubayes.campaign.run_tables import RowBatch
from imubayes.campaign.sampling_rate import sampling_interval
from imubayes.foundations.errors import input_error
from imubayes.foundations.numerics import true_stretches

CHUNK = 1 << 17
_LOST = 1.5  # a time step of more sampling intervals than this has lost samples
_JITTER = 2.5  # two steps of less than this are two samples, one late
_IRREGULAR = 0.35  # of a sampling interval: a step that is further from a whole number of intervals
_MOST_IRREGULAR = 0.2  # of the steps; uniform jitter of a third of an interval makes 0.2, random times 0.5
_RESOLUTION_ROWS = 1 << 19  # samples from which the resolution is taken
_SAME = 1e-9  # of the range of the values: closer ones differ by rounding
_MOST_EMPTY = 4  # times the samples: gaps in a longer grid make the record one of several records


@dataclass(frozen=True)
class Holes:
    """Missing samples: half-open intervals of sample numbers, in increasing order.

    Attributes
    ----------
    start, stop : shape (H,).
    """

    start: np.ndarray
    stop: np.ndarray

    @property
    def total(self) -> int:
        """Number of missing samples."""
        return int(np.sum(self.stop - self.start))

    def before(self, place: np.ndarray) -> np.ndarray:
        """Return how many of the samples before each place are missing; exact, as the count is piecewise linear."""
        knots = np.stack([self.start, self.stop], axis=1).ravel().astype(float)
        steps = np.stack([np.zeros_like(self.start), self.stop - self.start], axis=1).ravel()
        return np.rint(np.interp(place, knots, np.cumsum(steps), left=0.0)).astype(np.int64)


class RunningSum:
    """Running sum S_i = Σ_(j<i) (x_j − x̃) of a record's samples, x̃ a constant near their mean; S_0 = 0.

    Attributes
    ----------
    samples : N, on the uniform grid, the missing ones included; S has N + 1 values.
    interval : sampling interval, s.
    shift : x̃.
    holes : the missing samples, which add 0 to the sum; None if there are none.
    resolution : smallest step between values of the samples, by the first half million of them; 0 if all are equal.
    """

    def __init__(
        self, file: IO[bytes], samples: int, interval: float, shift: float, holes: Holes | None, resolution: float
    ):
        self._file = file
        weakref.finalize(self, file.close)
        self.samples = samples
        self.interval = interval
        self.shift = shift
        self.holes = holes
        self.resolution = resolution

    @property
    def present(self) -> int:
        """Number of samples that are not missing."""
        return self.samples - (0 if self.holes is None else self.holes.total)

    def read(self, first: int, count: int) -> np.ndarray:
        """Return S_first … S_(first + count − 1), shape (count,)."""
        found = np.empty(count)
        self._file.seek(8 * first)
        if self._file.readinto(found.data) != found.nbytes:  # type: ignore[attr-defined]
            raise OSError("the scratch file of the running sum is truncated")
        return found

    def values(self, first: int, count: int) -> np.ndarray:
        """Return samples less x̃ from a place on, shape (count,), NaN where missing."""
        found = np.diff(self.read(first, count + 1))
        if self.holes is not None:
            found[np.diff(self.missing_before(first + np.arange(count + 1))) > 0] = np.nan
        return found

    def chunks(self, size: int = CHUNK) -> Iterator[tuple[int, np.ndarray]]:
        """Yield place and values of consecutive parts of the record."""
        for first in range(0, self.samples, size):
            yield first, self.values(first, min(size, self.samples - first))

    def missing_before(self, place: np.ndarray) -> np.ndarray:
        """Return how many of the samples before each place are missing."""
        return np.zeros(len(place), dtype=np.int64) if self.holes is None else self.holes.before(place)


def from_samples(values: np.ndarray, interval: float) -> RunningSum:
    """Return the running sum of samples in memory, shape (N,), NaN where missing."""
    return from_parts([np.asarray(values, dtype=float)], interval)


def from_parts(parts: Iterable[np.ndarray], interval: float, resolution: float | None = None) -> RunningSum:
    """Return the running sum of consecutive samples, NaN where missing, of a known resolution if one is given."""
    writer = _Writer()
    for part in parts:
        writer.add(part, writer.next)
    record = writer.finish(interval)
    record.resolution = record.resolution if resolution is None else resolution
    return record


def running_sums(batches: Iterable[RowBatch], channels: Sequence[str], where: str) -> dict[str, RunningSum]:
    """Return the running sum of each channel of a log with a time column, channels without a sample left out.

    Samples are put on a uniform grid by their times; lost ones, and empty cells, are missing.

    Raises
    ------
    InputError
        for a log whose time does not advance, or whose gaps are longer than the record.
    """
    grid = _Grid(where)
    writers = {name: _Writer() for name in channels}
    for batch in batches:
        place = grid.places(batch.numbers["time_s"])
        for name, writer in writers.items():
            writer.add_at(batch.numbers[name], place)
    interval = grid.interval()
    return {name: writer.finish(interval, grid.size) for name, writer in writers.items() if writer.any}


class _Grid:
    """Places of samples on a uniform grid, batch by batch; clocks may drift and time stamps may jitter."""

    def __init__(self, where: str):
        self._where = where
        self._step: float | None = None
        self._first = self._last = np.nan
        self._rows = self._irregular = 0
        self.size = 0

    def places(self, time: np.ndarray) -> np.ndarray:
        """Return the sample number of each row, shape (n,)."""
        if not len(time):
            return np.zeros(0, dtype=np.int64)
        self._step = self._step or sampling_interval(time)
        if self._step is None:
            raise self._refuse("the time does not advance", "correct the time column")
        opening = np.isnan(self._last)
        if opening:
            self._first = float(time[0])
        step = np.diff(time, prepend=time[0] - self._step if opening else self._last) / self._step
        pair = np.concatenate([[np.inf], step[1:] + step[:-1], [np.inf]])
        late = (pair[:-1] < _JITTER) | (pair[1:] < _JITTER)
        lost = (step > _LOST) & ~late
        place = self.size - 1 + np.cumsum(np.where(lost, np.rint(np.where(lost, step, 1.0)), 1.0)).astype(np.int64)
        self._last, self._rows = float(time[-1]), self._rows + len(time)
        self.size = int(place[-1]) + 1
        self._irregular += int(np.sum(np.abs(step - np.maximum(1.0, np.rint(step))) > _IRREGULAR))
        if self.size > _MOST_EMPTY * self._rows + CHUNK:
            raise self._refuse("the gaps are far longer than the record", "give each part as a run of its own")
        return place

    def interval(self) -> float:
        """Return the mean sampling interval, s."""
        if self.size < 2:
            raise self._refuse("the record has fewer than two samples", "give a longer record")
        if self._irregular > _MOST_IRREGULAR * self._rows:
            share = self._irregular / self._rows
            raise self._refuse(
                f"the time has no constant sampling interval: {share:.0%} of the steps are irregular",
                "give raw samples at the rate of the sensor, or resample with a stated filter",
            )
        return (self._last - self._first) / (self.size - 1)

    def _refuse(self, what: str, remedy: str):
        return input_error(what, f"{self._where}, column 'time_s'", "seconds at a constant sampling interval", remedy)


class _Writer:
    """Writes one running sum."""

    def __init__(self) -> None:
        self._file = tempfile.TemporaryFile()  # noqa: SIM115  (lives as long as the running sum)
        self._file.write(np.zeros(1).tobytes())
        self._total, self.next, self._shift = 0.0, 0, np.nan
        self._unused = weakref.finalize(self, self._file.close)
        self._holes: list[tuple[int, int]] = []
        self._resolution = np.inf

    @property
    def any(self) -> bool:
        """Whether there has been a sample."""
        return bool(np.isfinite(self._shift))

    def add_at(self, values: np.ndarray, place: np.ndarray) -> None:
        """Add samples at increasing places of the grid; places left out are missing."""
        if not len(values):
            return
        breaks = np.flatnonzero(np.diff(place) > 1) + 1
        for part, first in zip(np.split(values, breaks), place[np.concatenate([[0], breaks]).astype(int)], strict=True):
            self.add(part, int(first))

    def add(self, values: np.ndarray, first: int) -> None:
        """Add consecutive samples from a place of the grid on, shape (n,); NaN where missing."""
        self._skip(first)
        empty = ~np.isfinite(values)
        if self.next < _RESOLUTION_ROWS or not np.isfinite(self._resolution):
            self._resolution = min(self._resolution, _resolution(values[~empty]))
        if not self.any and not empty.all():
            self._shift = float(np.median(values[~empty]))
        self._holes += [(first + a, first + b) for a, b in true_stretches(empty).tolist()]
        # The total goes in first, so that every partial sum is rounded once.
        sums = np.where(empty, 0.0, values - (self._shift if self.any else 0.0))
        sums[:1] += self._total
        np.cumsum(sums, out=sums)
        self._file.write(sums.tobytes())
        self._total, self.next = float(sums[-1]) if len(sums) else self._total, first + len(values)

    def _skip(self, first: int) -> None:
        if first > self.next:
            self._holes.append((self.next, first))
            for count in _chunk_lengths(first - self.next):
                self._file.write(np.full(count, self._total).tobytes())

    def finish(self, interval: float, size: int | None = None) -> RunningSum:
        """Return the running sum over a grid of `size` samples."""
        self._skip(self.next if size is None else size)
        self._file.flush()
        self._unused.detach()
        holes = None
        if self._holes:
            start, stop = np.array(self._holes, dtype=np.int64).T
            joined = np.concatenate([[True], start[1:] > stop[:-1]])
            holes = Holes(start[joined], stop[np.concatenate([joined[1:], [True]])])
        resolution = self._resolution if np.isfinite(self._resolution) else 0.0
        return RunningSum(self._file, size or self.next, interval, self._shift, holes, resolution)


def _resolution(values: np.ndarray) -> float:
    """Return the smallest step between different values; infinite if there is none."""
    apart = np.diff(np.unique(values))
    apart = apart[apart > _SAME * float(apart.sum())] if len(apart) else apart
    return float(apart.min()) if len(apart) else np.inf


def _chunk_lengths(count: int) -> list[int]:
    return [min(CHUNK, count - done) for done in range(0, count, CHUNK)]


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
    """Return a record with its outliers missing, and what they are; None if there are none."""
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
    """Return the most striking difference of neighbouring means beyond `THRESHOLD`; None if there is none."""
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
