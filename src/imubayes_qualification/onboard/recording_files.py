"""Recordings to correct (a table, or a run of a campaign) and the table of corrected rows, in batches."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
import pyarrow as pa
import pyarrow.csv as pacsv
import pyarrow.parquet as pq

from imubayes import load_campaign
from imubayes.campaign.campaign_reader import raw_log
from imubayes.campaign.column_layout import layout_of_outputs
from imubayes.campaign.run_tables import RowBatch, TableSource, is_csv, read_header
from imubayes.foundations.campaign_data import Campaign, Channel, Run
from imubayes.foundations.covariates import COVARIATES
from imubayes.foundations.errors import InputError, Issue, closest_first, input_error, refuse
from imubayes.foundations.files import replacing
from imubayes.model.model_file import UncertainEquipment
from imubayes.results.result import Result
from imubayes_qualification.onboard.correct_recording import RowTally, check_stated, correction_of, not_given
from imubayes_qualification.onboard.record import UnexpressedEffect
from imubayes_qualification.onboard.response import TEMPERATURES


@dataclass(frozen=True)
class UnitRecording:
    """A recording to be corrected.

    Attributes
    ----------
    source : its rows.
    stated : temperature → value for all rows, if no column gives it, °C.
    """

    source: TableSource
    stated: dict[str, float]

    @property
    def header(self) -> tuple[str, ...]:
        """Names of the columns."""
        return self.source.layout.header

    @property
    def where(self) -> str:
        """The file."""
        return str(self.source.file)


@dataclass(frozen=True)
class CorrectedRecording:
    """Summary of a corrected recording.

    Attributes
    ----------
    kinds : kinds of channels that were solved for.
    tally : what was noticed in the rows.
    ranges : temperature → calibrated range, °C; kind of channel → range of inputs in the runs, rad/s or m/s².
    slow_noise : noise that changes within a recording and is in neither uncertainty.
    uncorrected : effects of the model that are left in, with the size that they may have.
    lacking : channels of the unit that the recording lacks.
    exact : uncertainties of site and equipment that the model takes as exact; the systematic uncertainty includes them.

    Examples
    --------
    >>> import imubayes
    >>> sorted(imubayes.CorrectedRecording.__annotations__)[:3]
    ['exact', 'kinds', 'lacking']
    """

    kinds: tuple[str, ...]
    tally: RowTally
    ranges: Mapping[str, tuple[float, float]]
    slow_noise: tuple[str, ...]
    uncorrected: tuple[UnexpressedEffect, ...]
    lacking: tuple[Channel, ...] = ()
    exact: tuple[UncertainEquipment, ...] = ()


def open_recording(
    path: Path, channels: Sequence[Channel], run: str = "", stated: Mapping[str, float] | None = None
) -> UnitRecording:
    """Return a recording: a table (CSV or Parquet), or a run of a campaign.

    Parameters
    ----------
    path : the table, or the folder of the campaign.
    channels : of the unit that was fitted.
    run : name of the run; not needed if the campaign has a single one.
    stated : temperature → value for all rows, °C; a column takes precedence.

    Raises
    ------
    InputError
        if it cannot be read, has no such run, or is of another unit.
    """
    check_stated(stated or {})
    if path.is_dir() or path.suffix == ".toml":
        return _of_campaign(load_campaign(path), path, channels, run, dict(stated or {}))
    if not path.is_file():
        raise input_error("there is no such file", str(path), "a table, or a campaign folder", "correct the path")
    layout = layout_of_outputs(read_header(path), [channel.name for channel in channels], str(path))
    return UnitRecording(TableSource(path, layout), dict(stated or {}))


def _of_campaign(
    campaign: Campaign, path: Path, channels: Sequence[Channel], name: str, stated: dict[str, float]
) -> UnitRecording:
    names = [run.name for run in campaign.runs]
    if not name and len(names) > 1:
        raise input_error("the campaign has several runs", str(path), ", ".join(names), "name one with --run")
    if name and name not in names:
        raise input_error(f"there is no run '{name}'", str(path), closest_first(name, names), "correct the name")
    _refuse_other_unit(campaign, path, channels)
    run = next(run for run in campaign.runs if not name or run.name == name)
    return UnitRecording(raw_log(campaign, run), _constant(run) | stated)


def _constant(run: Run) -> dict[str, float]:
    """Return the temperatures that hold for a whole run."""
    known = {name: np.unique(run.covariates[name]) for name in TEMPERATURES if name in run.covariates}
    return {name: float(values[0]) for name, values in known.items() if len(values) == 1}


def _refuse_other_unit(campaign: Campaign, path: Path, channels: Sequence[Channel]) -> None:
    """Raise InputError if a channel of the campaign has another nominal scale, offset or axis than in the fit."""
    own = {channel.name: channel for channel in campaign.channels}
    issues = []
    for channel in channels:
        other = own.get(channel.name)
        if other is not None and not (
            other.kind == channel.kind
            and np.allclose(other.axes, channel.axes, atol=1e-9)
            and np.isclose(other.scale_si, channel.scale_si, rtol=1e-9)
            and other.offset == channel.offset
        ):
            what, where = (
                f"channel '{channel.name}' is not the one that was fitted",
                f"{path}, [[channel]] {channel.name}",
            )
            allowed = "the kind, input_axis, scale, per and offset of the campaign that was fitted"
            issues.append(Issue(what, where, allowed, "correct the entry, or fit this campaign"))
    refuse(issues)


def correct_recording(
    result: Result, recording: UnitRecording, out: Path, tell: Callable[[str], None] = lambda text: None
) -> CorrectedRecording:
    """Write a recording with columns of corrected rate and specific force; in batches, so that any length will do.

    Parameters
    ----------
    out : the table to write, CSV or Parquet by its ending; it appears when it is complete.
    tell : called with a short text as the work goes on.

    Raises
    ------
    InputError
        if the fit did not converge, or the recording lacks channels or a temperature that the model depends on.
    """
    tell("estimating the effects that are not corrected")
    correction = correction_of(result, recording.header, recording.where)
    if missing := [name for name in correction.needs if not _given(name, recording)]:
        raise InputError(not_given(name, recording.where) for name in missing)
    tally = RowTally()
    with replacing(out) as scratch:
        writer = _TableWriter(scratch, is_csv(out))
        try:
            for batch in recording.source:
                if batch.rows:
                    writer.write(batch, correction.columns(batch, recording.stated, tally))
                    tell(f"correcting: {tally.rows} rows")
        finally:
            writer.close()
        if not tally.rows:
            raise input_error("the recording has no rows", recording.where, "a header and rows", "record it again")
    lacking = tuple(c for c in correction.posterior.campaign.channels if c.name not in recording.header)
    return CorrectedRecording(
        correction.kinds,
        tally,
        correction.ranges,
        correction.noise.slow,
        correction.left_in,
        lacking,
        correction.posterior.exact,
    )


def _given(name: str, recording: UnitRecording) -> bool:
    return name in recording.stated or COVARIATES[name].column in recording.header


class _TableWriter:
    """Writes batches to one table."""

    def __init__(self, file: Path, text: bool):
        self._file, self._text = file, text
        self._writer: pacsv.CSVWriter | pq.ParquetWriter | None = None
        self._sink: BinaryIO | None = None

    def write(self, batch: RowBatch, columns: Mapping[str, np.ndarray]) -> None:
        """Write the columns of a batch, and those that were made of it; NaN is an empty cell."""
        data = {
            **{name: pa.array(values, from_pandas=True) for name, values in batch.numbers.items()},
            **{name: pa.array(values, pa.string()) for name, values in batch.texts.items()},
            **{name: pa.array(values, from_pandas=True) for name, values in columns.items()},
        }
        table = pa.table(data)
        if self._writer is None:
            self._writer = self._opened(table)
        self._writer.write_table(table)

    def _opened(self, table: pa.Table) -> pacsv.CSVWriter | pq.ParquetWriter:
        if not self._text:
            return pq.ParquetWriter(self._file, table.schema)
        # The writer itself would put every name of the header in quotes.
        self._sink = self._file.open("wb")
        self._sink.write((",".join(map(_cell, table.column_names)) + "\n").encode())
        plain = pacsv.WriteOptions(include_header=False, quoting_style="needed")
        return pacsv.CSVWriter(self._sink, table.schema, write_options=plain)

    def close(self) -> None:
        """Finish the file."""
        for each in (self._writer, self._sink):
            if each is not None:
                each.close()


def _cell(name: str) -> str:
    """Return a column name as a cell of a CSV header."""
    doubled = name.replace('"', '""')
    return f'"{doubled}"' if set(name) & set(',"\n') else name
