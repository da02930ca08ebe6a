"""Plain text tables with or without names, delimited by commas, tabs, semicolons or spaces."""

import csv
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np

from imubayes.campaign.convert.recording_options import DELIMITERS
from imubayes.errors import InputError, Issue, closest_first, input_error

_PLACE = re.compile(r"at row (\d+)")
# A sign of numpy.savetxt, MATLAB, C and others before a line that is not data.
_COMMENT_SIGN = re.compile(r"\s*(#+|%+|!+|\*+|;+|//+|--+(?![\d.])) *")
_MOST_LINES = 100  # among which the first numbers are sought


@dataclass(frozen=True)
class NamesLine:
    """A line above the numbers: its number from 1, and the names in it."""

    line: int
    names: tuple[str, ...]


@dataclass(frozen=True)
class TextTable:
    """Layout of a text table.

    Attributes
    ----------
    width : number of data fields in a line.
    delimiter : None for spaces.
    first : line of the first numbers, from 1.
    heading : the names; None where no line stands above the numbers.
    """

    file: Path
    width: int
    delimiter: str | None
    first: int
    heading: NamesLine | None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the columns; none where they are not as many as the data fields."""
        return self.heading.names if self.heading and len(self.heading.names) == self.width else ()

    @property
    def where(self) -> str:
        """File and line of the heading, or of the first numbers, for errors."""
        return f"{self.file}:{self.heading.line if self.heading else self.first} (option columns)"


def inspect_table(file: Path, delimiter: str | None) -> TextTable:
    """Return the layout of a text table, by its first numbers and the lines above them.

    Raises
    ------
    InputError
        if the file does not exist, is not text, is empty or holds no numbers.
    """
    lines = _first_lines(file)
    for index, (first, line) in enumerate(lines):
        separator = DELIMITERS[delimiter] if delimiter else next((d for d in "\t;," if d in line), None)
        cells = _cells(line, separator)
        if _is_data(line, cells, _cells(lines[index + 1][1], separator) if index + 1 < len(lines) else [], separator):
            width = len(_without_trailing(cells))
            heading = _heading(lines[:index], separator, {len(cells), width})
            named = heading is not None and len(heading.names) == len(cells)
            return TextTable(file, len(cells) if named else width, separator, first, heading)
    raise input_error(
        f"there is no line of numbers among the first {lines[-1][0]} lines",
        str(file),
        "numbers with a decimal point, delimited by commas, semicolons, tabs or spaces",
        "export the recording as a table of numbers, write decimals with a point",
    )


def _first_lines(file: Path) -> list[tuple[int, str]]:
    """Return the first lines that are not blank, with their numbers from 1."""
    try:
        with file.open(encoding="utf-8-sig") as stream:
            lines = [(number, line.rstrip("\r\n")) for number, line in enumerate(islice(stream, _MOST_LINES), 1)]
    except FileNotFoundError:
        near = [path.name for path in file.parent.iterdir()] if file.parent.is_dir() else []
        allowed = closest_first(file.name, near)
        raise input_error(f"there is no file '{file}'", str(file), allowed, "give the path of the recording") from None
    except (OSError, UnicodeDecodeError) as error:
        what = f"the file cannot be read as text: {error}"
        raise input_error(what, str(file), "UTF-8 text", "convert it") from None
    if not any(line.strip() for _, line in lines):
        raise input_error("the file is empty", str(file), "a table of numbers", "export the recording again")
    return [(number, line) for number, line in lines if line.strip()]


def _cells(line: str, separator: str | None) -> list[str]:
    text, mark = (line, separator) if separator else (" ".join(line.split()), " ")
    try:
        cells = next(csv.reader([text], delimiter=mark, skipinitialspace=True), [])
    except csv.Error:  # a cell beyond the limit of the parser is no name, and no number
        cells = [text]
    return [cell.strip().strip("'\"").strip() for cell in cells]


def _without_trailing(cells: Sequence[str]) -> list[str]:
    """Return the cells without empty ones at the end: a separator may end the line."""
    return list(cells[: max((place for place, cell in enumerate(cells, 1) if cell), default=0)])


def _is_data(line: str, cells: Sequence[str], following: Sequence[str], separator: str | None) -> bool:
    """Tell data from names: it holds a number, and no text in a column that holds a number in the next line."""
    sign = _COMMENT_SIGN.match(line)
    if sign and sign[1] != separator:
        return False
    named = any(
        cell and not _is_number(cell) and _is_number(below) for cell, below in zip(cells, following, strict=False)
    )
    return not named and any(map(_is_number, cells))


def _heading(lines: Sequence[tuple[int, str]], separator: str | None, widths: set[int]) -> NamesLine | None:
    """Return the last line above the numbers with as many names as data fields; else the last of all."""
    for number, line in reversed(lines):
        for mark in dict.fromkeys((separator, "\t", ";", ",", None)):
            cells = _cells(_without_sign(line, mark), mark)
            for names in (cells, _without_trailing(cells)):
                if len(names) in widths:
                    return NamesLine(number, tuple(names))
    return NamesLine(lines[-1][0], tuple(_cells(_without_sign(lines[-1][1], separator), separator))) if lines else None


def _without_sign(line: str, separator: str | None) -> str:
    """Return the line without a comment sign; a sign with a delimiter behind it is a name."""
    sign = _COMMENT_SIGN.match(line)
    if sign is None or (separator and line[sign.end() :].startswith(separator)):
        return line
    return line[sign.end() :]


def pick_columns(table: TextTable, wanted: Mapping[str, str | int]) -> dict[str, int]:
    """Return the position (from 0) of each wanted column, given by name or by number from 1.

    Raises
    ------
    InputError
        with every column that the table does not have, or has twice.
    """
    positions, issues = {}, []
    for target, source in wanted.items():
        if table.names.count(str(source)) == 1:
            positions[target] = table.names.index(str(source))
            continue
        if str(source) not in table.names and str(source).isdigit() and 1 <= int(source) <= table.width:
            positions[target] = int(source) - 1
            continue
        twice = str(source) in table.names
        what = f"{table.names.count(str(source))} columns are named" if twice else "there is no column"
        allowed = closest_first(str(source), table.names) if table.names and not twice else f"1 … {table.width}"
        remedy = f"state the column of {target}: {target}=NAME or {target}=NUMBER"
        issues.append(Issue(f"{what} '{source}' for '{target}'", table.where, allowed, remedy))
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
    skip = table.first - 1
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
