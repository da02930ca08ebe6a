"""Run tables as streams of batches: CSV and Parquet of any length in bounded memory.

A `TableSource` can be read repeatedly.  Small tables are kept in memory after the first pass; large ones are read again
from the file, batch by batch.  The fast parser reports only that something is wrong; the line and the cell are then
located by `csv_errors`.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv as pacsv
import pyarrow.parquet as pq

from imubayes.campaign.csv_errors import csv_faults
from imubayes.campaign.file_schemas import ABSURD
from imubayes.campaign.run_columns import ColumnLayout
from imubayes.errors import InputError, Issue, input_error

BATCH_ROWS = 65536
BLOCK_BYTES = 1 << 20
KEEP_ROWS = 200_000  # at most this many rows of a table stay in memory (10 columns: 16 MB)
MOST_CELLS = 1 << 26  # of a table that is in memory as a whole: 0.5 GiB


@dataclass(frozen=True)
class RowBatch:
    """Consecutive rows of a table.

    Attributes
    ----------
    first : index of the first row (0 is the first below the header).
    rows : number of rows.
    numbers : column → float64 values, NaN where the cell is empty.
    texts : column → list of str or None.
    not_finite : column → indices within the batch of cells that hold NaN, infinity or an absurd number; they are NaN
        in `numbers`.
    """

    first: int
    rows: int
    numbers: dict[str, np.ndarray]
    texts: dict[str, list[str | None]]
    not_finite: dict[str, np.ndarray]


class TableSource:
    """A run table that can be streamed repeatedly."""

    def __init__(self, file: Path, layout: ColumnLayout):
        self.file = file
        self.layout = layout
        self._kept: list[RowBatch] | None = None

    def place(self, row: int) -> str:
        """Return the place of a row for messages: file and line (CSV) or row number (Parquet)."""
        return f"{self.file}:{row + 2}" if is_csv(self.file) else f"{self.file}, row {row + 1}"

    def whole(self) -> dict[str, np.ndarray]:
        """Return all numbers, by column; raises InputError for a table that is too long to be in memory."""
        batches, cells = [], 0
        for batch in self:
            cells += batch.rows * len(batch.numbers)
            refuse_too_large(self.file, cells)
            batches.append(batch)
        return {name: np.concatenate([batch.numbers[name] for batch in batches]) for name in self.layout.numbers}

    def __iter__(self) -> Iterator[RowBatch]:
        if self._kept is not None:
            yield from self._kept
            return
        kept: list[RowBatch] | None = []
        first = 0
        for record_batch in _record_batches(self.file, self.layout):
            batch = _to_batch(record_batch, self.layout, first)
            first += batch.rows
            if kept is not None:
                kept = [*kept, batch] if first <= KEEP_ROWS else None
            yield batch
        self._kept = kept


def refuse_long(file: Path, columns: int) -> None:
    """Raise InputError for a Parquet table that says of itself that so many of its columns do not fit in memory."""
    if not is_csv(file):
        with _parquet(file) as parquet:
            refuse_too_large(file, parquet.metadata.num_rows * columns)


def refuse_too_large(file: Path, cells: int) -> None:
    """Raise InputError for more cells than are held in memory."""
    if cells > MOST_CELLS:
        raise input_error(
            f"the table is too large: {cells:.3g} numbers or more are to be in memory at once",
            str(file),
            f"at most {MOST_CELLS:.3g} numbers, {MOST_CELLS * 8 >> 20} MiB",
            "give fewer rows, or the raw log without a column 'samples', which is read piece by piece",
        )


def is_csv(file: Path) -> bool:
    """Return whether a table is text, as all files but .parquet and .pq are."""
    return file.suffix.lower() not in (".parquet", ".pq")


def read_header(file: Path) -> tuple[str, ...]:
    """Return the column names of a table.

    Raises
    ------
    InputError
        if the file is empty, truncated or not a table.
    """
    if not is_csv(file):
        return tuple(_parquet(file).schema_arrow.names)
    try:
        with file.open(encoding="utf-8-sig", newline="") as stream:
            line = stream.readline().rstrip("\r\n")
    except UnicodeDecodeError:
        raise _unreadable(file, "it is not UTF-8 text") from None
    except OSError as error:
        raise _unreadable(file, str(error.strerror or error)) from None
    if not line.strip():
        raise input_error(
            "the run table is empty",
            f"{file}:1",
            "a header line with column names, then one line per row",
            "export the table again, or remove the run",
        )
    for separator, word in ((";", "';'"), ("\t", "tabs"), ("|", "'|'")):
        if "," not in line and separator in line:
            remedy = "export the table with commas and decimal points"
            raise input_error(f"the columns are separated by {word}", f"{file}:1", "commas", remedy)
    return tuple(name.strip().strip('"') for name in line.split(","))


def _parquet(file: Path) -> pq.ParquetFile:
    try:
        return pq.ParquetFile(file, pre_buffer=False)  # the buffer would be kept to the end of the file
    except (pa.ArrowException, OSError) as error:
        raise _damaged(file, error) from None


def _record_batches(file: Path, layout: ColumnLayout) -> Iterator[pa.RecordBatch]:
    columns = [*layout.numbers, *layout.texts]
    if is_csv(file):
        yield from _csv_batches(file, layout, columns)
        return
    with _parquet(file) as parquet:
        _refuse_wrong_types(file, parquet.schema_arrow, layout)
        try:
            yield from parquet.iter_batches(batch_size=BATCH_ROWS, columns=columns)
        except (pa.ArrowException, OSError) as error:
            raise _damaged(file, error) from None


def _csv_batches(file: Path, layout: ColumnLayout, columns: list[str]) -> Iterator[pa.RecordBatch]:
    types = {name: pa.float64() for name in layout.numbers} | {name: pa.string() for name in layout.texts}
    try:
        reader = pacsv.open_csv(
            file,
            read_options=pacsv.ReadOptions(
                block_size=BLOCK_BYTES, column_names=list(layout.header), skip_rows=1, use_threads=False
            ),
            convert_options=pacsv.ConvertOptions(
                column_types=types, include_columns=columns, null_values=[""], strings_can_be_null=True
            ),
        )
        with reader:
            yield from reader
    except OSError as error:
        raise _unreadable(file, str(error.strerror or error)) from None
    except pa.ArrowInvalid as error:
        if "Empty CSV" in str(error):
            return
        if faults := csv_faults(file, layout):
            raise InputError(faults) from None
        raise _unreadable(file, _first_line(error)) from None


def _refuse_wrong_types(file: Path, schema: pa.Schema, layout: ColumnLayout) -> None:
    types = {name: schema.field(name).type for name in layout.numbers}
    issues = [
        Issue(
            f"column '{name}' holds {kind}, not numbers",
            f"{file}, column '{name}'",
            "floating-point or integer columns",
            "write the column as numbers",
        )
        for name, kind in types.items()
        if not (pa.types.is_floating(kind) or pa.types.is_integer(kind) or pa.types.is_null(kind))
    ]
    if issues:
        raise InputError(issues)


# Arrow's own conversions of Python numbers, and to NumPy, import pandas where that is installed.
_NAN = pa.Array.from_buffers(pa.float64(), 1, [None, pa.py_buffer(np.array([math.nan]))])[0]


def _to_batch(records: pa.RecordBatch, layout: ColumnLayout, first: int) -> RowBatch:
    numbers, not_finite = {}, {}
    for name in layout.numbers:
        column = records.column(name)
        values = np.array(np.from_dlpack(column.cast(pa.float64()).fill_null(_NAN)))
        numbers[name] = values
        bad = ~(np.abs(values) <= ABSURD)
        if column.null_count:
            bad &= np.array(column.is_valid().to_pylist())
        if bad.any():
            not_finite[name] = np.flatnonzero(bad)
            values[bad] = math.nan
    texts = {name: records.column(name).cast(pa.string()).to_pylist() for name in layout.texts}
    return RowBatch(first, records.num_rows, numbers, texts, not_finite)


def _damaged(file: Path, error: Exception) -> InputError:
    return _unreadable(file, f"the Parquet file is damaged or truncated ({_first_line(error)})")


def _unreadable(file: Path, why: str) -> InputError:
    return input_error(
        f"the run table cannot be read: {why}",
        str(file),
        "CSV with a header line (UTF-8, commas) or Parquet",
        "export or copy the file again",
    )


def _first_line(error: BaseException) -> str:
    return str(error).splitlines()[0][:160] if str(error) else type(error).__name__
