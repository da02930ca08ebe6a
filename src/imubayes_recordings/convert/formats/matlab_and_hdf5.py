"""MATLAB files of versions 5 to 7.2, by SciPy; HDF5 files, and MATLAB files of version 7.3, which are HDF5."""

import struct
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import scipy  # loads its parts when they are first used

from imubayes.foundations.errors import input_error
from imubayes_recordings.convert.formats.arrays import ArrayRecording
from imubayes_recordings.convert.recording import refuse_expansion

MATLAB_MAGIC = b"MATLAB 5.0 MAT-file"
HDF_MAGIC = b"\x89HDF\r\n\x1a\n"
_MAT_HEADER, _MAT_TAG, _MAT_COMPRESSED = 128, 8, 15
_HIDDEN = "#"  # MATLAB keeps the contents of cells and references under #refs#


def read_matlab(file: Path) -> ArrayRecording:
    """Return the numeric arrays of a MATLAB file; fields of structures and timeseries are named by their path."""
    refuse_expansion(file, _loaded_bytes(file))
    content = scipy.io.loadmat(str(file), squeeze_me=True, struct_as_record=False, appendmat=False)
    return ArrayRecording(file, dict(_arrays(content)))


def _loaded_bytes(file: Path) -> int:
    """Return the bytes that the compressed elements of a MATLAB file say they expand to (MAT-File Format, level 5)."""
    total, size = 0, file.stat().st_size
    with file.open("rb") as stream:
        order = "<" if stream.read(_MAT_HEADER)[-2:] == b"IM" else ">"
        while len(tag := stream.read(_MAT_TAG)) == _MAT_TAG:
            kind, length = struct.unpack(f"{order}II", tag)
            if kind != _MAT_COMPRESSED:
                break
            start = stream.tell()
            inside = zlib.decompressobj().decompress(stream.read(min(length, _MAT_HEADER)), _MAT_TAG)
            total += struct.unpack(f"{order}II", inside)[1] if len(inside) == _MAT_TAG else 0
            stream.seek(min(start + length, size))
    return total


def _arrays(content: Mapping[str, Any], path: str = "") -> Iterator[tuple[str, np.ndarray]]:
    for name, value in content.items():
        if name.startswith("__"):
            continue
        if hasattr(value, "_fieldnames"):
            yield from _arrays({field: getattr(value, field) for field in value._fieldnames}, f"{path}{name}.")
        elif isinstance(value, np.ndarray):
            yield f"{path}{name}", value


def read_hdf5(file: Path) -> ArrayRecording:
    """Return the datasets of a file, named by their path; they are read block by block."""
    content = h5py.File(file, "r", locking=False)
    datasets: dict[str, Any] = {}
    units: dict[str, str] = {}

    def visit(path: str, node: Any) -> None:
        if isinstance(node, h5py.Dataset) and not path.startswith(_HIDDEN):
            if node.external or node.is_virtual:
                raise input_error(
                    f"the dataset '{path}' takes its data from other files", str(file), "data within the file",
                    "copy them into one file, as h5repack or h5py do",
                )  # fmt: skip
            datasets[path] = node
            unit = node.attrs.get("units", node.attrs.get("unit", ""))
            units[path] = unit.decode("utf-8", "replace") if isinstance(unit, bytes) else str(unit)

    content.visititems(visit)
    refuse_expansion(file, sum(each.size * each.dtype.itemsize for each in datasets.values()))
    return ArrayRecording(file, datasets, units)
