"""Tables of rows: streams of CSV, Parquet and of what is in memory, and faults of a CSV table.

A `TableSource` can be read repeatedly.  Small tables are kept in memory after the first pass; large ones are read again
from the file, batch by batch.  The fast CSV parser reports only that something is wrong; line, cell and reason are then
located by a second reading.
"""

import csv
import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv as pacsv
import pyarrow.parquet as pq

from imubayes.campaign.column_layout import ColumnLayout
from imubayes.foundations.errors import InputError, Issue, input_error, refuse
from imubayes.foundations.files import not_utf8
from imubayes.foundations.units import ABSURD


@dataclass(frozen=True)
class TableInMemory:
    """The table of a run that was handed over as arrays or as a data frame; `name` is its place in messages."""

    name: str
    columns: pa.Table

    def __str__(self) -> str:
        return self.name


TableFile = Path | TableInMemory
"""Where the table of a run is read from."""


MOST = 10  # faults of one file that are listed; the rest is counted
_MOST_SHOWN = 60  # characters of a cell that are repeated


def csv_faults(file: Path, layout: ColumnLayout) -> list[Issue]:
    """Return an issue per line of wrong length and per cell that is not a number, at most `MOST` and their count."""
    issues: list[Issue] = []
    more = 0  # faults beyond the first MOST
    wanted = [(index, name) for index, name in enumerate(layout.header) if name in layout.numbers]
    dialect = csv_dialect(file)
    with file.open(encoding="utf-8-sig", newline="", errors="replace") as stream:
        reader = csv.reader(stream, delimiter=dialect.delimiter)
        try:
            next(reader, None)
            for cells in reader:
                written = [cell.replace(dialect.decimal, ".") for cell in cells]
                found = _line_faults(written, wanted, layout, f"{file}:{reader.line_num}")
                room = MOST - len(issues)
                issues += found[:room]
                more += len(found[room:])
        except csv.Error:
            issues.append(_oversized(f"{file}:{reader.line_num}"))
    if more:
        issues.append(
            Issue(
                f"{more} more cells or lines cannot be read",
                str(file),
                "numbers with a decimal point; an empty cell for a missing value",
                "correct the ones above first",
            )
        )
    return issues


def _oversized(where: str) -> Issue:
    return Issue(
        f"a cell has more than {csv.field_size_limit()} characters",
        where,
        "a number with a decimal point, or an empty cell for a missing value",
        "correct the cell; a quotation mark that is not closed makes one cell of many lines",
    )


def _line_faults(cells: list[str], wanted: list[tuple[int, str]], layout: ColumnLayout, where: str) -> list[Issue]:
    if not cells:
        return []
    if len(cells) != len(layout.header):
        return [
            Issue(
                f"the line has {len(cells)} cells where the header has {len(layout.header)}",
                where,
                f"{len(layout.header)} cells: {','.join(layout.header)}",
                "complete or remove the line; write decimals with a point",
            )
        ]
    return [
        Issue(
            f"'{_shown(cells[index])}' is not a number",
            f"{where}, column '{name}'",
            "a number with a decimal point, or an empty cell for a missing value",
            "correct the cell",
        )
        for index, name in wanted
        if not _is_number(cells[index])
    ]


def _shown(cell: str) -> str:
    return cell if len(cell) <= _MOST_SHOWN else f"{cell[:_MOST_SHOWN]}…"


def _is_number(cell: str) -> bool:
    try:
        return not cell or (float(cell) is not None and "_" not in cell)
    except ValueError:
        return False


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

    def __init__(self, file: TableFile, layout: ColumnLayout):
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


def refuse_long(file: TableFile, columns: int) -> None:
    """Raise InputError for a Parquet table that says of itself that so many of its columns do not fit in memory."""
    if isinstance(file, Path) and not is_csv(file):
        with _parquet(file) as parquet:
            refuse_too_large(file, parquet.metadata.num_rows * columns)


def refuse_too_large(file: TableFile, cells: int) -> None:
    """Raise InputError for more cells than are held in memory."""
    if cells > MOST_CELLS:
        raise input_error(
            f"the table is too large: {cells:.3g} numbers or more are to be in memory at once",
            str(file),
            f"at most {MOST_CELLS:.3g} numbers, {MOST_CELLS * 8 >> 20} MiB",
            "give fewer rows, or the raw log without a column 'samples', which is read piece by piece",
        )


def is_csv(file: TableFile) -> bool:
    """Return whether a table is text, as all files but .parquet and .pq are."""
    return isinstance(file, Path) and file.suffix.lower() not in (".parquet", ".pq")


@dataclass(frozen=True)
class CsvDialect:
    """How the cells of a text table are written: their delimiter, and the decimal sign of its numbers."""

    delimiter: str = ","
    decimal: str = "."


_SAMPLE_ROWS = 100  # by which the decimal sign is determined
_DECIMAL_COMMA = re.compile(r"[+-]?\d+,\d+(?:[eE][+-]?\d+)?")


def has_decimal_comma(cell: str) -> bool:
    """Return whether a cell is a number with a decimal comma."""
    return _DECIMAL_COMMA.fullmatch(cell.strip()) is not None


def _dialect(header: str, rows: Sequence[str] = ()) -> CsvDialect:
    """Return the dialect by the line of names and the first rows; spreadsheets with decimal commas write semicolons."""
    delimiter = next((mark for mark in ";\t|" if "," not in header and mark in header), ",")
    cells = (cell.strip().strip('"') for row in rows for cell in row.split(delimiter))
    commas = delimiter != "," and any(map(has_decimal_comma, cells))
    return CsvDialect(delimiter, "," if commas else ".")


def csv_dialect(file: Path) -> CsvDialect:
    """Return the dialect of a text table."""
    with file.open(encoding="utf-8-sig", newline="", errors="replace") as stream:
        header, *rows = [line.rstrip("\r\n") for line in islice(stream, 1 + _SAMPLE_ROWS)] or [""]
    return _dialect(header, rows)


def read_header(file: TableFile) -> tuple[str, ...]:
    """Return the column names of a table.

    Raises
    ------
    InputError
        if the file is empty, truncated or not a table.
    """
    if isinstance(file, TableInMemory):
        return tuple(file.columns.column_names)
    if not is_csv(file):
        return tuple(_parquet(file).schema_arrow.names)
    try:
        with file.open(encoding="utf-8-sig", newline="") as stream:
            line = stream.readline().rstrip("\r\n")
    except UnicodeDecodeError:
        raise InputError(not_utf8(file)) from None
    except OSError as error:
        raise _unreadable(file, str(error.strerror or error)) from None
    if not line.strip():
        raise input_error(
            "the run table is empty",
            f"{file}:1",
            "a header line with column names, then one line per row",
            "export the table again, or remove the run",
        )
    return tuple(name.strip().strip('"') for name in line.split(_dialect(line).delimiter))


def _parquet(file: Path) -> pq.ParquetFile:
    try:
        return pq.ParquetFile(file, pre_buffer=False)  # the buffer would be kept to the end of the file
    except (pa.ArrowException, OSError) as error:
        raise _damaged(file, error) from None


def _record_batches(file: TableFile, layout: ColumnLayout) -> Iterator[pa.RecordBatch]:
    columns = [*layout.numbers, *layout.texts]
    if isinstance(file, TableInMemory):
        _refuse_wrong_types(file, file.columns.schema, layout)
        yield from file.columns.select(columns).to_batches(max_chunksize=BATCH_ROWS)
        return
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
        dialect = csv_dialect(file)
        reader = pacsv.open_csv(
            file,
            read_options=pacsv.ReadOptions(
                block_size=BLOCK_BYTES, column_names=list(layout.header), skip_rows=1, use_threads=False
            ),
            parse_options=pacsv.ParseOptions(delimiter=dialect.delimiter),
            convert_options=pacsv.ConvertOptions(
                column_types=types,
                include_columns=columns,
                null_values=[""],
                strings_can_be_null=True,
                decimal_point=dialect.decimal,
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


def _refuse_wrong_types(file: TableFile, schema: pa.Schema, layout: ColumnLayout) -> None:
    types = {name: schema.field(name).type for name in layout.numbers}
    refuse(
        Issue(
            f"column '{name}' holds {kind}, not numbers",
            f"{file}, column '{name}'",
            "floating-point or integer columns",
            "write the column as numbers",
        )
        for name, kind in types.items()
        if not (pa.types.is_floating(kind) or pa.types.is_integer(kind) or pa.types.is_null(kind))
    )


def _to_batch(records: pa.RecordBatch, layout: ColumnLayout, first: int) -> RowBatch:
    numbers, not_finite = {}, {}
    for name in layout.numbers:
        column = records.column(name)
        values, known = _numbers(column)
        numbers[name] = values
        bad = ~(np.abs(values) <= ABSURD) & known
        if bad.any():
            not_finite[name] = np.flatnonzero(bad)
            values[bad] = math.nan
    texts = {name: _texts(records.column(name)) for name in layout.texts}
    return RowBatch(first, records.num_rows, numbers, texts, not_finite)


def _numbers(column: pa.Array) -> tuple[np.ndarray, np.ndarray]:
    """Return the numbers of a column, NaN where there is none, and if there is one, (rows,) each.

    Arrow's own conversion to NumPy imports pandas if that is installed, and `cast` the whole of `pyarrow.compute`:
    it is left to columns that are not doubles already.
    """
    doubles = column if column.type == pa.float64() else column.cast(pa.float64())
    valid, data = doubles.buffers()
    kept = slice(doubles.offset, doubles.offset + len(doubles))
    values = np.frombuffer(data, float, kept.stop)[kept].copy() if data is not None else np.full(len(doubles), math.nan)
    if valid is None or not doubles.null_count:
        return values, np.full(len(values), doubles.null_count == 0)
    known = np.unpackbits(np.frombuffer(valid, np.uint8), bitorder="little")[kept].astype(bool)
    values[~known] = math.nan
    return values, known


def _texts(column: pa.Array) -> list[str | None]:
    return (column if column.type == pa.string() else column.cast(pa.string())).to_pylist()


def _damaged(file: Path, error: Exception) -> InputError:
    return _unreadable(file, f"the Parquet file is damaged or truncated ({_first_line(error)})")


def _unreadable(file: Path, why: str) -> InputError:
    return input_error(
        f"the run table cannot be read: {why}",
        str(file),
        "CSV with a header line (UTF-8; commas, semicolons or tabs) or Parquet",
        "export or copy the file again",
    )


def _first_line(error: BaseException) -> str:
    return str(error).splitlines()[0][:160] if str(error) else type(error).__name__
