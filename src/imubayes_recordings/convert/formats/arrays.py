"""NumPy arrays, `.npy` and `.npz`; and how arrays of any container are taken as tables."""

import math
import re
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from imubayes.foundations.errors import input_error
from imubayes_recordings.convert.recording import BLOCK_ROWS, SourceColumn, SourceRecording, Topic, refuse_expansion

MAGIC = b"\x93NUMPY"
_MOST_CHANNELS = 32  # a matrix of so many rows and more columns has one channel a row


class _Part:
    """One column of an array that supports slices: of a matrix along either axis, or a field of a structured one."""

    def __init__(self, data: Any, place: int | str, element: int = 0) -> None:
        self.data, self.place, self.element = data, place, element
        self.across = data.ndim == 2 and data.shape[0] <= _MOST_CHANNELS and data.shape[1] > data.shape[0]
        self.rows = data.shape[1] if self.across else data.shape[0]

    def read(self, block: slice) -> np.ndarray:
        if isinstance(self.place, str):
            field = np.asarray(self.data[block][self.place], dtype=np.float64)
            return field.reshape(len(field), -1)[:, self.element]
        if self.data.ndim == 1:
            return np.asarray(self.data[block], dtype=np.float64)
        part = self.data[self.place, block] if self.across else self.data[block, self.place]
        return np.asarray(part, dtype=np.float64)


class ArrayRecording(SourceRecording):
    """The named arrays of a file, as topics.

    Vectors of one group and length are the columns of one topic, and a matrix of that length beside them adds its own:
    a time beside three channels.  Any other matrix is a topic of columns without names, and a structured array one with
    names.  Groups are the parts of a name before its last point or slash.

    Parameters
    ----------
    arrays : name → array, or what has its shape and slices, such as an HDF5 dataset.
    units : name → unit that the file states.
    """

    def __init__(self, file: Path, arrays: Mapping[str, Any], units: Mapping[str, str] | None = None) -> None:
        self.file, self._units = file, units or {}
        usable = {name: value for name, value in arrays.items() if _numeric(value)}
        if not usable:
            raise input_error("the file holds no array of numbers", str(file), "vectors or matrices", "export them")
        self._tables = self._grouped(usable)

    def _grouped(self, usable: Mapping[str, Any]) -> dict[str, list[tuple[SourceColumn, _Part]]]:
        found: dict[str, list[tuple[SourceColumn, _Part]]] = {}
        alone = sorted(name for name, value in usable.items() if not _is_vector(value))
        tables = _vectors(usable)
        for (group, rows), names in tables.items():
            beside = [name for name in alone if _group(name) == group and rows in usable[name].shape]
            several = sum(own == group for own, _ in tables) > 1
            columns = [pair for name in (*names, *beside) for pair in self._columns(name, usable[name])]
            found[f"{group} of {rows} rows".strip() if several else group] = columns
            alone = [name for name in alone if name not in beside]
        return found | {name: self._alone(name, usable[name]) for name in alone}

    def _alone(self, name: str, value: Any) -> list[tuple[SourceColumn, _Part]]:
        pairs = self._columns(name, value)
        return pairs if value.dtype.names else [(SourceColumn(""), part) for _, part in pairs]

    def _columns(self, name: str, value: Any) -> list[tuple[SourceColumn, _Part]]:
        unit, short = self._units.get(name, ""), re.split(r"[./]", name)[-1]
        if value.dtype.names:
            widths = {field: math.prod(value.dtype[field].shape) for field in value.dtype.names}
            return [
                (SourceColumn(field if width == 1 else f"{field}[{place}]"), _Part(value, field, place))
                for field, width in widths.items()
                for place in range(width)
            ]
        width = 1 if value.ndim == 1 else min(value.shape)
        label = (short,) if width == 1 else tuple(f"{short}[{place}]" for place in range(width))
        return [(SourceColumn(label[place], unit), _Part(value, place)) for place in range(width)]

    def topics(self) -> tuple[Topic, ...]:
        """Return the topics."""
        return tuple(
            Topic(name, tuple(column for column, _ in pairs), f"{self.file}{f', {name}' if name else ''}")
            for name, pairs in self._tables.items()
        )

    def blocks(self, topic: Topic, positions: Sequence[int]) -> Iterator[np.ndarray]:
        """Yield rows of a topic."""
        parts = [self._tables[topic.name][place][1] for place in positions]
        for first in range(0, parts[0].rows, BLOCK_ROWS):
            yield np.stack([part.read(slice(first, first + BLOCK_ROWS)) for part in parts], axis=1)


def _vectors(usable: Mapping[str, Any]) -> dict[tuple[str, int], list[str]]:
    """Return group and length → names of the vectors."""
    found: dict[tuple[str, int], list[str]] = {}
    for name, value in usable.items():
        if _is_vector(value):
            found.setdefault((_group(name), int(np.prod(value.shape))), []).append(name)
    return found


def _is_vector(value: Any) -> bool:
    return not value.dtype.names and (value.ndim == 1 or 1 in value.shape)


def _group(name: str) -> str:
    return re.split(r"[./][^./]*$", name)[0] if re.search(r"[./]", name) else ""


def _numeric(value: Any) -> bool:
    if value.dtype.names:
        return value.ndim == 1 and all(value.dtype[name].base.kind in "iufb" for name in value.dtype.names)
    return value.dtype.kind in "iufb" and 1 <= value.ndim <= 2 and value.size > 1


def read_npy(file: Path) -> ArrayRecording:
    """Return the recording of a `.npy` file, mapped and not loaded."""
    return ArrayRecording(file, {"": np.load(file, mmap_mode="r", allow_pickle=False)})


def read_npz(file: Path) -> ArrayRecording:
    """Return the recording of a `.npz` file, whose arrays are loaded."""
    with zipfile.ZipFile(file) as archive:
        refuse_expansion(file, sum(member.file_size for member in archive.infolist()))
    with file.open("rb") as stream, np.load(stream, allow_pickle=False) as loaded:
        return ArrayRecording(file, {name: loaded[name] for name in loaded.files})
