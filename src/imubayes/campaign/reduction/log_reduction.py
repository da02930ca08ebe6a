"""Reduction of a raw log to rows, with notes on what was averaged and what was left out.

Spans come from the `segment` column or from other label columns if there are any: consecutive rows with the same
label form a span, and rows with an empty label are left out.  Means that a clipped channel spoils are left out, because
a sample at the limit says only that the input was beyond.
"""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from imubayes.campaign.column_layout import ColumnLayout
from imubayes.campaign.equipment import BenchSettings
from imubayes.campaign.reduction.coarse_thermometer import CoarseTemperature, coarse_temperatures
from imubayes.campaign.reduction.constant_spans import (
    BIN_KELVIN,
    BIN_SECONDS,
    FOLLOW_DEGREES,
    FOLLOW_SECONDS,
    REST_RATE,
    Detected,
    Dropped,
    Span,
    UnsettledLevel,
    block_spans,
    constant_spans,
    followed_spans,
    stretches_between,
)
from imubayes.campaign.reduction.encoder_path import EncoderWindows, encoder_log, moving_windows, reading_noise
from imubayes.campaign.reduction.log_survey import BlockSurvey
from imubayes.campaign.reduction.span_means import Row, accumulate
from imubayes.campaign.run_tables import RowBatch, TableSource
from imubayes.foundations.campaign_data import Channel
from imubayes.foundations.covariates import HIGHER_DERIVATIVES, recorded_columns
from imubayes.foundations.wording import counted
from imubayes.procedures import Reduction

Limits = Mapping[str, tuple[float, ...]]
"""Channel → values at which it is clipped."""


def clipped_spans(batches: Iterable[RowBatch], spans: Sequence[Span], limits: Limits) -> dict[str, np.ndarray]:
    """Return for each clipped channel which spans hold samples at its limit, shape (len(spans),) bool."""
    found = {name: np.zeros(len(spans), dtype=bool) for name in limits}
    starts, stops = (np.array([getattr(span, end) for span in spans], dtype=int) for end in ("start", "stop"))
    for batch in batches:
        for name, values in limits.items():
            rows = batch.first + np.flatnonzero(np.isin(batch.numbers[name], values))
            place = np.searchsorted(starts, rows, side="right") - 1
            inside = (place >= 0) & (rows < stops[place])
            found[name][place[inside]] = True
    return {name: clipped for name, clipped in found.items() if clipped.any()}


def clipped_samples(readings: np.ndarray, channels: Sequence[Channel], limits: Limits) -> np.ndarray:
    """Return which samples are at a limit of their channel, readings (N, C) → (N, C) bool."""
    return np.stack([np.isin(readings[:, i], limits.get(each.name, ())) for i, each in enumerate(channels)], axis=1)


def clipping_note(channel: str, limits: Sequence[float], left_out: int, of: int, noun: str) -> str:
    """Return a sentence on what was left out because a channel was clipped."""
    at = " and ".join(f"{value:g}" for value in limits)
    return f"'{channel}' is clipped at {at}: {left_out} of {of} {noun} left out"


CONSTANT = "where the stimulus was constant"
UNSTEADY = 0.02  # relative standard deviation; a rate table is far more stable


@dataclass(frozen=True)
class Rows:
    """Reduced rows in the units of the file, by column.

    Attributes
    ----------
    numbers : column → shape (R,); the columns of covariates and channels, `samples` and `<channel>_sd`.
    first : index of the first raw row of each.
    unsteady : indices of labelled segments in which the stimulus varies.
    notes : account of the reduction.
    unsettled : levels of the stimulus left out because an output never became steady.
    """

    numbers: dict[str, np.ndarray]
    first: tuple[int, ...]
    unsteady: tuple[int, ...]
    notes: tuple[str, ...]
    unsettled: tuple[UnsettledLevel, ...] = ()


def reduce_log(
    source: TableSource,
    reduction: Reduction,
    rows: int,
    blocks: BlockSurvey,
    labelled: Sequence[Span] | None,
    limits: Limits | None = None,
    bench: BenchSettings | None = None,
    transitions: bool = False,
) -> Rows:
    """Reduce a raw log to one row per span of constant stimulus.

    Parameters
    ----------
    source : the log.
    reduction : how the procedure wants its logs reduced.
    rows : number of raw rows.
    blocks : its survey.
    labelled : spans from the `segment` column, if there is one.
    limits : channel → values at which it is clipped; means that hold such samples are left out.
    bench : settings of the table.
    transitions : whether what lies between spans of constant stimulus is used as well, in windows that follow the angle
        of the table.
    """
    layout, coarse = source.layout, coarse_temperatures(blocks)
    blocks = _with_temperatures(blocks, coarse)
    windows, missed = None, 0
    if transitions:
        detected, windows = _followed(source, blocks, bench or BenchSettings())
        how, missed = f"{CONSTANT}, and between", windows.lost
    else:
        detected, how = _spans_of(source, reduction, blocks, labelled, bench)
    spans = detected.spans
    columns = [name for name in (*recorded_columns(), *layout.channels) if layout.has(name)]
    reduced = accumulate(source, spans, columns, blocks.interval) if spans else []
    numbers = _columns(columns, layout, reduced)
    if windows is not None:
        numbers |= _motion_columns(numbers, windows, _values(reduced, "passing").astype(bool))
    numbers |= _span_temperatures(blocks, spans, coarse)
    first = tuple(span.start for span in spans)
    if "time_s" not in numbers and blocks.interval is None and all(row.samples == 1 for row in reduced):
        note = f"no 'samples' and no 'time_s' column: each of the {rows} rows counts as one sample"
        return Rows(numbers, first, (), (note,))
    unsteady = _unsteady(columns, reduced) if labelled is not None else ()
    lost = _leave_out_clipped(numbers, source, spans, limits or {})
    return Rows(
        numbers,
        first,
        unsteady,
        (*_account(rows, reduced, how, spans, detected.dropped, missed), *lost, *_between_steps(coarse)),
        tuple(detected.dropped.levels),
    )


def _followed(source: TableSource, blocks: BlockSurvey, bench: BenchSettings) -> tuple[Detected, EncoderWindows]:
    """Return the spans of a log whose motion is used as well, and the windows among them."""
    log = encoder_log(source)
    settings = replace(bench, reading_noise=reading_noise(log))
    levels = constant_spans(blocks, source.layout.channels, bench=settings)
    windows = moving_windows(log, stretches_between(levels, blocks))
    spans = sorted([*levels.spans, *windows.spans()], key=lambda span: span.start)
    return Detected(spans, Dropped(levels=levels.dropped.levels)), windows


def _with_temperatures(blocks: BlockSurvey, coarse: Mapping[str, CoarseTemperature]) -> BlockSurvey:
    """Return the survey with the temperatures between the steps of coarse thermometers."""
    return replace(blocks, mean=blocks.mean | {name: each.values for name, each in coarse.items()})


def _span_temperatures(
    blocks: BlockSurvey, spans: Sequence[Span], coarse: Mapping[str, CoarseTemperature]
) -> dict[str, np.ndarray]:
    """Return column → means over spans, (S,), of the temperatures of coarse thermometers."""
    edges = [np.searchsorted(blocks.start, (span.start, span.stop)) for span in spans]
    return {
        name: np.array([np.nanmean(each.values[first : max(last, first + 1)]) for first, last in edges])
        for name, each in coarse.items()
    }


def _between_steps(coarse: Mapping[str, CoarseTemperature]) -> tuple[str, ...]:
    """Return a note on each thermometer that is coarse."""
    return tuple(
        f"'{name}' has steps of {each.step:.3g} °C: it is interpolated between the instants of its steps"
        for name, each in coarse.items()
    )


def _spans_of(
    source: TableSource,
    reduction: Reduction,
    blocks: BlockSurvey,
    labelled: Sequence[Span] | None,
    bench: BenchSettings | None,
) -> tuple[Detected, str]:
    """Return the spans to average, and how they were found."""
    if labelled is not None:
        return Detected(list(labelled)), "by the segment column"
    if reduction is Reduction.FOLLOWED:
        how = f"of at most {FOLLOW_SECONDS:g} s and {FOLLOW_DEGREES:g} deg of turning"
        return Detected(followed_spans(blocks)), how
    if reduction is Reduction.BLOCKS:
        spans, seconds = block_spans(blocks)
        return Detected(spans), f"over blocks of up to {seconds:.4g} s"
    by_temperature = reduction is Reduction.BINNED
    at_rest = by_temperature or reduction is Reduction.AT_REST
    detected = constant_spans(blocks, source.layout.channels, by_temperature, at_rest, bench)
    return detected, f"in bins of at most {BIN_KELVIN:g} degC and {BIN_SECONDS:g} s" if by_temperature else CONSTANT


def _leave_out_clipped(
    numbers: dict[str, np.ndarray], source: TableSource, spans: Sequence[Span], limits: Limits
) -> tuple[str, ...]:
    """Empty the cells of clipped means; return notes on them."""
    clipped = clipped_spans(source, spans, limits) if limits and spans else {}
    for name, rows in clipped.items():
        numbers[name] = np.where(rows, np.nan, numbers[name])
        numbers[f"{name}_sd"] = np.where(rows, np.nan, numbers[f"{name}_sd"])
    return tuple(
        clipping_note(name, limits[name], int(rows.sum()), len(rows), "means") for name, rows in clipped.items()
    )


def _columns(columns: list[str], layout: ColumnLayout, reduced: list[Row]) -> dict[str, np.ndarray]:
    shape = (len(reduced), len(columns))
    mean, sd = _values(reduced, "mean").reshape(shape), _values(reduced, "sd").reshape(shape)
    lost, known = _values(reduced, "lost").astype(bool), _values(reduced, "angle_known").astype(bool)
    swept = _values(reduced, "swept")
    still = swept == 0.0
    numbers = {name: mean[:, index] for index, name in enumerate(columns)}
    for name in layout.channels:
        numbers[name] = np.where(lost, np.nan, numbers[name])
        numbers[f"{name}_sd"] = sd[:, columns.index(name)]
    numbers["samples"] = _values(reduced, "samples").astype(float)
    if "table_angle_deg" in numbers:
        numbers["table_angle_deg"] = np.where(known, numbers["table_angle_deg"], np.nan)
    elif not still.all():
        numbers["table_angle_deg"] = np.where(still, 0.0, np.nan)
    if "table_rate_deg_s" not in numbers and not still.all():
        numbers["table_rate_deg_s"] = _values(reduced, "rate")
    numbers["table_angle_span_deg"] = swept
    return numbers


def _motion_columns(
    numbers: dict[str, np.ndarray], windows: EncoderWindows, passing: np.ndarray
) -> dict[str, np.ndarray]:
    """Return the columns of the table with what the encoder tells of the rows between levels, (R,) bool.

    A rate column may be a command, which the table follows later.
    """
    derivatives = {f"table_angle_d{order}_deg_s{order}": windows.derivatives[order] for order in HIGHER_DERIVATIVES}
    of_windows = {
        "table_angle_deg": windows.derivatives[0], "table_rate_deg_s": windows.rate,
        "table_acceleration_deg_s2": windows.derivatives[2], "table_angle_span_deg": windows.span,
        "row_s": windows.seconds, **derivatives,
    }  # fmt: skip
    found = {name: numbers.get(name, np.zeros(len(passing))).copy() for name in of_windows}
    for name, values in of_windows.items():
        found[name][passing] = values
    return found


def _values(reduced: list[Row], field: str) -> np.ndarray:
    return np.array([getattr(row, field) for row in reduced])


def _unsteady(columns: list[str], reduced: list[Row]) -> tuple[int, ...]:
    watched = [columns.index(name) for name in ("table_rate_deg_s", "current_mA") if name in columns]
    return tuple(
        number
        for number, row in enumerate(reduced)
        if any(row.spread[index] > UNSTEADY * max(abs(row.mean[index]), 1e-9) for index in watched)
    )


def _account(
    rows: int, reduced: list[Row], how: str, spans: Sequence[Span], dropped: Dropped, missed: int
) -> tuple[str, ...]:
    """Return a note on the rows kept, the means formed, and the rows left out with their causes."""
    used = sum(row.samples for row in reduced)
    count = Counter(row.state for row in reduced)
    holes = sum(row.holes for row in reduced)
    means = [f"{number} {words}" for state, words in _STATES.items() if (number := count[state])]
    # What is in no span and has no other cause is unlabelled, or between spans that follow a stimulus.
    between = rows - sum(span.rows for span in spans) - _known(dropped) - missed
    causes = {
        "while the stimulus changed": dropped.changing,
        "in motion": dropped.moving,
        "settling": dropped.settling,
        "at levels where an output did not settle": dropped.unsettled,
        "beyond whole turns": sum(span.rows for span in spans) - used,
        "in no interval": between,
        "where no smooth motion follows the angle of the table": missed,
    }
    left = ", ".join(f"{number} {cause}" for cause, number in causes.items() if number > 0)
    notes = [
        f"{used} of {rows} raw rows kept in {counted(len(reduced), 'mean')} {how} ({', '.join(means) or 'none'})"
        + (f"; left out: {left}" if left else "")
    ]
    if holes:
        notes.append(
            f"samples are missing while the table turned: {holes - count['lost']} means are over the turns between "
            f"the gaps, {count['lost']} left out for lack of a whole turn"
        )
    if any(row.missing for row in reduced):
        notes.append("some means are over incomplete rows: empty cells were ignored")
    return tuple(notes)


_STATES = {
    "rest": "at rest",
    "motion": "in motion",
    "whole turns": "over whole turns",
    "partial turn": "over less than one turn",
    "lost": "without a whole turn",
}


def _known(dropped: Dropped) -> int:
    return dropped.changing + dropped.moving + dropped.settling + dropped.unsettled


class SegmentTracker:
    """Collects labelled spans batch by batch; several columns form one combined label."""

    def __init__(self, columns: Sequence[str] = ("segment",)) -> None:
        self._columns = tuple(columns)
        self._label: tuple[str, ...] | None = None
        self._start = 0
        self._spans: list[tuple[tuple[str, ...] | None, int, int]] = []
        self._rate_sum: list[float] = []
        self._rate = 0.0
        self._rows = 0

    def push(self, batch: RowBatch) -> None:
        """Add the next batch."""
        combined = zip(*(batch.texts[name] for name in self._columns), strict=True)
        labels = [tuple(map(str, parts)) if all(parts) else None for parts in combined]
        rate = batch.numbers.get("table_rate_deg_s")
        absolute = np.zeros(batch.rows) if rate is None else np.nan_to_num(np.abs(rate))
        edges = [i for i in range(1, batch.rows) if labels[i] != labels[i - 1]]
        for begin, end in zip([0, *edges], [*edges, batch.rows], strict=True):
            if batch.first + begin == 0 or labels[begin] != self._label:
                self._close(batch.first + begin)
                self._label = labels[begin]
            self._rate = max(self._rate, float(np.max(absolute[begin:end], initial=0.0)))
        self._rows = batch.first + batch.rows

    def spans(self) -> list[Span]:
        """Return the labelled spans."""
        self._close(self._rows)
        return [
            Span(start, stop, rate > REST_RATE)
            for (label, start, stop), rate in zip(self._spans, self._rate_sum, strict=True)
            if label is not None and stop > start
        ]

    def _close(self, row: int) -> None:
        if row > self._start:
            self._spans.append((self._label, self._start, row))
            self._rate_sum.append(self._rate)
        self._start, self._rate = row, 0.0
