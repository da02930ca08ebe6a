"""How a text table is laid out: delimiter, decimal sign, line of names, line of units, first line of numbers."""

import bz2
import csv
import gzip
import lzma
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from io import TextIOWrapper
from itertools import islice
from pathlib import Path
from typing import Any

from imubayes.campaign.convert.column_names import is_unit
from imubayes.campaign.convert.formats.cell_values import CellKind, has_decimal_comma, is_number, kind_of
from imubayes.foundations.errors import input_error

DELIMITERS = {"comma": ",", "semicolon": ";", "tab": "\t", "bar": "|", "space": None}
# A sign of numpy.savetxt, MATLAB, C and others before a line that is not data.
COMMENT_SIGN = re.compile(r"\s*(#+|%+|!+|\*+|;+|//+|--+(?![\d.])) *")
_MOST_LINES = 300  # among which the first numbers are sought
_SAMPLE = 40  # lines by which the kinds of the columns are told
_MOST_TAGS = 12
_COMPRESSED: dict[bytes, Callable[..., Any]] = {b"\x1f\x8b": gzip.open, b"BZh": bz2.open, b"\xfd7zXZ": lzma.open}


@dataclass(frozen=True)
class TextLayout:
    """Layout of a text table.

    Attributes
    ----------
    delimiter : None for any number of spaces.
    decimal_comma : whether numbers have a comma for the decimal point.
    first : line of the first data, from 1.
    heading : line of the names, from 1; 0 where none stands above the numbers.
    names : of the columns; more or fewer than `kinds` where they do not fit.
    units : from a line of units below the names; empty where there is none.
    kinds : what each column holds, as many as data fields.
    tags : first words of the lines, where each line says what it holds, with the kinds of its columns.
    """

    encoding: str
    delimiter: str | None
    decimal_comma: bool
    first: int
    heading: int
    names: tuple[str, ...]
    units: tuple[str, ...]
    kinds: tuple[CellKind, ...]
    tags: dict[str, tuple[CellKind, ...]]

    def cells(self, line: str) -> list[str]:
        """Return the cells of a data line, with decimal points."""
        cells = split_cells(line, self.delimiter)
        return [cell.replace(",", ".") for cell in cells] if self.decimal_comma else cells


def open_text(file: Path, encoding: str) -> TextIOWrapper:
    """Open a text file, compressed or not."""
    with file.open("rb") as stream:
        magic = stream.read(6)
    opener = next((opener for sign, opener in _COMPRESSED.items() if magic.startswith(sign)), open)
    return opener(file, "rt", encoding=encoding, newline=None, errors="strict")


def find_layout(file: Path, delimiter: str | None) -> TextLayout:
    """Return the layout of a text table, by its first numbers and the lines above them.

    Raises
    ------
    InputError
        if the file is not text, is empty or holds no numbers.
    """
    encoding, lines = _first_lines(file)
    stated = DELIMITERS[delimiter] if delimiter else None
    for index, (first, line) in enumerate(lines):
        separator, comma = (stated, False) if delimiter else _separator(line)
        comma = comma or (separator != "," and any(map(has_decimal_comma, split_cells(line, separator))))
        point = _with_point(comma)
        following = lines[index + 1][1] if index + 1 < len(lines) else ""
        cells = point(split_cells(line, separator))
        if not _is_data(line, cells, point(split_cells(following, separator)), separator):
            continue
        sample = [point(split_cells(text, separator)) for _, text in lines[index : index + _SAMPLE]]
        tags = _tags(sample)
        # A last cell that is empty is no column only where it is empty in every line.
        width = max(len(_without_trailing(row)) for row in sample if len(row) == len(cells))
        heading, names, units = _heading(lines[:index], separator, {len(cells), width})
        width = len(cells) if len(names) == len(cells) else width
        kinds = tuple(kind_of([row[place] for row in sample if place < len(row)]) for place in range(width))
        return TextLayout(encoding, separator, comma, first, heading, names, units, kinds, tags)
    raise input_error(
        f"there is no line of numbers among the first {lines[-1][0]} lines",
        str(file),
        "numbers delimited by commas, semicolons, tabs or spaces",
        "export the recording as a table of numbers",
    )


def _with_point(comma: bool) -> Callable[[list[str]], list[str]]:
    return (lambda cells: [cell.replace(",", ".") for cell in cells]) if comma else (lambda cells: cells)


def _first_lines(file: Path) -> tuple[str, list[tuple[int, str]]]:
    """Return the encoding, and the first lines that are not blank with their numbers from 1."""
    for encoding in ("utf-8-sig", "utf-16", "cp1252"):
        try:
            with open_text(file, encoding) as stream:
                lines = [(number, line.rstrip("\r\n")) for number, line in enumerate(islice(stream, _MOST_LINES), 1)]
        except UnicodeError:
            continue
        except (OSError, EOFError, lzma.LZMAError) as error:
            raise input_error(f"the file cannot be read: {error}", str(file), "text", "copy it again") from None
        if not any(line.strip() for _, line in lines):
            raise input_error("the file is empty", str(file), "a table of numbers", "export the recording again")
        if not any("\0" in line for _, line in lines):
            return encoding, [(number, line) for number, line in lines if line.strip()]
    raise input_error("the file is no text", str(file), "text in UTF-8, UTF-16 or Windows-1252", "export it as text")


def split_cells(line: str, separator: str | None) -> list[str]:
    """Return the cells of a line, without quotes and spaces around them."""
    if '"' not in line and "'" not in line:
        parts = line.split(separator)
        return [part.strip() for part in parts] if separator else parts
    text, mark = (line, separator) if separator else (" ".join(line.split()), " ")
    try:
        cells = next(csv.reader([text], delimiter=mark, skipinitialspace=True), [])
    except csv.Error:  # a cell beyond the limit of the parser is no name, and no number
        cells = [text]
    return [cell.strip().strip("'\"").strip() for cell in cells]


def _separator(line: str) -> tuple[str | None, bool]:
    """Return the delimiter of a line, and whether commas in it are decimal signs."""
    mark = next((mark for mark in "\t;|" if mark in line.rstrip()), None)
    if mark is None and "," in line:
        words = line.split()
        if len(words) > 1 and sum(map(has_decimal_comma, words)) > len(words) / 2:
            return None, True
        return ",", False
    return mark, False


def _without_trailing(cells: Sequence[str]) -> list[str]:
    """Return the cells without empty ones at the end: a separator may end the line."""
    return list(cells[: max((place for place, cell in enumerate(cells, 1) if cell), default=0)])


def _is_data(line: str, cells: Sequence[str], following: Sequence[str], separator: str | None) -> bool:
    """Tell data from names: it holds a number, and no text in a column that holds a number in the next line."""
    sign = COMMENT_SIGN.match(line)
    if sign and sign[1] != separator:
        return False
    named = any(
        cell and not is_number(cell) and is_number(below) for cell, below in zip(cells, following, strict=False)
    )
    alone = len(cells) < len(following) and any(map(is_number, following))  # "Rate: 100" above a table
    return not named and not alone and any(map(is_number, cells))


def _heading(
    lines: Sequence[tuple[int, str]], separator: str | None, widths: set[int]
) -> tuple[int, tuple[str, ...], tuple[str, ...]]:
    """Return the last line above the numbers with as many names as data fields, and the units below it; else the last.

    A line with a comment sign has names only where they are as many as the data fields: it may say anything.
    """
    units: tuple[str, ...] = ()
    for number, line in reversed(lines):
        # Names may be delimited otherwise than numbers, but not within a cell.
        others = () if separator and separator in line else ("\t", ";", ",", None)
        for mark in dict.fromkeys((separator, *others)):
            cells = split_cells(_without_sign(line, mark), mark)
            for names in (cells, _without_trailing(cells), cells[1:] if _says_units(cells) else []):
                if len(names) not in widths:
                    continue
                if not units and all(is_unit(name) for name in names if name) and any(names):
                    units = tuple(names)
                    break
                return number, tuple(names), units
    if units:
        return lines[-1][0], units, ()
    if not lines:
        return 0, (), ()
    names = split_cells(_without_sign(lines[-1][1], separator), separator)
    return lines[-1][0], tuple(names), ()


def _says_units(cells: Sequence[str]) -> bool:
    return cells[0].rstrip(":").lower() in ("unit", "units")


def _without_sign(line: str, separator: str | None) -> str:
    """Return the line without a comment sign; a sign with a delimiter behind it is a name."""
    sign = COMMENT_SIGN.match(line)
    if sign is None or (separator and line[sign.end() :].startswith(separator)):
        return line
    return line[sign.end() :]


def _tags(sample: Sequence[Sequence[str]]) -> dict[str, tuple[CellKind, ...]]:
    """Return the first words of lines that say what they hold, with the kinds of their cells behind the word."""
    rows = [row for row in sample if len(row) > 2]
    words = [row[0] for row in rows]
    tags = dict.fromkeys(words)
    if not 2 <= len(tags) <= _MOST_TAGS or any(is_number(word) or not word[:1].isalpha() for word in words):
        return {}
    return {
        tag: tuple(
            kind_of([row[place] for row in rows if row[0] == tag and place < len(row)])
            for place in range(1, min(len(row) for row in rows if row[0] == tag))
        )
        for tag in tags
    }
