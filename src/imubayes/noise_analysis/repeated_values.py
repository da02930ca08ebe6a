"""Values that are repeated: a sensor of a lower rate in a log of a higher one, taken at its own rate.

Held values are told from rounding by what follows a jump.  The increments of noise that is rounded to steps have a
unimodal distribution, whether or not they are correlated: after a jump of two steps or more no change at all is rarer
than a change by one step up or down.  Held values stay.  Noise within one step makes no such jumps; there only a hold
of a constant number of samples shows, by changes that all fall on the same place of its cycle.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from imubayes.noise_analysis.running_sum import CHUNK, RunningSum, from_parts
from imubayes.tail_probabilities import binomial_survival

_ALPHA = 1e-6  # chance of calling a record held that is not
_FINEST = 0.01  # quantile of the changes taken for a step where the steps of the log differ
_LONGEST = 64  # samples of a hold of a constant number
_ON_CYCLE = 0.9  # of the changes, at least, on one place of the cycle
_REVERSED = 0.2  # of the changes within one step, at least, go back: those of a ramp do not
_HEAD = 1 << 19  # samples by which repetition is found
_COMMON = 1e-3  # share of equal neighbouring values from which a long run is taken for several values
_OFTEN = 0.1  # share of equal neighbouring values at which runs of an irregular length cannot be counted
_ONE_MORE = 1.5  # samples between long and short repetitions where two clocks beat
_SEVERAL = 1.5  # times the usual length: a long run


@dataclass(frozen=True)
class Repetition:
    """How values are repeated.

    Attributes
    ----------
    mean : samples of one value.
    shortest, longest : samples of the 5th and the 95th of 100 values.
    interval_s : between values.
    counted : whether each run of equal values is one value, or a known number of them; a coarse log with an irregular
        repetition does not tell.
    """

    mean: float
    shortest: int
    longest: int
    interval_s: float
    counted: bool = True


@dataclass(frozen=True)
class _Runs:
    """Runs of equal values: their value and length, and the sample at which each begins; missing ones are runs too."""

    value: np.ndarray
    length: np.ndarray
    start: np.ndarray


def at_own_rate(record: RunningSum) -> tuple[RunningSum, Repetition | None]:
    """Return a record with one sample for each value of the sensor, and how they were repeated; None where not."""
    if not record.resolution:
        return record, None
    head = _joined(_runs(record, _HEAD))
    if not _held_after_jumps(head, record.resolution) and not _held_on_a_cycle(head):
        return record, None
    runs = _bridged(_joined(_runs(record, record.samples)), record.resolution)
    present = np.isfinite(runs.value)
    count, mean, counted = _values_of_runs(runs.value[present], runs.length[present], record.resolution)
    if mean < 1 + _FINEST:
        return record, None
    number = np.maximum(1, np.rint(runs.length / mean)).astype(np.int64)
    number[present] = count
    interval = record.samples * record.interval / int(number.sum())
    shortest, longest = (round(float(np.quantile(runs.length[present] / count, q))) for q in (0.05, 0.95))
    repetition = Repetition(mean, shortest, longest, interval, counted)
    parts = np.array_split(np.arange(len(number)), max(1, len(number) // CHUNK))
    values = (np.repeat(runs.value[part] + record.shift, number[part]) for part in parts)
    return from_parts(values, interval, record.resolution), repetition


def _runs(record: RunningSum, samples: int) -> Iterator[_Runs]:
    """Yield the runs of equal values, part by part; a run that goes over a seam is joined to the next part."""
    kept = np.zeros(0)
    for first, values in record.chunks():
        if first >= samples:
            return
        last = first + len(values) >= record.samples
        begin, joined = first - len(kept), np.concatenate([kept, values])
        missing = np.isnan(joined)
        changed = np.abs(np.diff(joined)) > record.resolution / 2
        edges = np.concatenate([[0], np.flatnonzero(changed | (missing[1:] != missing[:-1])) + 1])
        length = np.diff(np.concatenate([edges, [len(joined)]]))
        done = len(edges) if last or len(edges) == 1 else len(edges) - 1
        kept = joined[edges[done] :] if done < len(edges) else np.zeros(0)
        yield _Runs(joined[edges[:done]], length[:done], begin + edges[:done])


def _joined(parts: Iterable[_Runs]) -> _Runs:
    found = list(parts)
    value, length, start = (
        np.concatenate([getattr(part, name) for part in found]) for name in ("value", "length", "start")
    )
    return _Runs(value, length, start)


def _bridged(runs: _Runs, resolution: float) -> _Runs:
    """Return the runs with missing samples within a value, or at its end, as samples of that value."""
    value = runs.value.copy()
    usual = float(np.median(runs.length[np.isfinite(value)]))
    short = np.flatnonzero(np.isnan(value) & (runs.length < usual))
    short = short[short > 0]
    value[short] = value[short - 1]
    gone = np.isnan(value)
    new = (np.abs(np.diff(value)) > resolution / 2) | (gone[1:] != gone[:-1])
    first = np.concatenate([[0], np.flatnonzero(new) + 1])
    return _Runs(value[first], np.add.reduceat(runs.length, first), runs.start[first])


def _held_after_jumps(runs: _Runs, resolution: float) -> bool:
    """Whether no change follows a jump more often than a change by one step does."""
    value, length = runs.value, runs.length
    jump = np.diff(value)  # NaN beside missing samples
    inside = (value[1:] > np.nanmin(value) + resolution / 2) & (value[1:] < np.nanmax(value) - resolution / 2)
    after = np.flatnonzero((np.abs(jump) > 1.5 * resolution) & inside)  # not where a converter is at its end
    if not len(after):
        return False
    stays = int(np.sum(length[after + 1] > 1))
    following = np.abs(jump[np.minimum(after + 1, len(jump) - 1)][length[after + 1] == 1])
    following = following[np.isfinite(following)]
    step = max(resolution, float(np.quantile(following, _FINEST))) if len(following) else resolution
    return _more(stays, int(np.sum(following < 1.5 * step)))


def _held_on_a_cycle(runs: _Runs) -> bool:
    """Whether the changes fall on the same place of a cycle, and go to and fro as those of a ramp do not."""
    jump = np.diff(runs.value)
    at = runs.start[1:][np.isfinite(jump)]
    jump = jump[np.isfinite(jump)]
    if len(jump) < 2 * _LONGEST or np.mean(jump[1:] * jump[:-1] < 0) < _REVERSED:
        return False
    for cycle in range(2, _LONGEST + 1):
        most = int(np.bincount(at % cycle, minlength=cycle).max())
        chance = binomial_survival(most, len(at), 1 / cycle) * cycle * _LONGEST
        if most >= _ON_CYCLE * len(at) and chance < _ALPHA:
            return True
    return False


def _more(one: int, other: int) -> bool:
    """Whether one count is larger than another by more than chance explains."""
    return one > other and binomial_survival(one, one + other, 0.5) < _ALPHA


def _values_of_runs(value: np.ndarray, length: np.ndarray, resolution: float) -> tuple[np.ndarray, float, bool]:
    """Return how many values each run has, shape (runs,), the mean samples of one, and whether that is certain.

    One, unless the log is so coarse that neighbouring values are often equal by chance, as values one apart tell, and
    long runs are no more frequent than that.
    """
    count = np.ones(len(length), dtype=np.int64)
    equal = float(np.mean(np.abs(value[2:] - value[:-2]) < resolution / 2)) if len(value) > 2 else 0.0
    mean = float(np.median(length))
    long = float(np.mean(length >= _SEVERAL * mean))
    if equal < _COMMON or long > _SEVERAL * equal + _COMMON:
        return count, float(length.mean()), equal < _FINEST
    for _ in range(10):
        count = np.maximum(1, np.rint(length / mean)).astype(np.int64)
        mean = float(length.sum() / count.sum())
    low, high = np.quantile(length / count, [0.05, 0.95])
    return count, mean, equal < _OFTEN or high - low < _ONE_MORE
