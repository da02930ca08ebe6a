"""Where in a raw log the stimulus stood still: spans of constant rate, constant angle or rest.

A block is steady when rate, resting angle and current hold within it; steady neighbours with the same stimulus
make a span.  A commanded rate is there before the table is, so the ends of a span, where the block means of a
channel have not settled yet, are cut off as transients.  Where the temperature is the stimulus, spans are cut
into bins short enough for it to count as constant.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from imubayes.campaign.reduction.block_survey import BlockSurvey

REST_RATE = 1e-6  # deg/s; a commanded rate below it is rest
RATE_TOLERANCE = 1e-3  # of the rate: two rates closer than this are one
NOISE_RANGE = 3.0  # times the usual range of a measured rate within a block: 9 of its standard deviations
ANGLE_TOLERANCE = 0.01  # deg; positions of a dividing head lie further apart, encoder noise is smaller
CURRENT_TOLERANCE = 1e-3  # of the largest current
LEAST_SECONDS = 1.0  # shorter spans are on the way to somewhere
SETTLED = 8.0  # robust standard deviations of the block means
BIN_KELVIN = 0.25
BIN_SECONDS = 60.0
FOLLOW_SECONDS = 1.0
FOLLOW_DEGREES = 15.0
SMOOTHING_BLOCKS = 51


@dataclass(frozen=True)
class Span:
    """Rows `start` to `stop` (exclusive) during which the stimulus was constant."""

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
    """Return the spans of constant stimulus, transients cut off, in the order of the log.

    Parameters
    ----------
    blocks : summary of the log.
    channels : columns whose settling is watched.
    by_temperature : cut into bins of `BIN_KELVIN` and `BIN_SECONDS` at most.
    rest_only : turning is on the way from one position to the next, and left out.
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
            # Short bins are those of a fast ramp: it is the whole group that has to last.
            bins = _settled_bins(blocks, channels, first, last) if _long_enough(blocks, first, last) else []
        else:
            whole = _settled(blocks, channels, first, last)
            bins = [whole] if _long_enough(blocks, *whole) else []
        spans += [_span(blocks, begin, end, turning) for begin, end in bins]
    return spans


def followed_spans(blocks: BlockSurvey) -> list[Span]:
    """Return spans short enough to follow a stimulus that never stands still: `FOLLOW_SECONDS`, `FOLLOW_DEGREES`."""
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


def _span(blocks: BlockSurvey, begin: int, end: int, turning: np.ndarray) -> Span:
    return Span(int(blocks.start[begin]), int(blocks.start[end - 1] + blocks.count[end - 1]), bool(turning[begin]))


def wrap_degrees(angle: np.ndarray) -> np.ndarray:
    """Return an angle in deg brought into [-180, 180)."""
    return (angle + 180.0) % 360.0 - 180.0


def _rate(blocks: BlockSurvey) -> tuple[np.ndarray, np.ndarray, float]:
    """Return per block the rate and its range within the block (deg/s), and the usual such range."""
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
    """Return (first, one past the last) of every run of steady blocks without a jump inside."""
    label = np.concatenate([[0], np.cumsum(jump | (steady[1:] != steady[:-1]))])
    edges = np.flatnonzero(np.diff(label)) + 1
    starts, stops = np.concatenate([[0], edges]), np.concatenate([edges, [len(steady)]])
    return [(int(a), int(b)) for a, b in zip(starts, stops, strict=True) if steady[a]]


def _settled_bins(blocks: BlockSurvey, channels: tuple[str, ...], first: int, last: int) -> list[tuple[int, int]]:
    """Return the bins of a group of blocks, with what has not settled cut off its two ends.

    A channel that follows the temperature is not at its median for most of a ramp: there the first and the last bin are
    compared with themselves.
    """
    bins = _bins(blocks, first, last)
    bins[0] = (_settled(blocks, channels, *bins[0])[0], bins[0][1])
    bins[-1] = (bins[-1][0], _settled(blocks, channels, *bins[-1])[1])
    return bins


def _settled(blocks: BlockSurvey, channels: tuple[str, ...], first: int, last: int) -> tuple[int, int]:
    """Cut off leading and trailing blocks in which a channel has not settled, at most 40 % at each end."""
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
            # The median alone is 0 for a coarse converter that mostly gives one code.
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
    """Return running means over up to `SMOOTHING_BLOCKS`, so that sensor noise does not end a bin."""
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
