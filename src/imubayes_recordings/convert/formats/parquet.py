"""Parquet and Feather/Arrow tables."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from imubayes_recordings.convert.recording import BLOCK_ROWS, SourceColumn, SourceRecording, Topic

MAGIC = b"PAR1"


class ParquetRecording(SourceRecording):
    """One Parquet file: one topic, whose columns are those that hold numbers or times."""

    def __init__(self, file: Path) -> None:
        self.file = file

    def topics(self) -> tuple[Topic, ...]:
        """Return the table."""
        with self._opened() as table:
            fields = [field for field in table.schema_arrow if _readable(field.type)]
        columns = tuple(SourceColumn(field.name, _unit(field)) for field in fields)
        return (Topic("", columns, str(self.file)),)

    def blocks(self, topic: Topic, positions: Sequence[int]) -> Iterator[np.ndarray]:
        """Yield rows; a timestamp is in seconds."""
        names = [topic.columns[place].name for place in positions]
        with self._opened() as table:
            for batch in table.iter_batches(batch_size=BLOCK_ROWS, columns=list(dict.fromkeys(names))):
                yield np.stack([_numbers(batch.column(name)) for name in names], axis=1)

    def _opened(self) -> pq.ParquetFile:
        return pq.ParquetFile(self.file, pre_buffer=False)


def _readable(kind: pa.DataType) -> bool:
    return pa.types.is_floating(kind) or pa.types.is_integer(kind) or pa.types.is_temporal(kind)


def _unit(field: pa.Field) -> str:
    if pa.types.is_timestamp(field.type) or pa.types.is_duration(field.type):
        return "stamp" if field.name.startswith("__index_level_") else "s"  # an index that has no name in pandas
    stated = (field.metadata or {}).get(b"unit") or (field.metadata or {}).get(b"units") or b""
    return stated.decode("utf-8", "replace")


def _numbers(column: pa.Array) -> np.ndarray:
    """Return a column as numbers, NaN where empty; times count in seconds from the epoch."""
    kind, scale = column.type, 1.0
    if pa.types.is_timestamp(kind) or pa.types.is_duration(kind):
        scale = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}[kind.unit]
        column = column.cast(pa.int64())
    values = column.cast(pa.float64(), safe=False).fill_null(float("nan"))
    return np.asarray(values.to_numpy(zero_copy_only=False)) * scale
