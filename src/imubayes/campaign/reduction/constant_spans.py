"""Detection of the spans of constant stimulus in a raw log: constant rate, constant angle or rest.

A level is where a rate, an angle or a current keeps one value to within its noise.  The noise of a stimulus column is
estimated from the log itself, so that a set-point, the rate of a tachometer and the differences of a quantised encoder
are divided alike.  A level lasts until the smoothed column has moved from its mean by more than the tolerance; a ramp
is therefore a sequence of levels too short to be kept.

Consecutive blocks at one level of rate, of angle at rest and of current form a span.  A command precedes the motion of
the table, so the ends of a span in which a channel has not settled are removed (`steady_levels`); a span in which none
settles is left out.  If the temperature is the stimulus, spans are divided into bins short enough for it to be
constant.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from imubayes.campaign.equipment import BenchSettings
from imubayes.campaign.reduction.log_survey import BlockSurvey
from imubayes.campaign.reduction.steady_levels import Steady, steady_part
from imubayes.foundations.covariates import TEMPERATURE_COLUMNS
from imubayes.foundations.numerics import group_means

WIDTH = 5  # blocks of the running median; an odd number
NOISE_FACTOR = 5.0  # standard deviations of a block mean within which a level is one level
LEAST_BLOCKS = 25  # of a log, for an estimate of the noise
MOST_NOISE = 0.01  # of the range of a column; what varies more than this is no noise about levels
_QUANTILE, _IN_DEVIATIONS = 0.9, 1.645  # of the absolute value of a normal variable
_RECENT = 50  # blocks over which the mean of a level is taken: slow ripple of a table ends no level


def column_noise(values: np.ndarray) -> float:
    """Return the standard deviation of block means about their running median; 0 for a set-point.

    Moving and still blocks are judged apart, since the rate of an encoder is quiet at rest only.
    """
    good = values[np.isfinite(values)]
    if len(good) < LEAST_BLOCKS:
        return 0.0
    middle = running_median(good)
    apart = np.abs(good - middle)
    moving = np.abs(middle) > 1e-3 * np.abs(middle).max()
    parts = [part for part in (apart, apart[moving], apart[~moving]) if len(part) >= LEAST_BLOCKS]
    noise = max(float(np.quantile(part, _QUANTILE)) for part in parts) / _IN_DEVIATIONS
    return noise if noise < MOST_NOISE * np.ptp(good) or np.ptp(good) < 20 * noise else 0.0


def running_median(values: np.ndarray) -> np.ndarray:
    """Return the median of every value and its neighbours; it keeps steps where they are."""
    if len(values) < WIDTH:
        return values
    padded = np.pad(values, WIDTH // 2, mode="edge")
    return np.median(np.lib.stride_tricks.sliding_window_view(padded, WIDTH), axis=1)


def level_labels(values: np.ndarray, relative: float, absolute: float) -> np.ndarray:
    """Return the number of the level of every block, increasing, shape (len(values),).

    Parameters
    ----------
    values : block means, smoothed.
    relative, absolute : tolerance about the mean of a level, as a share of it and in units of the column.
    """
    label = np.zeros(len(values), dtype=int)
    number, mean, count = 0, float(values[0]), 1
    for place, value in enumerate(values.tolist()[1:], start=1):
        if abs(value - mean) <= relative * abs(mean) + absolute:
            count = min(count + 1, _RECENT)
            mean += (value - mean) / count
        else:
            number, mean, count = number + 1, value, 1
        label[place] = number
    return label


LEAST_READING = 1e-6  # deg; angles are written with six decimals
REST_RATE = 1e-6  # deg/s; rates below it are rest
RATE_TOLERANCE = 1e-3  # relative; rates closer than this are equal
ANGLE_TOLERANCE = 0.01  # deg; smaller than the steps of a dividing head
ANGLE_STEADY = 0.002  # deg; what an angle at rest may vary by within a block
CURRENT_TOLERANCE = 1e-3  # of the largest current
LEAST_SECONDS = 1.0  # shorter spans are transitions
LONG_LEVEL_ROWS, LEAST_SHARE = 4, 0.05  # of a log of slow rows: typical level, and share of it that a level lasts
SMOOTHED_SECONDS = 0.5  # the running median of a stimulus lasts no longer
BIN_KELVIN = 0.25
BIN_SECONDS = 60.0
FOLLOW_SECONDS = 1.0
FOLLOW_DEGREES = 15.0
SMOOTHING_BLOCKS = 51
RECORD_SECONDS = 60.0
RECORD_ROWS = 128  # of a static record, at most: enough for its drift, few enough for its covariance


@dataclass(frozen=True)
class UnsettledLevel:
    """A level of the stimulus that is left out: its first raw row, its time in s, and the output that is not steady.

    `time` is None in a log without; `channel` is empty if the level is shorter than the settling time.
    """

    row: int
    time: float | None
    channel: str


@dataclass
class Dropped:
    """Raw rows in no span, by cause, and the levels that were left out as a whole.

    Attributes
    ----------
    changing : rows at no level of the stimulus, or at one too short for one.
    moving : rows in motion, if only rest is wanted.
    settling : rows at the ends of levels, before the outputs were steady.
    unsettled : rows of `levels`, at which an output never became steady.
    """

    changing: int = 0
    moving: int = 0
    settling: int = 0
    unsettled: int = 0
    levels: list[UnsettledLevel] = field(default_factory=list)


@dataclass(frozen=True)
class Span:
    """Rows `start` to `stop` (exclusive) of constant stimulus; `turning` if the table rotated.

    `passing` spans are windows between levels: the rate changes, and follows the angle (`encoder_path`).
    """

    start: int
    stop: int
    turning: bool = False
    passing: bool = False

    @property
    def rows(self) -> int:
        """Number of rows."""
        return self.stop - self.start


@dataclass(frozen=True)
class Detected:
    """The spans of a log, in its order, and what is in none of them."""

    spans: list[Span]
    dropped: Dropped = field(default_factory=Dropped)


def constant_spans(
    blocks: BlockSurvey,
    channels: tuple[str, ...],
    by_temperature: bool = False,
    rest_only: bool = False,
    bench: BenchSettings | None = None,
) -> Detected:
    """Return the spans of constant stimulus without their transients, in the order of the log.

    Parameters
    ----------
    blocks : survey of the log.
    channels : columns checked for settling.
    by_temperature : divide the spans into bins of at most `BIN_KELVIN` and `BIN_SECONDS`.
    rest_only : return spans at rest only; motion is a change of position.
    bench : settings of the table.
    """
    bench = bench or BenchSettings()
    rate, turning, label, loose = _levels(blocks, bench)
    swept, holed, least = _swept(blocks, rate), _holed(blocks), _least_rows(blocks, label)
    found, dropped, before = [], Dropped(), [np.nan] * len(channels)
    edges = np.flatnonzero(np.diff(label)) + 1
    for begin, end in pairwise([0, *edges.tolist(), blocks.size]):
        first, last = _trimmed(loose, begin, end)
        if last <= first or _rows(blocks, first, last) < least:
            dropped.changing += _rows(blocks, begin, end)
            continue
        dropped.changing += _rows(blocks, begin, end) - _rows(blocks, first, last)
        if rest_only and turning[first]:
            dropped.moving += _rows(blocks, first, last)
            continue
        outputs = [np.where(holed[first:last], np.nan, blocks.mean[name][first:last]) for name in channels]
        if by_temperature:
            # A fast ramp gives short bins; the minimum duration applies to the whole level.
            bins = _settled_bins(blocks, channels, first, last, swept)
        else:
            steady = steady_part(outputs, int(np.median(blocks.count)), swept[first:last], before)
            bins = _settled(blocks, steady, first, least, bench)
            dropped.levels += [] if bins else [_unsettled(blocks, steady, first, channels)]
        kept = sum(_rows(blocks, *each) for each in bins)
        dropped.settling += _rows(blocks, first, last) - kept if kept else 0
        dropped.unsettled += 0 if kept else _rows(blocks, first, last)
        before = [_mean_of(values) for values in outputs]
        found += [_span(blocks, *each, turning) for each in bins]
    return Detected(found, dropped)


def _settled(
    blocks: BlockSurvey, steady: Steady, first: int, least: int, bench: BenchSettings
) -> list[tuple[int, int]]:
    """Return the steady part of a level that begins at block `first`; nothing if an output does not settle."""
    begin, end = _after(blocks, first, steady.first, bench.settling), first + steady.last
    return [(begin, end)] if steady.settled and end > begin and _rows(blocks, begin, end) >= least else []


def _unsettled(blocks: BlockSurvey, steady: Steady, first: int, channels: tuple[str, ...]) -> UnsettledLevel:
    """Return what is said of the level that begins at block `first`."""
    slowest = "" if steady.settled or steady.slowest is None else channels[steady.slowest]
    time = float(blocks.first["time_s"][first]) if "time_s" in blocks.first else None
    return UnsettledLevel(int(blocks.start[first]), time, slowest)


def _levels(blocks: BlockSurvey, bench: BenchSettings) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return per block the rate, whether the table turns, the number of the level, and whether its rate varies."""
    if bench.reading_noise is None:
        rate, within, noise = _rate(blocks)
        smooth = _smoothed(rate, blocks)
    else:
        rate, within, noise = _rate_of_encoder(blocks, bench.reading_noise)
        smooth = rate  # a running median would take a fast oscillation out
    absolute = REST_RATE + (NOISE_FACTOR * noise if bench.rate_tolerance is None else bench.rate_tolerance)
    label = level_labels(np.nan_to_num(smooth), RATE_TOLERANCE, absolute)
    change = np.diff(label) != 0
    level = group_means(smooth, label)
    turning = np.abs(level) > np.maximum(REST_RATE, noise if bench.rate_tolerance is None else bench.rate_tolerance)
    single = 2 * NOISE_FACTOR * noise * np.sqrt(np.median(blocks.count))
    loose = within > RATE_TOLERANCE * np.abs(level) + np.maximum(absolute, single)
    loose |= ~np.isfinite(rate)
    if "table_angle_deg" in blocks.mean:
        angle = np.rad2deg(np.unwrap(np.deg2rad(blocks.first["table_angle_deg"])))
        tolerance = ANGLE_TOLERANCE + NOISE_FACTOR * _angle_noise(angle, turning)
        drift = np.abs(wrap_degrees(blocks.last["table_angle_deg"] - blocks.first["table_angle_deg"]))
        loose |= ~turning & (drift > 2 * tolerance)
        places = level_labels(np.nan_to_num(_smoothed(angle, blocks)), 0.0, tolerance)
        change |= ~turning[1:] & (np.diff(places) != 0)
    change |= turning[1:] != turning[:-1]
    if "current_mA" in blocks.mean:
        least = CURRENT_TOLERANCE * np.nanmax(np.abs(blocks.mean["current_mA"]), initial=1e-12)
        least += NOISE_FACTOR * column_noise(blocks.mean["current_mA"])
        loose |= blocks.high["current_mA"] - blocks.low["current_mA"] > 2 * least
        steps = level_labels(np.nan_to_num(_smoothed(blocks.mean["current_mA"], blocks)), 0.0, least)
        change |= np.diff(steps) != 0
    return rate, turning, np.concatenate([[0], np.cumsum(change)]), loose


def _swept(blocks: BlockSurvey, rate: np.ndarray) -> np.ndarray:
    """Return the angle of the table at each block since the first by its rate, deg; 0 without time."""
    if blocks.interval is None:
        return np.zeros(blocks.size)
    time = blocks.mean["time_s"]
    rate = np.nan_to_num(rate)
    return np.concatenate([[0.0], np.cumsum(np.diff(time) * (rate[1:] + rate[:-1]) / 2)])


def _holed(blocks: BlockSurvey) -> np.ndarray:
    """Return the blocks that last longer than their samples: their means belong to no single instant."""
    if blocks.interval is None:
        return np.zeros(blocks.size, dtype=bool)
    return blocks.last["time_s"] - blocks.first["time_s"] > (blocks.count + 1.0) * blocks.interval


def _smoothed(values: np.ndarray, blocks: BlockSurvey) -> np.ndarray:
    """Return running medians of a column whose rows are short against its levels."""
    if blocks.interval is None or WIDTH * blocks.interval * np.median(blocks.count) > 1.2 * SMOOTHED_SECONDS:
        return values
    return running_median(values)


def _angle_noise(angle: np.ndarray, turning: np.ndarray) -> float:
    """Return the noise of an angle column at rest, deg."""
    still = angle[~turning]
    return column_noise(still - running_median(still)) if len(still) else 0.0


def _trimmed(loose: np.ndarray, first: int, last: int) -> tuple[int, int]:
    """Return the range without blocks at its ends in which the stimulus varies."""
    fine = np.flatnonzero(~loose[first:last])
    return (first + int(fine[0]), first + int(fine[-1]) + 1) if len(fine) else (first, first)


def _after(blocks: BlockSurvey, first: int, steady: int, settling: float) -> int:
    """Return the first block of a level after its transient, and after the settling time that the campaign states."""
    if blocks.interval is None or not settling:
        return first + steady
    passed = np.cumsum(blocks.count[first:]) * blocks.interval
    return first + max(steady, int(np.searchsorted(passed, settling, side="left")) + 1)


def _rows(blocks: BlockSurvey, first: int, last: int) -> int:
    return int(np.sum(blocks.count[first:last]))


def _mean_of(values: np.ndarray) -> float:
    """Return the median of the second half of a level."""
    late = values[len(values) // 2 :]
    late = late[np.isfinite(late)]
    return float(np.median(late)) if len(late) else np.nan


def stretches_between(detected: Detected, blocks: BlockSurvey) -> list[tuple[int, int]]:
    """Return the rows between the spans of a log: the first of each stretch, and the one after its last."""
    edges = [(span.start, span.stop) for span in detected.spans]
    rows = int(blocks.start[-1] + blocks.count[-1])
    starts, stops = [0, *(stop for _, stop in edges)], [*(start for start, _ in edges), rows]
    return [(start, stop) for start, stop in zip(starts, stops, strict=True) if stop > start]


def followed_spans(blocks: BlockSurvey) -> list[Span]:
    """Return contiguous spans of at most `FOLLOW_SECONDS` and `FOLLOW_DEGREES`, for a varying stimulus."""
    rate, _, noise = _rate(blocks)
    turning = np.abs(rate) > np.maximum(REST_RATE, NOISE_FACTOR * noise)
    seconds = np.where(np.isfinite(rate), blocks.count * (blocks.interval or 0.0), np.inf)
    degrees = np.abs(np.nan_to_num(rate)) * seconds
    spans, begin, lasted, swept = [], 0, 0.0, 0.0
    for place in range(blocks.size):
        full = lasted + seconds[place] > FOLLOW_SECONDS or swept + degrees[place] > FOLLOW_DEGREES
        if place > begin and (full or turning[place] != turning[begin]):
            spans.append(_span(blocks, begin, place, turning))
            begin, lasted, swept = place, 0.0, 0.0
        lasted, swept = lasted + seconds[place], swept + degrees[place]
    return [*spans, _span(blocks, begin, blocks.size, turning)] if blocks.size else []


def block_spans(blocks: BlockSurvey) -> tuple[list[Span], float]:
    """Return spans at rest of equal duration, none across a longer gap, and that duration in s.

    There are no transients in a record at rest: what settles is drift, which the model has to describe.
    """
    time = blocks.first["time_s"]
    seconds = max(RECORD_SECONDS, float(time[-1] - time[0]) / RECORD_ROWS)
    turning = np.zeros(blocks.size, dtype=bool)
    spans = []
    for rest in constant_spans(blocks, (), rest_only=True).spans:
        first, stop = (int(place) for place in np.searchsorted(blocks.start, [rest.start, rest.stop]))
        number = np.floor((time[first:stop] - time[0]) / seconds)
        edges = [0, *(np.flatnonzero(np.diff(number)) + 1).tolist(), stop - first]
        spans += [_span(blocks, first + a, first + b, turning) for a, b in pairwise(edges)]
    return spans, seconds


def _span(blocks: BlockSurvey, begin: int, end: int, turning: np.ndarray) -> Span:
    return Span(int(blocks.start[begin]), int(blocks.start[end - 1] + blocks.count[end - 1]), bool(turning[begin]))


def wrap_degrees(angle: np.ndarray) -> np.ndarray:
    """Return an angle in deg wrapped to [-180, 180)."""
    return (angle + 180.0) % 360.0 - 180.0


def table_rates(blocks: BlockSurvey) -> np.ndarray:
    """Return the rate of the table in each block, deg/s, shape (B,): of its angle, which no command precedes."""
    if "table_angle_deg" in blocks.mean and np.median(blocks.count) > 1:
        return np.where(_holed(blocks), np.nan, _rate_of_angle(blocks)[0])
    return _rate(blocks)[0]


def typical_level(blocks: BlockSurvey) -> float:
    """Return how long the level of rate of a typical row lasts, s."""
    _, _, label, _ = _levels(blocks, BenchSettings())
    return _typical_rows(blocks, label) * (blocks.interval or 0.0)


def _typical_rows(blocks: BlockSurvey, label: np.ndarray) -> int:
    """Return the number of rows of the level of a typical row."""
    rows = np.sort(np.bincount(label, blocks.count))
    return int(rows[np.searchsorted(np.cumsum(rows), 0.5 * rows.sum())])


def _rate(blocks: BlockSurvey) -> tuple[np.ndarray, np.ndarray, float]:
    """Return per block the rate and its range within the block, deg/s, and the noise of the block means."""
    still = np.zeros(blocks.size)
    if "table_rate_deg_s" in blocks.mean:
        within = blocks.high["table_rate_deg_s"] - blocks.low["table_rate_deg_s"]
        rate = blocks.mean["table_rate_deg_s"]
        return rate, within, column_noise(rate)
    if "table_angle_deg" not in blocks.mean or blocks.interval is None or np.max(blocks.count) == 1:
        return still, still, 0.0
    rate, lasted = _rate_of_angle(blocks)
    return rate, still, max(column_noise(rate), ANGLE_STEADY / float(np.median(lasted[lasted > 0])))


def _rate_of_encoder(blocks: BlockSurvey, reading: float) -> tuple[np.ndarray, np.ndarray, float]:
    """Return the same by the angle alone, whose readings have a standard deviation of `reading`, deg."""
    rate, lasted = _rate_of_angle(blocks)
    usual = float(np.median(lasted[lasted > 0]))
    # A block that swings has a larger range than its ends are apart; across a turn of the encoder it shows none.
    swing = blocks.high["table_angle_deg"] - blocks.low["table_angle_deg"] - np.abs(rate) * lasted
    within = np.where(swing < 180.0, np.maximum(swing - NOISE_FACTOR * reading, 0.0), 0.0) / usual
    return rate, within, math.sqrt(2.0) * max(reading, LEAST_READING) / usual


def _rate_of_angle(blocks: BlockSurvey) -> tuple[np.ndarray, np.ndarray]:
    """Return per block the rate between its first and last angle, deg/s, and the time between them, s."""
    swept = wrap_degrees(blocks.last["table_angle_deg"] - blocks.first["table_angle_deg"])
    lasted = blocks.last["time_s"] - blocks.first["time_s"]
    return np.where(lasted > 0, swept / np.where(lasted > 0, lasted, 1.0), 0.0), lasted


def _settled_bins(
    blocks: BlockSurvey, channels: Sequence[str], first: int, last: int, swept: np.ndarray
) -> list[tuple[int, int]]:
    """Return the bins of a level, without the transients at its two ends.

    A channel that depends on temperature differs from its median over most of a ramp; the settling is therefore judged
    within the first and the last bin only.
    """

    def steady(begin: int, end: int) -> tuple[int, int]:
        outputs = [blocks.mean[name][begin:end] for name in channels]
        part = steady_part(outputs, int(np.median(blocks.count)), swept[begin:end], [np.nan] * len(outputs))
        return begin + part.first, begin + part.last

    bins = _bins(blocks, first, last)
    bins[0] = (steady(*bins[0])[0], bins[0][1])
    bins[-1] = (bins[-1][0], max(steady(*bins[-1])[1], bins[-1][0]))
    return [(begin, end) for begin, end in bins if end > begin]


def _bins(blocks: BlockSurvey, first: int, last: int) -> list[tuple[int, int]]:
    names = [name for name in TEMPERATURE_COLUMNS if name in blocks.mean]
    temperatures = [_smooth(blocks.mean[name][first:last]) for name in names]
    time = blocks.mean["time_s"][first:last] if "time_s" in blocks.mean else np.zeros(last - first)
    edges, begin = [0], 0
    for index in range(1, last - first):
        moved = max((abs(t[index] - t[begin]) for t in temperatures), default=0.0)
        if moved > BIN_KELVIN or time[index] - time[begin] > BIN_SECONDS:
            edges.append(index)
            begin = index
    edges.append(last - first)
    return [(first + a, first + b) for a, b in pairwise(edges)]


def _smooth(values: np.ndarray) -> np.ndarray:
    """Return moving averages over up to `SMOOTHING_BLOCKS`, so that sensor noise does not end a bin."""
    present = np.isfinite(values)
    if not present.any():
        return np.zeros_like(values)
    filled = np.interp(np.arange(len(values)), np.flatnonzero(present), values[present])
    width = min(SMOOTHING_BLOCKS, max(1, len(values) // 10) | 1)
    padded = np.pad(filled, width // 2, mode="edge")
    return np.convolve(padded, np.full(width, 1 / width), mode="valid")


def _least_rows(blocks: BlockSurvey, label: np.ndarray) -> int:
    """Return the least number of rows of a level.

    A level lasts `LEAST_SECONDS`.  In a log of slower rows every row in motion is at a level of its own; if levels
    usually have several rows, those of hardly any are motion.
    """
    if blocks.interval is None:
        return 1
    if blocks.interval < LEAST_SECONDS:
        return int(np.ceil(LEAST_SECONDS / blocks.interval))
    typical = _typical_rows(blocks, label)
    return 1 if typical < LONG_LEVEL_ROWS else max(2, int(np.ceil(LEAST_SHARE * typical)))
