"""Windows of a raw log in which the table moves: the angle of its encoder is known at every sample.

A spline of the seventh degree is fitted to the readings of the encoder by least squares.  Its knots are two hundredths
of a second or three samples apart, so that 8 Hz is followed to 1e-5 of the rate, and wider if the motion is slow.  The
log between the levels is divided into windows, and a window is halved until a polynomial of the eighth degree follows
the spline and the rate varies less within it than around it.  What a window is worth for scale factors is its mean
rate: the mean over half a period of a sinusoid still has 64 % of the amplitude, that over a period nothing.

The mean rate of a window is the difference of the angles at its ends over its length, so that windows that follow one
another share an angle.  A window is left out if the spline misses the encoder there or shortly before by more than its
usual scatter: a step of the acceleration, after which the outputs lag in another way, or a damaged reading.  A step
that the noise of the encoder hides is not seen: the acceleration of a table is taken to be smooth.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy  # loads its parts when they are first used

from imubayes.campaign.reduction.constant_spans import Span
from imubayes.campaign.run_tables import RowBatch
from imubayes.procedures.followed_rows import NODES

_DEGREE, _KNOT_SECONDS, _KNOT_SAMPLES = 7, 0.02, 3
_WIDER, _AS_GOOD = (16, 8, 4, 2), 1.1  # distances of knots that are tried, and residual variance, over the least
_MOST_SECONDS = 0.5  # of a window
_WITHIN = 0.75  # standard deviation of the rate within a window, of that around it
_AROUND_SECONDS = 1.0  # to both sides of the middle of a window
_NOISE = 3.0  # standard deviations of a reading by which a polynomial may be off the spline
_MISSES, _MISSED = 8, 3.0  # readings whose mean squared residual is at most so many times that of a reading: by chance
# larger once in 400 independent eights
_LATE_SECONDS = 0.1  # after a step of the acceleration, until what lags has settled
_NEGLIGIBLE = 1e-5  # deg; 0.04 arcsec
_GAP = 1.5  # sampling intervals; samples are missing
_MARGIN = 40  # samples beside a stretch that the spline follows as well
_LEAST = 4 * (_DEGREE + 1)  # samples of a stretch
_DIFFERENCES = 6
DERIVATIVES = 9
# The ends and points between at which the polynomial equals the spline, over half a window; and where it is judged.  At
# the ends it has the rate of the spline as well: the mean over a lag is the difference of the rates there.
_PLACES = -np.cos(np.pi * np.arange(DERIVATIVES - 2) / (DERIVATIVES - 3))
_BETWEEN = (_PLACES[1:] + _PLACES[:-1]) / 2
_POWERS = np.arange(DERIVATIVES)
_SLOPES_AT_ENDS = np.stack([_POWERS * end ** np.maximum(_POWERS - 1.0, 0.0) for end in (-1.0, 1.0)])
_FROM_PLACES = np.linalg.inv(np.concatenate([np.vander(_PLACES, DERIVATIVES, increasing=True), _SLOPES_AT_ENDS]))
_TO_BETWEEN = np.vander(_BETWEEN, DERIVATIVES, increasing=True) @ _FROM_PLACES


@dataclass(frozen=True)
class EncoderWindows:
    """The windows of a log (W of them), in its order.

    Attributes
    ----------
    start, stop : shape (W,), rows of the log, `stop` exclusive.
    seconds : shape (W,).
    rate : shape (W,), mean, deg/s.
    derivatives : shape (9, W), of the angle in the middle, the zeroth to the eighth, deg/sⁿ.
    span : shape (W,), range of the angle, deg.
    lost : rows between levels that are in no window.
    """

    start: np.ndarray
    stop: np.ndarray
    seconds: np.ndarray
    rate: np.ndarray
    derivatives: np.ndarray
    span: np.ndarray
    lost: int = 0

    def spans(self) -> list[Span]:
        """Return the windows as spans."""
        return [
            Span(start, stop, turning=True, passing=True)
            for start, stop in zip(self.start.tolist(), self.stop.tolist(), strict=True)
        ]

    def at(self, chosen: np.ndarray) -> "EncoderWindows":
        """Return chosen windows."""
        return EncoderWindows(
            self.start[chosen], self.stop[chosen], self.seconds[chosen], self.rate[chosen],
            self.derivatives[..., chosen], self.span[chosen], self.lost,
        )  # fmt: skip

    @staticmethod
    def joined(parts: list["EncoderWindows"], lost: int) -> "EncoderWindows":
        """Return the windows of several stretches in one."""
        return EncoderWindows(
            np.concatenate([part.start for part in parts]),
            np.concatenate([part.stop for part in parts]),
            np.concatenate([part.seconds for part in parts]),
            np.concatenate([part.rate for part in parts]),
            np.concatenate([part.derivatives for part in parts], axis=-1),
            np.concatenate([part.span for part in parts]),
            lost,
        )


@dataclass(frozen=True)
class _Path:
    """The angle over a stretch of a log without gaps: its rows from `first` on.

    Attributes
    ----------
    time, residual : shape (n,), s since the first row, and reading less spline, deg.
    spline, trend : of the angle less a straight line, and the line, deg; the angle is their sum.
    variance : of a reading, from the residuals and the degrees of freedom, deg².
    """

    first: int
    time: np.ndarray
    residual: np.ndarray
    spline: "scipy.interpolate.BSpline"
    trend: np.ndarray
    variance: float

    def angle(self, time: np.ndarray) -> np.ndarray:
        """Return the angle at times, deg."""
        return self.spline(time) + np.polyval(self.trend, time)

    def rate(self) -> np.ndarray:
        """Return the rate at the samples, deg/s, shape (n,)."""
        return self.spline(self.time, 1) + self.trend[0]


def encoder_log(batches: Iterable[RowBatch]) -> np.ndarray:
    """Return the columns `time_s` and `table_angle_deg` of a log, (2, N)."""
    columns = [np.stack([batch.numbers[name] for name in ("time_s", "table_angle_deg")]) for batch in batches]
    return np.concatenate(columns, axis=1) if columns else np.zeros((2, 0))


def reading_noise(log: np.ndarray) -> float:
    """Return the standard deviation of a reading of the angle by its sixth differences, deg, which no motion enters.

    Parameters
    ----------
    log : see `encoder_log`.
    """
    reading = np.unwrap(log[1, np.isfinite(log[1])], period=360.0)
    differences = np.abs(np.diff(reading, _DIFFERENCES))
    size = math.sqrt(math.comb(2 * _DIFFERENCES, _DIFFERENCES))
    return 1.4826 * float(np.median(differences)) / size if len(differences) else 0.0


def moving_windows(log: np.ndarray, stretches: list[tuple[int, int]]) -> EncoderWindows:
    """Return the windows of the stretches of a log in which no stimulus is constant.

    Parameters
    ----------
    log : see `encoder_log`.
    stretches : first row of each, and the row after its last.
    """
    time, angle = log
    interval = float(np.median(np.diff(time))) if len(time) > 1 else math.nan
    broken = ~np.isfinite(time) | ~np.isfinite(angle)
    step = np.diff(time, prepend=math.nan)
    begins = np.flatnonzero(broken | ~((step > 0) & (step < _GAP * interval)))
    parts = [
        (start + int(broken[start]), stop)
        for first, last in stretches
        for start, stop in pairwise([first, *begins[(begins > first) & (begins < last)].tolist(), last])
    ]
    paths = [
        (_path(time, angle, begins, start, stop, interval), start, stop)
        for start, stop in parts
        if stop - start >= _LEAST
    ]
    noise = math.sqrt(float(np.median([path.variance for path, _, _ in paths]))) if paths else 0.0
    found = [_windows(path, start, stop, interval, max(noise, _NEGLIGIBLE)) for path, start, stop in paths]
    rows = sum(last - first for first, last in stretches)
    kept = sum(int(np.sum(each.stop - each.start)) for each in found)
    empty = np.zeros(0, dtype=int)
    none = EncoderWindows(empty, empty, np.zeros(0), np.zeros(0), np.zeros((DERIVATIVES, 0)), np.zeros(0))
    return EncoderWindows.joined([none, *found], rows - kept)


def _path(time: np.ndarray, angle: np.ndarray, begins: np.ndarray, start: int, stop: int, interval: float) -> _Path:
    """Return the path of the rows start … stop − 1 and of those beside them that follow without a gap."""
    before = begins[np.searchsorted(begins, start, side="right") - 1] if (begins <= start).any() else 0
    later = begins[begins >= stop]
    first, last = max(start - _MARGIN, int(before)), min(stop + _MARGIN, int(later[0]) if len(later) else len(time))
    first += not np.isfinite(angle[first])
    since, reading = time[first:last] - time[first], np.unwrap(angle[first:last], period=360.0)
    trend = np.polyfit(since, reading, 1)
    values = reading - np.polyval(trend, since)
    spacing = max(_KNOT_SECONDS, _KNOT_SAMPLES * interval)
    spline, residual, freedom = _fitted(since, values, spacing)
    allowed = _AS_GOOD * float(residual @ residual) / freedom
    for wider in _WIDER:
        other = _fitted(since, values, wider * spacing)
        if float(other[1] @ other[1]) / other[2] <= allowed:
            spline, residual, freedom = other
            break
    # Most windows have no step of the acceleration: the median is theirs.
    variance = float(np.median(residual**2)) / 0.455 * len(since) / freedom
    return _Path(first, since, residual, spline, trend, variance)


def _fitted(
    time: np.ndarray, values: np.ndarray, spacing: float
) -> tuple["scipy.interpolate.BSpline", np.ndarray, int]:
    """Return the spline with knots some s apart, what it leaves of the values, (n,), and the degrees of freedom."""
    inner = np.linspace(0.0, time[-1], max(1, int(time[-1] / spacing)) + 1)
    knots = np.concatenate([np.zeros(_DEGREE), inner, np.full(_DEGREE, time[-1])])
    spline = scipy.interpolate.make_lsq_spline(time, values, knots, k=_DEGREE)
    return spline, values - spline(time), max(1, len(time) - (len(knots) - _DEGREE - 1))


def _windows(path: _Path, start: int, stop: int, interval: float, noise: float) -> EncoderWindows:
    """Return the windows of rows start … stop − 1 of a path; `noise` is that of a reading, deg."""
    # At the very ends of a log half an interval beyond is unknown.
    start, stop = max(start, path.first + 1), min(stop, path.first + len(path.time) - 1)
    most = max(NODES, round(_MOST_SECONDS / interval))
    edges = np.linspace(start, stop, max(1, math.ceil((stop - start) / most)) + 1).astype(int)
    begin, end, found = edges[:-1], edges[1:], []
    variation = _Variation(path.rate(), round(_AROUND_SECONDS / interval), start - path.first, stop - path.first)
    missed = np.concatenate([[0], np.cumsum(_missed(path.residual, noise))])
    late = round(_LATE_SECONDS / interval)
    while len(begin):
        each, off = _described(path, begin, end)
        follows = off < max(_NOISE * noise, _NEGLIGIBLE)
        local = begin - path.first, end - path.first
        follows &= missed[local[1]] == missed[np.maximum(local[0] - late, 0)]
        fine = follows & variation.small(*local)
        halves = ~fine & (end - begin >= 2 * NODES)
        found.append(each.at((fine | (follows & ~halves)) & (end - begin >= NODES)))
        middle = (begin + end) // 2
        begin, end = np.concatenate([begin[halves], middle[halves]]), np.concatenate([middle[halves], end[halves]])
    joined = EncoderWindows.joined(found, 0)
    return joined.at(np.argsort(joined.start, kind="stable"))


def _missed(residual: np.ndarray, noise: float) -> np.ndarray:
    """Return which readings are among some that the spline misses, (n,) bool."""
    if len(residual) < _MISSES:
        return np.zeros(len(residual), dtype=bool)
    square = np.convolve(residual**2, np.full(_MISSES, 1 / _MISSES), mode="same")
    beyond = (square > _MISSED * noise**2).astype(float)
    return np.convolve(beyond, np.ones(_MISSES + 1), mode="same") > 0


class _Variation:
    """Compares the variation of the rate within windows with that around them, within the stretch."""

    def __init__(self, rate: np.ndarray, around: int, first: int, last: int):
        about = rate - rate.mean()
        self._sums = np.concatenate([[0.0], np.cumsum(about)]), np.concatenate([[0.0], np.cumsum(about**2)])
        self._around, self._first, self._last = around, first, last

    def small(self, start: np.ndarray, stop: np.ndarray) -> np.ndarray:
        """Return which windows vary less within than around them, (W,) bool."""
        middle = (start + stop) // 2
        low, high = np.maximum(middle - self._around, self._first), np.minimum(middle + self._around, self._last)
        return self._variance(start, stop) <= _WITHIN**2 * self._variance(low, high) + _NEGLIGIBLE**2

    def _variance(self, start: np.ndarray, stop: np.ndarray) -> np.ndarray:
        first, second = ((each[stop] - each[start]) / np.maximum(stop - start, 1) for each in self._sums)
        return np.maximum(second - first**2, 0.0)


def _described(path: _Path, begin: np.ndarray, end: np.ndarray) -> tuple[EncoderWindows, np.ndarray]:
    """Return windows with the polynomial through the spline, and how far it is off in between at most, deg."""
    first, last = path.time[begin - path.first], path.time[end - 1 - path.first]
    count = end - begin
    seconds = (last - first) * count / np.maximum(count - 1, 1)
    middle, half = (first + last) / 2, seconds / 2
    angle = path.angle(middle + half * _PLACES[:, None])
    slopes = half * (path.spline(middle + half * np.array([[-1.0], [1.0]]), 1) + path.trend[0])
    known = np.concatenate([angle, slopes])
    off = np.abs(path.angle(middle + half * _BETWEEN[:, None]) - _TO_BETWEEN @ known).max(axis=0)
    order = _POWERS[:, None]
    factorial = np.array([math.factorial(each) for each in range(DERIVATIVES)])[:, None]
    derivatives = _FROM_PLACES @ known * factorial / half**order
    derivatives[0] %= 360.0
    return EncoderWindows(
        begin, end, seconds, (angle[-1] - angle[0]) / seconds, derivatives, np.ptp(angle, axis=0)
    ), off
