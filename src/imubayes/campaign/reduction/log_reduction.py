"""From a raw log to rows: survey, spans, sums, and a plain account of what was done and left out."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imubayes.campaign.reduction.block_survey import BlockSurvey
from imubayes.campaign.reduction.constant_spans import (
    BIN_KELVIN,
    BIN_SECONDS,
    FOLLOW_DEGREES,
    FOLLOW_SECONDS,
    Span,
    constant_spans,
    followed_spans,
)
from imubayes.campaign.reduction.span_means import Row, accumulate
from imubayes.campaign.run_columns import ColumnLayout
from imubayes.campaign.run_tables import TableSource
from imubayes.covariates import recorded_columns

BINNED = {"thermal_ramp", "current_injection"}
"""Procedures in which the temperature is the stimulus, or runs beside it."""

AT_REST = {"dividing_head", "polar_tumble", "geographic_tumble", *BINNED}
"""Procedures whose rows are all taken at rest."""

FOLLOWED = {"reference_gyro", "rotation_modulation", "servo_table"}
"""Procedures whose stimulus never stands still."""

CONSTANT = "where the stimulus was constant"
UNSTEADY = 0.02  # of the mean; a rate table holds its rate far better


@dataclass(frozen=True)
class Rows:
    """Reduced rows in the units of the file, by column.

    Attributes
    ----------
    numbers : column → shape (R,); the columns of covariates and channels, `samples` and `<channel>_sd`.
    first : the raw row that each begins with.
    unsteady : indices of labelled segments in which the stimulus changes.
    notes : what was done and left out.
    """

    numbers: dict[str, np.ndarray]
    first: tuple[int, ...]
    unsteady: tuple[int, ...]
    notes: tuple[str, ...]


def reduce_log(
    source: TableSource, procedure: str, rows: int, blocks: BlockSurvey, labelled: Sequence[Span] | None
) -> Rows:
    """Reduce a raw log to one row per span of constant stimulus.

    Parameters
    ----------
    source : the log.
    procedure : decides whether spans are cut by temperature.
    rows : number of raw rows.
    blocks : its survey.
    labelled : spans from the `segment` column, where there is one.
    """
    layout = source.layout
    by_temperature = procedure in BINNED
    if labelled is not None:
        spans, how = list(labelled), "by the segment column"
    elif procedure in FOLLOWED:
        spans, how = followed_spans(blocks), f"of at most {FOLLOW_SECONDS:g} s and {FOLLOW_DEGREES:g} deg of turning"
    else:
        spans = constant_spans(blocks, layout.channels, by_temperature, procedure in AT_REST)
        how = f"in bins of at most {BIN_KELVIN:g} degC and {BIN_SECONDS:g} s" if by_temperature else CONSTANT
    columns = [name for name in (*recorded_columns(), *layout.channels) if layout.has(name)]
    reduced = accumulate(source, spans, columns, blocks.interval) if spans else []
    numbers = _columns(columns, layout, reduced)
    first = tuple(span.start for span in spans)
    if "time_s" not in numbers and blocks.interval is None and all(row.samples == 1 for row in reduced):
        note = f"no 'samples' and no 'time_s' column: each of the {rows} rows is taken as one sample"
        return Rows(numbers, first, (), (note,))
    unsteady = _unsteady(columns, reduced) if labelled is not None else ()
    return Rows(numbers, first, unsteady, _account(rows, reduced, how))


def _columns(columns: list[str], layout: ColumnLayout, reduced: list[Row]) -> dict[str, np.ndarray]:
    mean = np.array([row.mean for row in reduced]).reshape(len(reduced), len(columns))
    sd = np.array([row.sd for row in reduced]).reshape(len(reduced), len(columns))
    numbers = {name: mean[:, index] for index, name in enumerate(columns)}
    lost = np.array([row.lost for row in reduced], dtype=bool)
    numbers |= {name: np.where(lost, np.nan, numbers[name]) for name in layout.channels}
    numbers |= {f"{name}_sd": sd[:, columns.index(name)] for name in layout.channels}
    numbers["samples"] = np.array([float(row.samples) for row in reduced])
    known = np.array([row.angle_known for row in reduced], dtype=bool)
    still = np.array([row.swept == 0.0 for row in reduced], dtype=bool)
    if "table_angle_deg" in numbers:
        numbers["table_angle_deg"] = np.where(known, numbers["table_angle_deg"], np.nan)
    elif not still.all():
        numbers["table_angle_deg"] = np.where(still, 0.0, np.nan)
    if "table_rate_deg_s" not in numbers and not still.all():
        numbers["table_rate_deg_s"] = np.array([row.rate for row in reduced])
    numbers["table_angle_span_deg"] = np.array([row.swept for row in reduced])
    return numbers


def _unsteady(columns: list[str], reduced: list[Row]) -> tuple[int, ...]:
    watched = [columns.index(name) for name in ("table_rate_deg_s", "current_mA") if name in columns]
    return tuple(
        number
        for number, row in enumerate(reduced)
        if any(row.spread[index] > UNSTEADY * max(abs(row.mean[index]), 1e-9) for index in watched)
    )


def _account(rows: int, reduced: list[Row], how: str) -> tuple[str, ...]:
    used = sum(row.samples for row in reduced)
    lost = sum(1 for row in reduced if row.lost)
    rest = sum(1 for row in reduced if row.swept == 0.0 and not row.lost)
    whole = sum(1 for row in reduced if row.turns)
    part = len(reduced) - rest - whole - lost
    notes = [f"{rows} raw rows reduced to {len(reduced)} means {how}: {rest} at rest, {len(reduced) - rest} turning"]
    if rows > used:
        share = 100 * (rows - used) / rows
        notes.append(
            f"{rows - used} raw rows ({share:.2g} %) left out: transients between constant stimuli, "
            "settling, and what exceeds whole turns"
        )
    if whole:
        notes.append(f"means while turning cut to whole turns: {whole}")
    if any(row.holes for row in reduced):
        kept = sum(1 for row in reduced if row.holes and not row.lost)
        notes.append(
            f"samples are missing while the table turned: {kept} means are over the turns between the holes, "
            f"{lost} left out because no turn is whole"
        )
    if part:
        notes.append(f"means over less than one full turn, which keep their angle where it is known: {part}")
    if any(row.missing for row in reduced):
        notes.append("empty cells inside some means: these means are over the cells that are there")
    return tuple(notes)
