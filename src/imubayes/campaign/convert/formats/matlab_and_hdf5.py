"""MATLAB files of versions 5 to 7.2, by SciPy; HDF5 files, and MATLAB files of version 7.3, which are HDF5."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import scipy  # loads its parts when they are first used

from imubayes.campaign.convert.formats.arrays import ArrayRecording
from imubayes.campaign.convert.recording import damaged

MATLAB_MAGIC = b"MATLAB 5.0 MAT-file"
HDF_MAGIC = b"\x89HDF\r\n\x1a\n"
_HIDDEN = "#"  # MATLAB keeps the contents of cells and references under #refs#


def read_matlab(file: Path) -> ArrayRecording:
    """Return the numeric arrays of a MATLAB file; fields of structures and timeseries are named by their path."""
    try:
        content = scipy.io.loadmat(str(file), squeeze_me=True, struct_as_record=False, appendmat=False)
    except (OSError, ValueError, TypeError, NotImplementedError, KeyError) as error:
        raise damaged(file, "MATLAB", error) from None
    return ArrayRecording(file, dict(_arrays(content)))


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
    try:
        content = h5py.File(file, "r", locking=False)
    except OSError as error:
        raise damaged(file, "HDF5", error) from None
    datasets: dict[str, Any] = {}
    units: dict[str, str] = {}

    def visit(path: str, node: Any) -> None:
        if isinstance(node, h5py.Dataset) and not path.startswith(_HIDDEN):
            datasets[path] = node
            unit = node.attrs.get("units", node.attrs.get("unit", ""))
            units[path] = unit.decode("utf-8", "replace") if isinstance(unit, bytes) else str(unit)

    content.visititems(visit)
    return ArrayRecording(file, datasets, units)
