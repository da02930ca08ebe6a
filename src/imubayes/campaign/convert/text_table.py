"""Plain text tables with or without a header, delimited by commas, tabs, semicolons or spaces."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from imubayes.campaign.convert.recording_options import DELIMITERS
from imubayes.errors import InputError, Issue, closest_first, input_error

_PLACE = re.compile(r"at row (\d+)")


@dataclass(frozen=True)
class TextTable:
    """Layout of a text table: column names (empty without a header), number of columns, delimiter (None: spaces)."""

    file: Path
    names: tuple[str, ...]
    width: int
    delimiter: str | None

    @property
    def has_header(self) -> bool:
        """Whether the first line is a header."""
        return bool(self.names)


def inspect_table(file: Path, delimiter: str | None) -> TextTable:
    """Return the layout of a text table, by its first line.

    Raises
    ------
    InputError
        if the file does not exist, is not text or is empty.
    """
    try:
        with file.open(encoding="utf-8-sig") as stream:
            line = stream.readline().strip()
    except FileNotFoundError:
        near = [path.name for path in file.parent.iterdir()] if file.parent.is_dir() else []
        allowed = closest_first(file.name, near)
        raise input_error(f"there is no file '{file}'", str(file), allowed, "give the path of the recording") from None
    except (OSError, UnicodeDecodeError) as error:
        what = f"the file cannot be read as text: {error}"
        raise input_error(what, str(file), "UTF-8 text", "convert it") from None
    if not line:
        raise input_error("the file is empty", str(file), "a table of numbers", "export the recording again")
    separator = DELIMITERS[delimiter] if delimiter else next((d for d in ("\t", ",", ";") if d in line), None)
    cells = [cell.strip().strip('"') for cell in line.split(separator)]
    header = any(not _is_number(cell) for cell in cells)
    return TextTable(file, tuple(cells) if header else (), len(cells), separator)


def pick_columns(table: TextTable, wanted: Mapping[str, str | int]) -> dict[str, int]:
    """Return the position (from 0) of each wanted column, given by name or by number from 1.

    Raises
    ------
    InputError
        with every column that the table does not have.
    """
    positions, issues = {}, []
    for target, source in wanted.items():
        if str(source) in table.names:
            positions[target] = table.names.index(str(source))
        elif str(source).isdigit() and 1 <= int(source) <= table.width:
            positions[target] = int(source) - 1
        else:
            allowed = closest_first(str(source), table.names) if table.names else f"1 … {table.width}"
            issues.append(
                Issue(
                    f"there is no column '{source}' for '{target}'",
                    f"{table.file}:1 (option columns)",
                    allowed,
                    f"state the column of {target}: {target}=NAME or {target}=NUMBER",
                )
            )
    if issues:
        raise InputError(issues)
    return positions


def read_numbers(table: TextTable, positions: Mapping[str, int]) -> dict[str, np.ndarray]:
    """Return the columns at some positions as numbers, (N,) each.

    Raises
    ------
    InputError
        at the first line with too few cells or a cell that is not a number.
    """
    skip = int(table.has_header)
    try:
        values = np.loadtxt(
            table.file, delimiter=table.delimiter, skiprows=skip, usecols=list(positions.values()), ndmin=2,
            encoding="utf-8-sig",
        )  # fmt: skip
    except ValueError as error:
        place = _PLACE.search(str(error))
        # NumPy counts rows from 0 where a cell is not a number, from 1 where the row is too short.
        first = 0 if "could not convert" in str(error) else 1
        line = f":{int(place[1]) + 1 - first + skip}" if place else ""
        raise input_error(
            f"the table cannot be read: {str(error).splitlines()[0]}",
            f"{table.file}{line}",
            f"{table.width} numbers per line",
            "correct the line, or choose other columns",
        ) from None
    return dict(zip(positions, values.T, strict=True))


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True
