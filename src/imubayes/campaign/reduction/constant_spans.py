"""Detection of the spans of constant stimulus in a raw log: constant rate, constant angle or rest.

A block is steady if rate, angle at rest and current are constant within it; consecutive steady blocks of the same
stimulus form a span.  A rate command precedes the motion of the table, so the ends of a span, where the block means of
a channel have not settled yet, are removed as transients.  Where the temperature is the stimulus, spans are divided
into bins short enough for it to be constant.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from imubayes.campaign.reduction.block_survey import BlockSurvey

REST_RATE = 1e-6  # deg/s; rates below it are rest
RATE_TOLERANCE = 1e-3  # relative; rates closer than this are equal
NOISE_RANGE = 3.0  # times the median range of a measured rate within a block: about 9 standard deviations
ANGLE_TOLERANCE = 0.01  # deg; larger than encoder noise, smaller than the steps of a dividing head
CURRENT_TOLERANCE = 1e-3  # of the largest current
LEAST_SECONDS = 1.0  # shorter spans are transitions
SETTLED = 8.0  # robust standard deviations of the block means
BIN_KELVIN = 0.25
BIN_SECONDS = 60.0
FOLLOW_SECONDS = 1.0
FOLLOW_DEGREES = 15.0
SMOOTHING_BLOCKS = 51
RECORD_SECONDS = 60.0
RECORD_ROWS = 128  # of a static record, at most: enough for its drift, few enough for its covariance


@dataclass(frozen=True)
class Span:
    """Rows `start` to `stop` (exclusive) of constant stimulus; `turning` where the table rotated."""

    start: int
    stop: int
    turning: bool = False

    @property
    def rows(self) -> int:
        """Number of rows."""
        return self.stop - self.start


def constant_spans(
    blocks: BlockSurvey, channels: tuple[str, ...], by_temperature: bool = False, rest_only: bool = False
) -> list[Span]:
    """Return the spans of constant stimulus without their transients, in the order of the log.

    Parameters
    ----------
    blocks : survey of the log.
    channels : columns checked for settling.
    by_temperature : divide the spans into bins of at most `BIN_KELVIN` and `BIN_SECONDS`.
    rest_only : return spans at rest only; motion is a change of position.
    """
    rate, within, noise = _rate(blocks)
    turning = np.abs(rate) > np.maximum(REST_RATE, noise)
    tolerance = RATE_TOLERANCE * np.abs(rate) + np.maximum(REST_RATE, NOISE_RANGE * noise)
    steady = (within <= tolerance) & np.isfinite(rate)
    steady &= ~(turning & rest_only)
    jump = _jumps(rate, tolerance) | (turning[1:] != turning[:-1])
    if "table_angle_deg" in blocks.mean:
        drift = np.abs(wrap_degrees(blocks.last["table_angle_deg"] - blocks.first["table_angle_deg"]))
        steady &= turning | ~(drift > ANGLE_TOLERANCE)
        apart = np.abs(wrap_degrees(np.diff(blocks.first["table_angle_deg"])))
        jump |= ~turning[1:] & (apart > 2 * ANGLE_TOLERANCE)
    if "current_mA" in blocks.mean:
        least = CURRENT_TOLERANCE * np.nanmax(np.abs(blocks.mean["current_mA"]), initial=1e-12)
        steady &= ~(blocks.high["current_mA"] - blocks.low["current_mA"] > least)
        jump |= _jumps(blocks.mean["current_mA"], np.full(blocks.size, least))
    spans = []
    for first, last in _groups(steady, jump):
        if by_temperature:
            # A fast ramp gives short bins; the minimum duration applies to the whole group.
            bins = _settled_bins(blocks, channels, first, last) if _long_enough(blocks, first, last) else []
        else:
            whole = _settled(blocks, channels, first, last)
            bins = [whole] if _long_enough(blocks, *whole) else []
        spans += [_span(blocks, begin, end, turning) for begin, end in bins]
    return spans


def followed_spans(blocks: BlockSurvey) -> list[Span]:
    """Return contiguous spans of at most `FOLLOW_SECONDS` and `FOLLOW_DEGREES`, for a varying stimulus."""
    rate, _, noise = _rate(blocks)
    turning = np.abs(rate) > np.maximum(REST_RATE, noise)
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
    for rest in constant_spans(blocks, (), rest_only=True):
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


def _rate(blocks: BlockSurvey) -> tuple[np.ndarray, np.ndarray, float]:
    """Return per block the rate and its range within the block, deg/s, and the median of the ranges."""
    still = np.zeros(blocks.size)
    if "table_rate_deg_s" in blocks.mean:
        within = blocks.high["table_rate_deg_s"] - blocks.low["table_rate_deg_s"]
        return blocks.mean["table_rate_deg_s"], within, float(np.nanmedian(within))
    if "table_angle_deg" not in blocks.mean or blocks.interval is None or np.max(blocks.count) == 1:
        return still, still, 0.0
    swept = wrap_degrees(blocks.last["table_angle_deg"] - blocks.first["table_angle_deg"])
    lasted = blocks.last["time_s"] - blocks.first["time_s"]
    rate = np.where(lasted > 0, swept / np.where(lasted > 0, lasted, 1.0), 0.0)
    return rate, still, ANGLE_TOLERANCE / float(np.median(lasted[lasted > 0]))


def _jumps(values: np.ndarray, tolerance: np.ndarray) -> np.ndarray:
    return np.abs(np.diff(values)) > np.maximum(tolerance[1:], tolerance[:-1])


def _groups(steady: np.ndarray, jump: np.ndarray) -> list[tuple[int, int]]:
    """Return first and one past the last block of every run of steady blocks without a jump."""
    label = np.concatenate([[0], np.cumsum(jump | (steady[1:] != steady[:-1]))])
    edges = np.flatnonzero(np.diff(label)) + 1
    starts, stops = np.concatenate([[0], edges]), np.concatenate([edges, [len(steady)]])
    return [(int(a), int(b)) for a, b in zip(starts, stops, strict=True) if steady[a]]


def _settled_bins(blocks: BlockSurvey, channels: tuple[str, ...], first: int, last: int) -> list[tuple[int, int]]:
    """Return the bins of a group of blocks, without the transients at its two ends.

    A channel that depends on temperature differs from its median over most of a ramp; the settling is therefore judged
    within the first and the last bin only.
    """
    bins = _bins(blocks, first, last)
    bins[0] = (_settled(blocks, channels, *bins[0])[0], bins[0][1])
    bins[-1] = (bins[-1][0], _settled(blocks, channels, *bins[-1])[1])
    return bins


def _settled(blocks: BlockSurvey, channels: tuple[str, ...], first: int, last: int) -> tuple[int, int]:
    """Return the range without leading and trailing blocks in which a channel has not settled (at most 40 % each)."""
    length = last - first
    if length < 10 or blocks.interval is None or np.max(blocks.count) == 1:
        return first, last
    unsettled = np.zeros(length, dtype=bool)
    for channel in channels:
        values = blocks.mean[channel][first:last]
        core = values[length // 4 : length - length // 4]
        core = core[np.isfinite(core)]
        if len(core):
            middle = np.median(core)
            # The MAD alone is 0 for a coarse converter that mostly outputs one code.
            spread = max(1.4826 * float(np.median(np.abs(core - middle))), 0.5 * float(np.std(core)))
            unsettled |= np.abs(values - middle) > SETTLED * spread + 1e-9 * np.abs(middle)
    most = (2 * length) // 5
    head, tail = np.flatnonzero(unsettled[:most]), np.flatnonzero(unsettled[::-1][:most])
    return first + (int(head[-1]) + 1 if len(head) else 0), last - (int(tail[-1]) + 1 if len(tail) else 0)


def _bins(blocks: BlockSurvey, first: int, last: int) -> list[tuple[int, int]]:
    names = [n for n in ("converter_temperature_degC", "temperature_degC") if n in blocks.mean]
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


def _long_enough(blocks: BlockSurvey, first: int, last: int) -> bool:
    if last <= first:
        return False
    if blocks.interval is None or blocks.interval >= LEAST_SECONDS:
        return True
    rows = int(np.sum(blocks.count[first:last]))
    return rows * blocks.interval >= LEAST_SECONDS
