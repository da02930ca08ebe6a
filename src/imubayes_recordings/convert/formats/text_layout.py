"""How a text table is laid out: delimiter, decimal sign, line of names, line of units, first line of numbers."""

import bz2
import csv
import gzip
import lzma
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from io import TextIOWrapper
from itertools import islice
from pathlib import Path
from typing import Any

from imubayes.campaign.run_tables import has_decimal_comma
from imubayes.foundations.errors import InputError, input_error
from imubayes_recordings.convert.column_names import is_unit, role_of
from imubayes_recordings.convert.formats.cell_values import CellKind, is_number, kind_of
from imubayes_recordings.convert.formats.line_tags import FEW, LineTags, find_tags
from imubayes_recordings.convert.formats.stated_rate import StatedRate, stated_rate

DELIMITERS = {"comma": ",", "semicolon": ";", "tab": "\t", "bar": "|", "space": None}
# A sign of numpy.savetxt, MATLAB, C and others before a line that is not data.
COMMENT_SIGN = re.compile(r"\s*(#+|%+|!+|\*+|;+|//+|--+(?![\d.])) *")
_MOST_LINES = 300  # among which the first numbers are sought
_SAMPLE = 40  # lines by which the kinds of the columns are known
_LABELLED = 0.8  # share of the lines with the same labels
_NUMBER = re.compile(r"(?<![\w.])[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?(?![\w.])")
_PADDING = re.compile(rb"(?:\A|(?<=[\r\n]))\0+|\0+(?=[\r\n]|\Z)")
_CONTROL = re.compile(rb"[\x00-\x08\x0e-\x1f]")
_REMARKS = ("comment", "comments", "remark", "remarks")
_COMPRESSED: dict[bytes, Callable[..., Any]] = {b"\x1f\x8b": gzip.open, b"BZh": bz2.open, b"\xfd7zXZ": lzma.open}


@dataclass(frozen=True)
class TextLayout:
    """Layout of a text table.

    Attributes
    ----------
    delimiter : None for any number of spaces.
    decimal_comma : whether numbers have a comma for the decimal point.
    first : line of the first data, from 1.
    heading : line of the names, from 1; 0 if none stands above the numbers.
    names : of the columns; more or fewer than `kinds` if they do not fit.
    units : from a line of units below the names; empty if there is none.
    kinds : what each column holds, as many as data fields.
    head : the line of the names, which may come again.
    labels : what stands between the numbers, if each line names its numbers: `AX: 0.12 AY: 9.7`, JSON.
    tags : the words that say what each line holds; None if lines do not say it.
    label_columns : columns that hold the same word in every line.
    rate : the sampling rate that the lines above the table state; None if they state none.
    """

    encoding: str
    delimiter: str | None
    decimal_comma: bool
    first: int
    heading: int
    names: tuple[str, ...]
    units: tuple[str, ...]
    kinds: tuple[CellKind, ...]
    tags: LineTags | None = None
    head: str = ""
    labels: tuple[str, ...] = ()
    label_columns: frozenset[int] = frozenset()
    rate: StatedRate | None = None

    def cells(self, line: str) -> list[str]:
        """Return the cells of a data line, with decimal points."""
        if self.labels:
            return _NUMBER.findall(line) if _between(line) == self.labels else []
        cells = split_cells(line, self.delimiter)
        return [cell.replace(",", ".") for cell in cells] if self.decimal_comma else cells


def open_text(file: Path, encoding: str) -> TextIOWrapper:
    """Open a text file, compressed or not."""
    with file.open("rb") as stream:
        magic = stream.read(6)
    opener = next((opener for sign, opener in _COMPRESSED.items() if magic.startswith(sign)), open)
    return opener(file, "rt", encoding=encoding, newline=None, errors="strict")


def is_padded_text(head: bytes) -> bool:
    """Return whether the beginning of a file is text but for stretches of NUL bytes that start or end a line.

    A logger that allocates its file beforehand, or loses its power, leaves such stretches.
    """
    return not _CONTROL.search(_PADDING.sub(b"", head))


def without_padding(line: str) -> str:
    """Return a line without its end, and without the NUL characters at its start and end."""
    return line.rstrip("\r\n").strip("\0")


def find_layout(file: Path, delimiter: str | None) -> TextLayout:
    """Return the layout of a text table, by its first numbers and the lines above them.

    Raises
    ------
    InputError
        if the file is not text, is empty or holds no numbers.
    """
    encoding, lines = _first_lines(file)
    labelled = None if delimiter else _labelled(encoding, lines)
    try:
        table = _table(file, encoding, lines, delimiter)
    except InputError:
        if labelled is None:
            raise
        return labelled
    # Labels may stand in cells of their own, below names for all.
    return table if labelled is None or _names_all(table.names, len(table.kinds)) else labelled


def _names_all(names: Sequence[str], width: int) -> bool:
    """Return whether names are those of all columns, and one at least says what it is."""
    return len(names) == width and any(map(role_of, names))


def _table(file: Path, encoding: str, lines: Sequence[tuple[int, str]], delimiter: str | None) -> TextLayout:
    typical = _typical([line for _, line in lines], delimiter)
    for index, (first, line) in enumerate(lines):
        separator, comma = _separator(line, delimiter)
        comma = comma or _has_commas(split_cells(line, separator), separator)
        point = _with_point(comma)
        following = lines[index + 1][1] if index + 1 < len(lines) else ""
        cells = point(split_cells(line, separator))
        below = point(split_cells(following, separator))
        if _above(cells, point(typical)) or not _is_data(line, cells, below, separator):
            continue
        sample = [point(split_cells(text, separator)) for _, text in lines[index : index + _SAMPLE]]
        # A last cell that is empty is no column only if it is empty in every line.
        width = max(len(_without_trailing(row)) for row in sample if len(row) == len(cells))
        heading, names, units = _heading(lines[:index], separator, {len(cells), width})
        width = len(cells) if len(names) == len(cells) else width
        kinds = tuple(kind_of([row[place] for row in sample if place < len(row)]) for place in range(width))
        head = dict(lines).get(heading, "").strip()
        above = [split_cells(_without_sign(text, separator), separator) for _, text in lines[:index]]
        return TextLayout(
            encoding,
            separator,
            comma,
            first,
            heading,
            names,
            units,
            kinds,
            find_tags(sample, names, _names_all(names, len(sample[0])), above),
            head,
            label_columns=_label_columns(sample, kinds),
            rate=stated_rate(lines[:index]),
        )
    raise input_error(
        f"there is no line of numbers among the first {lines[-1][0]} lines",
        str(file),
        "numbers delimited by commas, semicolons, tabs or spaces",
        "export the recording as a table of numbers",
    )


def _label_columns(sample: Sequence[Sequence[str]], kinds: Sequence[CellKind]) -> frozenset[int]:
    """Return the columns that hold the same word in every line."""
    texts = [place for place, kind in enumerate(kinds) if kind is CellKind.TEXT and len(sample) >= FEW]
    return frozenset(place for place in texts if len({tuple(row[place : place + 1]) for row in sample}) == 1)


def _has_commas(cells: Sequence[str], separator: str | None) -> bool:
    """Return whether numbers have decimal commas: in quotes between commas; three digits behind each are thousands."""
    digits = [len(re.split("[,eE]", cell)[1]) for cell in cells if has_decimal_comma(cell)]
    return any(separator != "," or count != 3 for count in digits)


def _with_point(comma: bool) -> Callable[[list[str]], list[str]]:
    return (lambda cells: [cell.replace(",", ".") for cell in cells]) if comma else (lambda cells: cells)


def _first_lines(file: Path) -> tuple[str, list[tuple[int, str]]]:
    """Return the encoding, and the first lines that are not blank with their numbers from 1."""
    for encoding in ("utf-8-sig", "utf-16", "cp1252"):
        try:
            with open_text(file, encoding) as stream:
                lines = [(number, without_padding(line)) for number, line in enumerate(islice(stream, _MOST_LINES), 1)]
        except UnicodeError:
            continue
        except (OSError, EOFError, lzma.LZMAError) as error:
            raise input_error(f"the file cannot be read: {error}", str(file), "text", "copy it again") from None
        if not any(line.strip() for _, line in lines):
            raise input_error("the file is empty", str(file), "a table of numbers", "export the recording again")
        if not any("\0" in line for _, line in lines):
            return encoding, [(number, line) for number, line in lines if line.strip()]
    raise input_error("the file is not text", str(file), "text in UTF-8, UTF-16 or Windows-1252", "export it as text")


def split_cells(line: str, separator: str | None) -> list[str]:
    """Return the cells of a line, without quotes and spaces around them."""
    if " -> " in line:  # time of the serial monitor
        line = line.replace(" -> ", separator or " ", 1)
    if '"' not in line and "'" not in line:
        parts = line.split(separator)
        return [part.strip() for part in parts] if separator else parts
    text, mark = (line, separator) if separator else (" ".join(line.split()), " ")
    try:
        cells = next(csv.reader([text], delimiter=mark, skipinitialspace=True), [])
    except csv.Error:  # a cell beyond the limit of the parser is no name, and no number
        cells = [text]
    return [cell.strip().strip("'\"").strip() for cell in cells]


def _separator(line: str, stated: str | None) -> tuple[str | None, bool]:
    """Return the delimiter of a line, and whether commas in it are decimal signs."""
    if stated:
        return DELIMITERS[stated], False
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
    """Distinguish data from names: it holds a number, and no text in a column that holds a number in the next line."""
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

    A line with a comment sign has names only if they are as many as the data fields: it may say anything.
    """
    found = [(number, names) for number, line in reversed(lines) if (names := _fitting(line, separator, widths))]
    if not found:
        return _last_names(lines[-1:], separator, min(widths))
    (number, names), *above = found
    if above and _are_units(names, above[0][1]):
        return *above[0], names
    return number, names, ()


def _fitting(line: str, separator: str | None, widths: set[int]) -> tuple[str, ...]:
    """Return the cells of a line that has as many as the data; empty if it has not.

    Names may be delimited otherwise than numbers, but not within a cell.
    """
    others = () if separator and separator in line else ("\t", ";", ",", None)
    for mark in dict.fromkeys((separator, *others)):
        cells = split_cells(_without_sign(line, mark), mark)
        for names in (cells, _without_trailing(cells), _shortened(cells)):
            if len(names) in widths:
                return tuple(names)
    return ()


def _are_units(cells: Sequence[str], above: Sequence[str]) -> bool:
    """Return whether the cells of a line are units: all of them, or most below names that say what the columns are."""
    filled = [cell for cell in cells if cell]
    known = sum(map(is_unit, filled))
    named = [cell for cell in above if cell and not is_unit(cell) and role_of(cell)]
    return bool(filled) and (known == len(filled) or (len(named) > 1 and 2 * known > len(filled)))


def _last_names(
    lines: Sequence[tuple[int, str]], separator: str | None, width: int
) -> tuple[int, tuple[str, ...], tuple[str, ...]]:
    """Return the names in the last line; a cell without a name in it is a sentence, such as "sensor found".

    A line that begins with a time is one of the log, not of names.
    """
    for number, line in lines:
        names = split_cells(_without_sign(line, separator), separator)
        if kind_of(names[:1]) is not CellKind.TEXT:
            continue
        if len(names) > 1 or width < 3 or any(map(role_of, re.split(r"[\s,;|]+", line))):
            return number, tuple(names), ()
    return 0, (), ()


def _typical(lines: Sequence[str], stated: str | None) -> list[str]:
    """Return the cells of a late line, with as many as most lines there have; none if they are few, or tagged."""
    late = [split_cells(line, _separator(line, stated)[0]) for line in lines[len(lines) // 2 :]]
    widths = [len(row) for row in late]
    usual = max(set(widths), key=widths.count)
    tagged = find_tags(late, (), False, ())
    return next(row for row in late if len(row) == usual) if len(late) >= FEW and tagged is None else []


def _above(cells: Sequence[str], typical: Sequence[str]) -> bool:
    """Return whether a line stands above the table: fewer cells than its lines have, or text if they have none."""
    kinds = [(kind_of([cell]), kind_of([below])) for cell, below in zip(cells, typical, strict=False)]
    return len(cells) < len(typical) or any(own is CellKind.TEXT is not below for own, below in kinds)


def _between(line: str) -> tuple[str, ...]:
    return tuple(part.strip() for part in _NUMBER.split(line.strip()))


def _labelled(encoding: str, lines: Sequence[tuple[int, str]]) -> TextLayout | None:
    """Return the layout of lines that name each number, or each first of several, always in the same words."""
    found = [_between(line) for _, line in lines[len(lines) // 2 :]]
    usual = max(set(found), key=found.count)
    words = _with_owners([" ".join(re.findall(r"[^\W\d_][\w.]*", part)) for part in usual[:-1]])
    named = [word for word in words if word]
    always = found.count(usual) >= _LABELLED * len(found) and len(words) > 3 and len(set(named)) == len(named) > 1
    if not always or not words[0] or not any(role_of(f"{word}[0]") or role_of(word) for word in named):
        return None
    first = next(number for number, line in lines if _between(line) == usual)
    kinds = (CellKind.NUMBER,) * len(words)
    return TextLayout(encoding, None, False, first, first, tuple(_numbered(words)), (), kinds, None, "", usual)


def _with_owners(words: Sequence[str]) -> list[str]:
    """Return labels, those of axes alone behind the words that came with an axis last: accel x, y, z of nested JSON."""
    owner, found = "", []
    for word in words:
        *others, last = word.split() or [""]
        owner = " ".join(others) if others else owner if last in ("x", "y", "z") else ""
        found.append(f"{owner} {last}".strip())
    return found


def _numbered(words: Sequence[str]) -> Iterator[str]:
    """Yield a name for each number: a word of its own, or the word before several with their index."""
    for place, word in enumerate(words):
        first = place - next(back for back in range(place + 1) if words[place - back])
        several = not word or words[place + 1 : place + 2] == [""]
        yield f"{words[first]}[{place - first}]" if several else word


def _shortened(cells: Sequence[str]) -> Sequence[str]:
    """Return units without the word that says so, or names without that of remarks, which no line has."""
    if not cells:
        return ()
    if cells[0].rstrip(":").lower() in ("unit", "units"):
        return cells[1:]
    return cells[:-1] if cells[-1].lower() in _REMARKS else ()


def _without_sign(line: str, separator: str | None) -> str:
    """Return the line without a comment sign; a sign with a delimiter behind it is a name."""
    sign = COMMENT_SIGN.match(line)
    if sign is None or (separator and line[sign.end() :].startswith(separator)):
        return line
    return line[sign.end() :]
