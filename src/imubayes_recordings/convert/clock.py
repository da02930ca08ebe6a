"""The times of the samples: their unit, and what is wrong with the clock.

Clocks of recordings stand still, go back, wrap round, jitter and leave gaps; loggers write the time at which a packet
arrived, not that of its samples.  Faults that can be corrected without doubt are corrected and reported: a counter that
wraps, rows that are repeated or out of order, packets.  Gaps and jitter are said, with the option that takes samples as
even.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import scipy  # loads its parts when they are first used

from imubayes.campaign.sampling_rate import MOST_HZ, USUAL_HZ
from imubayes.foundations.errors import input_error
from imubayes.foundations.numerics import true_stretches
from imubayes.foundations.wording import counted
from imubayes_recordings.convert.column_choice import ChosenTable
from imubayes_recordings.convert.column_names import CLOCK, COUNTER, DATE, SIX, TIME, TIME_UNITS
from imubayes_recordings.convert.options import ConvertOptions

_RATES = {unit: factor for unit, factor in TIME_UNITS.items() if unit in ("s", "ms", "us", "ns", "d")}
_LEAST_HZ = 1e-3  # below which the unit of the time is wrong
_WHOLE_SECOND = 0.99
_EPOCH = (1e9, 3e9)  # s since 1970 of recordings from 2001 to 2065
# The fifth is that of microseconds in ms; the others are a day and a week.
_WRAPS = (2.0**8, 2.0**16, 2.0**24, 2.0**32, 2.0**32 / 1000, 86400.0, 86400e3, 604800.0, 604800e3)
_COARSE = 5000.0  # ticks of SampleTimeFine a sample: more would be less than 2 Hz in 100 µs
_OUT_OF_ORDER = 1e-3  # share of the rows that may be late
_GAP = 1.6  # sampling intervals
_JITTER = 0.1  # of the sampling interval
_PACKED = 0.3  # of the mean step, below which a step is within a packet
_FEW = 0.05  # share of the steps that are pauses of a record at most; packets have more, or steps below the next number
_WITHIN = 2e-3  # s, of steps within a packet
_LEAST_CORNERS = 50  # samples between a step within a packet and one between packets
_AS_EVEN, _AS_RECORDED = 1.4, 0.8  # roughness by the recorded times over that by even ones; at most 1.16 of white noise
_PACKETS, _REFINEMENTS = 50, 3  # packets of a window, and rounds
_OWN = 0.7  # of the jump of the delay, that is the length of its pause
_DAY = 86400.0
_LEAST_HELD = 1.5  # rows a sample, from which it is repeated
_SEVERAL_STEPS, _LEAST_CHANGES = 4.0, 20  # of a converter, and changes so large
_PROBED = 300_000  # rows
_FROZEN, _SELDOM = 10, 1e-3  # repeated rows of a stretch that is no chance, and the share of others that may repeat


@dataclass(frozen=True)
class Clock:
    """Times of the rows of a table.

    Attributes
    ----------
    time : s, increasing, shape (rows kept,).
    keep : which rows are kept, shape (N,).
    unit : in which the time is recorded; empty if it is made from a rate, or words.
    guess : why the unit was taken; empty if it is stated.
    notes : what was found, in words.
    """

    time: np.ndarray
    keep: np.ndarray
    unit: str
    guess: str
    notes: tuple[str, ...]


def read_clock(
    table: ChosenTable, values: Mapping[str, np.ndarray], filled: np.ndarray, options: ConvertOptions
) -> Clock | None:
    """Return the clock of a table without the rows that repeat a sample; None if it has none.

    Parameters
    ----------
    filled : which rows have a reading, shape (N,).

    Raises
    ------
    InputError
        if the unit of the time is not known, or the time goes back.
    """
    clock = _clock(table, values, filled, options)
    if clock is None:
        return None
    _refuse_impossible(clock, f"{table.topic.where}, column of the time")
    again, times = _held([values[name][clock.keep] for name in SIX if name in values])
    if times >= _LEAST_HELD:
        remain = len(clock.time) - int(again.sum())
        rate = (remain - 1) / float(np.ptp(clock.time[~again]))
        note = f"the logger repeats each sample {times:.3g} times on average: {int(again.sum())} rows are left out"
        return _without(clock, again, f"{note}, {remain} samples at {rate:.4g} Hz remain")
    if (frozen := _frozen(again)).any():
        many = counted(int(frozen.sum()), "row")
        note = f"{many} in stretches of the same readings left out: the logger had lost its sensor"
        return _without(clock, frozen, note)
    return clock


def _refuse_impossible(clock: Clock, where: str) -> None:
    """Raise InputError for a sampling rate that no inertial unit has, with the unit of time that gives a usual one."""
    step = _mean_step(clock.time)
    rate = 1 / step if step > 0 else 0.0
    rates, other = _rates_of(step / _RATES[clock.unit] if clock.unit in _RATES else 0.0)
    fast, slow = rate > MOST_HZ, 0 < rate < _LEAST_HZ
    if not (fast or (slow and other)):
        return
    stated = f"in {clock.unit}, as stated" if clock.unit else "as stated"
    raise input_error(
        f"the sampling rate is {rate:.4g} Hz {stated}",
        where,
        ", ".join(f"{rates[unit]:.4g} Hz in {unit}" for unit in other) or f"at most {MOST_HZ:g} Hz",
        f"state the unit of the time, such as --time-unit {other[0]}" if other else "correct the time or the rate",
    )


def _without(clock: Clock, rows: np.ndarray, note: str) -> Clock:
    """Return a clock without some of its rows, (rows kept,)."""
    keep = clock.keep.copy()
    keep[np.flatnonzero(keep)[rows]] = False
    return replace(clock, time=clock.time[~rows], keep=keep, notes=(*clock.notes, note))


def _frozen(again: np.ndarray) -> np.ndarray:
    """Return the rows, (N,), of long stretches that read the same, if others hardly ever read the same again."""
    frozen = np.zeros(len(again), dtype=bool)
    for start, stop in true_stretches(again).tolist():
        if stop - start >= _FROZEN:
            frozen[start - 1 : stop] = True  # with the first of them
    return frozen if np.sum(again & ~frozen) < _SELDOM * len(again) and not frozen.all() else np.zeros_like(frozen)


def _held(columns: Sequence[np.ndarray]) -> tuple[np.ndarray, float]:
    """Return which rows repeat the one before, (N,), and how many rows a sample has; 1 where each row is a sample.

    A quiet sensor of coarse steps reads the same again at rest, and not in motion or noise: what counts is how long the
    rows before the largest changes were the same, if these changes are of several steps.
    """
    again = _repeated(np.zeros(len(columns[0])), columns)
    if np.mean(again) < 1 - 1 / _LEAST_HELD:
        return again, 1.0
    change = np.stack([np.abs(np.diff(column[:_PROBED])) for column in columns], axis=1)
    steps = np.array([np.min(column[column > 0], initial=np.inf) for column in change.T])
    places = np.flatnonzero(~again[:_PROBED])
    size = (change[places[1:] - 1] / steps).max(axis=1)
    large = size >= max(_SEVERAL_STEPS, float(np.quantile(size, 0.75, method="lower")) if len(size) else np.inf)
    lasted = np.diff(places)[large]
    return again, float(np.mean(lasted)) if len(lasted) >= _LEAST_CHANGES else 1.0


def _clock(
    table: ChosenTable, values: Mapping[str, np.ndarray], filled: np.ndarray, options: ConvertOptions
) -> Clock | None:
    rows = len(next(iter(values.values())))
    rate = options.sample_rate_hz or (table.topic.rate_hz if TIME not in values else None)
    channels = [values[name] for name in SIX if name in values]
    numbers, lost = _sample_numbers(values.get(COUNTER), filled)
    values, empty = _without_empty(table, values)
    lost += empty
    if rate is not None:
        places = np.arange(rows)[filled] if numbers is None else numbers
        return Clock(places / rate, filled, "", "", lost)
    if TIME in values:
        unit, guess = _unit(table, values[TIME], options)
        raw, factor = np.asarray(values[TIME]), TIME_UNITS[unit]
    elif CLOCK in values:
        unit, guess, factor = "", "", 1.0
        raw = np.asarray(values[CLOCK]) + (np.asarray(values[DATE]) if DATE in values else 0.0)
        raw = raw + (0.0 if DATE in values else _DAY) * np.cumsum(np.diff(raw, prepend=raw[:1]) < -_DAY / 2)
    else:
        return None
    keep = filled & np.isfinite(raw)
    if not keep.any():
        what = "no row has both a time and a reading"
        remedy = "state the columns of time and channels, or --sample-rate-hz"
        raise input_error(what, table.topic.where, "rows with both", remedy)
    time, wrapped = _unwrapped(raw[keep], factor)
    late = time < np.maximum.accumulate(time)
    if late.mean() > _OUT_OF_ORDER:
        raise _goes_back(table, time, int(late.sum()))
    repeated = _repeated(time, _rows(channels, keep)) | late
    keep[np.flatnonzero(keep)[repeated]] = False
    time, notes = time[~repeated], list(wrapped)
    if late.any():
        notes.append(f"{counted(int(late.sum()), 'sample')} out of order left out")
    if (repeated & ~late).any():
        notes.append(f"{counted(int((repeated & ~late).sum()), 'repeated sample')} left out")
    time, found = _mended(time, _rows(channels, keep), options)
    return Clock(time, keep, unit, guess, (*notes, *found, *lost))


def _rows(columns: Sequence[np.ndarray], keep: np.ndarray) -> list[np.ndarray]:
    return [column[keep] for column in columns]


def _without_empty(
    table: ChosenTable, values: Mapping[str, np.ndarray]
) -> tuple[Mapping[str, np.ndarray], tuple[str, ...]]:
    """Return the columns without a time that no row has, and a note on it."""
    if TIME not in values or np.isfinite(values[TIME]).any():
        return values, ()
    note = f"the column of the time, {table.columns[TIME].position + 1}, is empty: not used"
    return {name: column for name, column in values.items() if name != TIME}, (note,)


def _unit(table: ChosenTable, time: np.ndarray, options: ConvertOptions) -> tuple[str, str]:
    """Return the unit of a time column, and why it was taken if neither name nor option states it."""
    stated = options.time_unit or table.columns[TIME].unit
    filled = time[np.isfinite(time)]
    if stated == "100us" and not options.time_unit and (step := _mean_step(filled)) > _COARSE:
        return "us", f"mean step {step:.5g}: {1e6 / step:.5g} Hz in us, as of Movella DOT, {1e4 / step:.3g} Hz in 100us"
    if stated in TIME_UNITS:
        return stated, ""
    start = abs(float(filled[:1].sum()))
    since = [unit for unit, factor in _RATES.items() if _EPOCH[0] < start * factor < _EPOCH[1]]
    if since:
        return since[0], f"{start:.10g} is a time since 1970 in {since[0]}"
    return _unit_of_step(
        _mean_step(filled), bool((filled[:1000] % 1 == 0).all()), f"{table.topic.where}, column of the time"
    )


def _mean_step(time: np.ndarray) -> float:
    """Return the mean of the steps forward without pauses; packets stay in."""
    step = np.diff(time)
    step = step[step > 0]
    return float(np.mean(step[step <= 50 * np.quantile(step, 0.95)])) if len(step) else 0.0


def _rates_of(step: float) -> tuple[dict[str, float], list[str]]:
    """Return the sampling rate that a mean step gives in each unit of time, Hz, and the units of usual rates."""
    rates = {unit: 1 / (step * factor) for unit, factor in _RATES.items()} if step else {}
    return rates, [unit for unit, rate in rates.items() if USUAL_HZ[0] <= rate <= USUAL_HZ[1]]


def _unit_of_step(step: float, whole: bool, where: str) -> tuple[str, str]:
    """Return the only unit in which a mean step gives a usual sampling rate, and that in words."""
    rates, usual = _rates_of(step)
    if len(usual) > 1 and whole and step < _WHOLE_SECOND:  # seconds would have a fraction
        usual = [unit for unit in usual if unit != "s"]
    if len(usual) == 1:
        unit = usual[0]
        return unit, f"the mean step of {step:.5g} is {rates[unit]:.5g} Hz in {unit}; no other unit gives a usual rate"
    raise input_error(
        f"the unit of the time is not known: its mean step is {step:.5g}",
        where,
        ", ".join(f"{unit} ({rate:.4g} Hz)" for unit, rate in rates.items()) or "s, ms, us, ns",
        f"state it, such as --time-unit {usual[0]}" if usual else "state the rate: --sample-rate-hz N",
    )


def _unwrapped(time: np.ndarray, factor: float) -> tuple[np.ndarray, tuple[str, ...]]:
    """Return times in seconds, a counter that wraps round continued."""
    step = np.diff(time, prepend=time[:1])
    usual = float(np.median(np.abs(step)))
    back = np.flatnonzero(step < 0)
    # The step over the wrap is a usual one once the range of the counter is added.
    for width in _WRAPS:
        over = step[back] + width
        if len(back) and ((over >= 0) & (over < 50 * usual + 1e-300)).all() and np.ptp(time) > 0.5 * width:
            turns = np.zeros(len(time))
            turns[back] = width
            note = f"the time wraps round {counted(len(back), 'time')} at {width:.10g}"
            return (time + np.cumsum(turns)) * factor, (note,)
    return time * factor, ()


def _repeated(time: np.ndarray, channels: Sequence[np.ndarray]) -> np.ndarray:
    """Return which rows repeat the one before, time and values."""
    same = np.diff(time, prepend=np.nan) == 0
    for column in channels:
        same &= np.diff(column, prepend=np.nan) == 0
    return same


def _goes_back(table: ChosenTable, time: np.ndarray, late: int) -> Exception:
    step = np.diff(time)
    first, usual = int(np.argmin(step)), float(np.median(step[step > 0])) if (step > 0).any() else 1.0
    times = int((step < 0).sum())
    return input_error(
        f"the time goes back {times} times, at sample {first + 2} by {-step[first]:.4g} s: a reset, or several "
        f"recordings in one; {late} samples are earlier than a preceding one",
        f"{table.topic.where}, column of the time",
        "times that increase",
        f"--sample-rate-hz {1 / usual:.4g} treats the samples as evenly spaced; or split the file at the resets",
    )


def _in_packets(time: np.ndarray, channels: Sequence[np.ndarray]) -> np.ndarray | None:
    """Return which steps are within a packet, (n − 1,); None of times that are those of the samples.

    A unit in motion decides: each sample next to a long and a short step is interpolated between its neighbours, by the
    recorded times and as if all steps were equal.  The right clock interpolates with the smaller error.  The noise of a
    unit at rest does not depend on the clock; then many long steps, or very short ones, are packets, and few long steps
    are pauses of the record.
    """
    step = np.diff(time)
    packed = step < _PACKED * np.mean(step)
    if packed.mean() <= 0.4 or packed.all():
        return None
    corner = np.flatnonzero(packed[1:] != packed[:-1]) + 1
    if len(corner) >= _LEAST_CORNERS:
        share = step[corner - 1] / (step[corner - 1] + step[corner])
        ratios = [_roughness(column, corner, share) for column in channels]
        smoother, rougher = max(ratios), min(ratios)
        if max(smoother / _AS_EVEN, _AS_RECORDED / rougher) > 1:
            return packed if smoother / _AS_EVEN > _AS_RECORDED / rougher else None
    return packed if (~packed).mean() > _FEW or np.median(step[packed]) < _WITHIN else None


def _roughness(column: np.ndarray, place: np.ndarray, share: np.ndarray) -> float:
    """Return the median interpolation error of samples by the recorded times over that by even ones; 1 of a constant.

    Parameters
    ----------
    column : shape (n,).
    place, share : shape (m,), the samples, and where they are between their neighbours by the recorded times, 0 to 1.
    """
    before, here, after = column[place - 1], column[place], column[place + 1]
    recorded = float(np.nanmedian(np.abs(here - before - share * (after - before))))
    even = float(np.nanmedian(np.abs(here - 0.5 * (before + after))))
    return recorded / even if recorded > 0 and even > 0 else 1.0


def _mended(time: np.ndarray, channels: Sequence[np.ndarray], options: ConvertOptions) -> tuple[np.ndarray, list[str]]:
    """Return increasing times, even if they were asked for or arrive in packets, and what was found."""
    step = np.diff(time)
    if len(step) < 20:
        return time, []
    median = float(np.median(step))
    packed = _in_packets(time, channels)
    if packed is not None:
        between = float(np.median(step[~packed]))
        size = round(1 + packed.sum() / max(1, (~packed).sum()))
        even = _even(time, _lost_packets(time, step > _GAP * between, between, _PACKETS * size))
        rate = 1 / float(np.median(np.diff(even)))
        note = (
            f"samples arrive in packets of {size} (steps of {1e3 * float(np.median(step[packed])):.3g} ms within and "
            f"{1e3 * between:.3g} ms between)"
        )
        if options.clock == "recorded":
            return _increasing(time), [f"{note}: --clock even treats them as evenly spaced at {rate:.5g} Hz"]
        return even, [f"{note}: treated as even at {rate:.5g} Hz; --clock recorded keeps their times"]
    gaps = step > _GAP * median
    notes = []
    if gaps.any():
        missing = int(np.sum(np.round(step[gaps] / median) - 1))
        lost = f"{counted(missing, 'sample')} missing"
        notes.append(f"{counted(int(gaps.sum()), 'gap')}, the longest of {step.max():.3g} s: {lost}")
    jitter = float(np.std(step[~gaps])) / median
    if options.clock == "even":
        even = _even(time, gaps)
        return even, [
            *notes,
            f"samples are treated as evenly spaced at {1 / float(np.median(np.diff(even))):.6g} Hz, as requested",
        ]
    if jitter > _JITTER:
        notes.append(
            f"the time jitters by {1e3 * jitter * median:.3g} ms, {100 * jitter:.3g} % of the sampling interval: "
            "--clock even treats the samples as evenly spaced"
        )
    return _increasing(time), notes


def _even(time: np.ndarray, gaps: np.ndarray) -> np.ndarray:
    """Return evenly spaced times of the stretches between gaps, at the mean rate of all.

    Parameters
    ----------
    time : shape (n,), s.
    gaps : which steps are gaps, shape (n − 1,).
    """
    interval, even = _slope(time, gaps), np.empty(len(time))
    index = np.arange(len(time), dtype=float)
    for start, stop in _stretches(gaps):
        even[start:stop] = time[start:stop].mean() + interval * (index[start:stop] - index[start:stop].mean())
    return _increasing(even)


def _stretches(gaps: np.ndarray) -> list[tuple[int, int]]:
    return list(pairwise([0, *(np.flatnonzero(gaps) + 1).tolist(), len(gaps) + 1]))


def _slope(time: np.ndarray, gaps: np.ndarray) -> float:
    """Return the slope of lines of one slope through the stretches between gaps: what comes late averages out."""
    index = np.arange(len(time), dtype=float)
    covariance = variance = 0.0
    for start, stop in _stretches(gaps):
        own = index[start:stop] - index[start:stop].mean()
        covariance += float(own @ (time[start:stop] - time[start:stop].mean()))
        variance += float(own @ own)
    return covariance / variance


def _lost_packets(time: np.ndarray, paused: np.ndarray, between: float, window: int) -> np.ndarray:
    """Return the pauses in which samples were lost, (n − 1,).

    Samples that only come late, in a larger packet, leave the least delay of a window after the pause as before it.
    """
    step, gaps = np.diff(time), np.zeros(len(paused), dtype=bool)
    for _ in range(_REFINEMENTS):
        delay = time - _slope(time, gaps) * np.arange(len(time))
        least = scipy.ndimage.minimum_filter1d(delay, window, mode="nearest")  # of the window about each sample
        places = np.arange(len(step))
        before, after = (least[np.clip(places + side, 0, len(step))] for side in (-(window // 2), 1 + window // 2))
        jump = after - before
        gaps = paused & (jump > (_GAP - 1) * between) & (step > _OWN * jump)
    return gaps


def _increasing(time: np.ndarray) -> np.ndarray:
    """Return times that increase: one that repeats is a millionth of the mean step later."""
    step = np.diff(time)
    if (step > 0).all():
        return time
    least = 1e-6 * float(np.mean(np.abs(step)))
    return time[0] + np.concatenate([[0.0], np.cumsum(np.maximum(step, least))])


def _sample_numbers(counter: np.ndarray | None, filled: np.ndarray) -> tuple[np.ndarray | None, tuple[str, ...]]:
    """Return the numbers of the filled samples by a counter, from 0, and a note on those that it misses.

    There are none without a counter, and by a column that does not count up by one for nine samples in ten.
    """
    if counter is None or not np.isfinite(counter[filled]).all() or not filled.any():
        return None, ()
    number, _ = _unwrapped(np.asarray(counter, dtype=float)[filled], 1.0)
    step = np.diff(number)
    if not len(step) or step.min() < 1 or np.any(step % 1) or np.mean(step == 1) < 0.9:
        return None, ()
    jumps = step[step > 1] - 1
    notes = (f"the counter misses {counted(int(jumps.sum()), 'sample')} in {counted(len(jumps), 'place')}",)
    return number - number[0], notes if len(jumps) else ()
