"""Second pass over a raw log: one mean per span, over whole turns while the table rotates.

Angle-dependent terms average out over whole turns only, and a turn ends between two samples.  The mean over turns is
therefore the trapezoidal integral over angle up to the interpolated end; for a smooth periodic signal its error is of
third order in the angle between samples, also with a few lost samples.  No integral crosses a hole in the log: of the
stretches between holes, the one with most turns is used.  The standard deviation of one sample is about the mean at
rest, from successive differences while turning, where the signal itself varies, and about a quintic between levels.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np

from imubayes.campaign.reduction.constant_spans import Span, wrap_degrees
from imubayes.campaign.run_tables import RowBatch

_LOST = 1.5  # a time step of more sampling intervals than this has lost samples
_HOLE = 20.0  # deg; lost samples over a larger angle cannot be interpolated
_SMOOTH, _LEAST_ABOUT = 6, 12  # coefficients of a quintic, and samples for the scatter about it


@dataclass(frozen=True)
class Row:
    """One reduced row.

    Attributes
    ----------
    mean : per column, NaN where all cells are empty.
    sd : per column, standard deviation of one sample, NaN where unknown.
    spread : per column, standard deviation about the mean, whatever the cause.
    samples : number of raw samples.
    turns : number of whole turns averaged, 0 at rest or over a partial turn.
    swept : angle swept, deg; 0 at rest, NaN where unknown.
    rate : mean rate from the angle column, deg/s; 0 at rest, NaN without an angle column.
    angle_known : whether the mean of the angle column is the angle of the row.
    missing : whether cells were empty.
    holes : whether turns with missing samples were left out.
    passing : whether the span lies between levels.
    """

    mean: np.ndarray
    sd: np.ndarray
    spread: np.ndarray
    samples: int
    turns: int
    swept: float
    rate: float
    angle_known: bool
    missing: bool
    holes: bool
    passing: bool

    @property
    def lost(self) -> bool:
        """Whether there is no whole turn between holes, so that the mean belongs to no angle."""
        return self.holes and not self.turns

    @property
    def state(self) -> Literal["lost", "motion", "rest", "whole turns", "partial turn"]:
        """Kind of the mean, by the motion of the table."""
        if self.lost or self.passing:
            return "lost" if self.lost else "motion"
        if self.swept == 0.0:
            return "rest"
        return "whole turns" if self.turns else "partial turn"


def accumulate(
    batches: Iterable[RowBatch], spans: Sequence[Span], columns: Sequence[str], interval: float | None
) -> list[Row]:
    """Return one row per span; the spans are in order and do not overlap."""
    sums: list[_SpanSum] = []
    for batch in batches:
        table = np.stack([batch.numbers[name] for name in columns], axis=1)
        stop = batch.first + batch.rows
        while len(sums) < len(spans) and spans[len(sums)].start < stop:
            sums.append(_SpanSum(spans[len(sums)], columns, interval))
        for total in reversed(sums):
            if total.span.stop <= batch.first:
                break
            total.add(table[max(0, total.span.start - batch.first) : total.span.stop - batch.first])
    return [total.row() for total in sums]


class _SpanSum:
    """Running sums of one span, relative to its first row for precision."""

    def __init__(self, span: Span, columns: Sequence[str], interval: float | None):
        index = {name: position for position, name in enumerate(columns)}
        self.span = span
        self._time, self._rate = index.get("time_s"), index.get("table_rate_deg_s")
        self._angle = index.get("table_angle_deg")
        self._interval = interval
        self._rows = 0
        self._last = np.zeros(0)
        self._swept = self._begun = 0.0
        self._turns = self._most = 0
        self._holes = self._dropped = False
        self._tables: list[np.ndarray] = []
        # Rows between levels are means over all samples, whatever the angle.
        self._trackable = span.turning and not span.passing and (interval is not None or self._angle is not None)

    def add(self, table: np.ndarray) -> None:
        """Add consecutive rows of the span, shape (n, columns)."""
        if not len(table):
            return
        if self._rows == 0:
            self._begin(table)
        if self._trackable:
            for part in self._without_holes(table):
                self._add(part)
        else:
            self._add(table)

    def _without_holes(self, table: np.ndarray) -> Iterable[np.ndarray]:
        """Yield the rows stretch by stretch; a new stretch begins after each hole.

        Rows with an empty cell in a column that is otherwise filled count as lost samples.
        """
        empty = np.isnan(table)
        partly = empty[:, empty.any(axis=0) & ~empty.all(axis=0)].any(axis=1)
        self._dropped |= bool(partly.any())
        table = table[~partly]
        joined = np.concatenate([self._last[None, :], table])
        by_angle = self._rate is None and self._angle is not None
        turned = np.diff(self._unwrapped(joined), prepend=self._angle_last) if by_angle else self._expected_step(joined)
        holes = np.flatnonzero(self._lost(joined) & (np.abs(turned) > _HOLE))
        for start, stop in pairwise((0, *holes.tolist(), len(table))):
            if start in holes:
                self._end_stretch()
            if stop > start:
                yield table[start:stop]

    def _lost(self, joined: np.ndarray) -> np.ndarray:
        """Return where samples are missing before a row, shape (n,); nowhere without a time column."""
        if self._time is None or self._interval is None:
            return np.zeros(len(joined) - 1, dtype=bool)
        lost = np.diff(joined[:, self._time]) > _LOST * self._interval
        lost[:1] &= self._rows > 0
        return lost

    def _end_stretch(self) -> None:
        """Keep the turns of this stretch if they are the most so far, and begin a new stretch."""
        self._holes = True
        self._bank()
        self._turns, self._swept, self._fresh = 0, 0.0, True
        self._area, self._area_weight = np.zeros_like(self._area), np.zeros_like(self._area)
        self._stretch = np.zeros_like(self._weight)

    def _bank(self) -> None:
        if self._turns > self._most:
            self._most = self._turns
            self._best = self._turn_sum, self._turn_weight, self._turn_samples

    def _add(self, table: np.ndarray) -> None:
        joined = np.concatenate([self._last[None, :], table])
        values = np.where(np.isnan(joined), 0.0, joined - self._shift)
        weight = (~np.isnan(joined)).astype(float)
        if self._angle is not None:
            values[0, self._angle] = self._angle_last
            values[1:, self._angle] = self._unwrapped(joined)
        if self._trackable:
            self._cut_turns(joined, values, weight)
        if self.span.passing:
            self._tables.append(table)
        both = weight[1:] * weight[:-1] * ~self._lost(joined)[:, None]
        step = np.where(both > 0, np.diff(values, axis=0), 0.0)
        skip = 1 if self._rows == 0 else 0
        self._step_square += (step[skip:] ** 2).sum(0)
        self._steps += both[skip:].sum(0)
        self._sum += values[1:].sum(0)
        self._square += (values[1:] ** 2).sum(0)
        self._weight += weight[1:].sum(0)
        self._rows += len(table)
        self._last = table[-1].copy()
        if self._angle is not None:
            self._angle_last = values[-1, self._angle]

    def row(self) -> Row:
        """Return the reduced row."""
        total, weight, samples = self._sum, self._weight, self._rows
        swept = self._swept * samples / max(samples - 1, 1)
        self._bank()
        if self._most:
            total, weight, counts = self._best
            samples, swept = round(float(np.max(counts))), 360.0 * self._most
        with np.errstate(divide="ignore", invalid="ignore"):
            mean = np.where(weight > 0, self._shift + total / weight, np.nan)
            about = (self._square - self._sum**2 / self._weight) / (self._weight - 1)
            plain = np.where(self._weight > 1, np.sqrt(np.maximum(about, 0.0)), np.nan)
            stepwise = np.where(self._steps > 0, np.sqrt(self._step_square / (2 * self._steps)), np.nan)
        turning = self.span.turning
        known = self._angle is not None and self._most == 0 and bool(np.isfinite(mean[self._angle]))
        unknown_sweep = turning and not self._trackable
        return Row(
            mean,
            self._about_motion() if self.span.passing else stepwise if turning else plain,
            plain,
            samples,
            self._most,
            np.nan if unknown_sweep else (swept if turning else 0.0),
            self._rate_from_angle() if turning else 0.0,
            known,
            self._dropped or bool(np.any((self._weight > 0) & (self._weight < self._rows))),
            self._holes,
            self.span.passing,
        )

    def _rate_from_angle(self) -> float:
        if self._angle is None or self._interval is None or self._rows < 2:
            return float("nan")
        return float(self._angle_last / ((self._rows - 1) * self._interval))

    def _about_motion(self) -> np.ndarray:
        """Return the standard deviation of one sample about a quintic in time; NaN where there are too few samples."""
        table = np.concatenate(self._tables)
        count = len(table)
        if count < _LEAST_ABOUT:
            return np.full(table.shape[1], np.nan)
        smooth = np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, count), _SMOOTH))[0]
        residual = table - smooth @ (smooth.T @ table)
        return np.sqrt(np.sum(residual**2, axis=0) / (count - _SMOOTH))

    def _begin(self, table: np.ndarray) -> None:
        width = table.shape[1]
        self._shift = np.where(np.isnan(table[0]), 0.0, table[0])
        self._last = table[0].copy()
        self._angle_last = 0.0
        self._sum, self._square, self._weight = np.zeros(width), np.zeros(width), np.zeros(width)
        self._step_square, self._steps = np.zeros(width), np.zeros(width)
        self._area, self._area_weight, self._stretch = np.zeros(width), np.zeros(width), np.zeros(width)
        self._fresh = True

    def _expected_step(self, joined: np.ndarray) -> np.ndarray:
        """Return the angle from each row to the next predicted by the rate column, shape (n,), deg."""
        rows = len(joined) - 1
        if self._rate is None or self._interval is None:
            return np.zeros(rows)
        seconds = np.full(rows, self._interval) if self._time is None else np.diff(joined[:, self._time])
        return np.where(np.isnan(joined[1:, self._rate]), 0.0, joined[1:, self._rate]) * seconds

    def _unwrapped(self, joined: np.ndarray) -> np.ndarray:
        """Return the unwrapped angle since the first row of the span, shape (n,), deg."""
        expected = self._expected_step(joined)
        step = expected + wrap_degrees(np.diff(joined[:, self._angle]) - expected)
        return self._angle_last + np.cumsum(np.where(np.isnan(step), 0.0, step))

    def _cut_turns(self, joined: np.ndarray, values: np.ndarray, weight: np.ndarray) -> None:
        """Update the integrals over angle, up to the last whole turn that ends within these rows."""
        if self._angle is not None and weight[:, self._angle].all():
            self._begun = values[1, self._angle] if self._fresh else self._begun
            swept = np.abs(values[1:, self._angle] - self._begun)
        else:
            step = np.abs(self._expected_step(joined))
            swept = self._swept + np.cumsum(step) - (step[0] if self._fresh else 0.0)
        self._fresh = False
        swept = np.concatenate([[self._swept], np.maximum.accumulate(np.maximum(swept, self._swept))])
        apart = np.diff(swept)[:, None] * weight[1:] * weight[:-1]
        area = 0.5 * apart * (values[1:] + values[:-1])
        turns = int(swept[-1] // 360.0)
        if turns > self._turns:
            end = 360.0 * turns
            before = min(int(np.searchsorted(swept, end, side="right")) - 1, len(swept) - 2)
            part = (end - swept[before]) / max(swept[before + 1] - swept[before], 1e-300)
            last = part * apart[before]
            self._turn_sum = self._area + area[:before].sum(0)
            self._turn_sum += last * (values[before] + 0.5 * part * (values[before + 1] - values[before]))
            self._turn_weight = self._area_weight + apart[:before].sum(0) + last
            self._turn_samples = self._stretch + weight[1 : before + 1].sum(0)
            self._turns = turns
        self._area += area.sum(0)
        self._area_weight += apart.sum(0)
        self._stretch += weight[1:].sum(0)
        self._swept = float(swept[-1])
