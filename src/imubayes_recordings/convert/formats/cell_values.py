"""Content of one cell of a text table: a number, nothing, a date, a time of day, or both."""

import math
import re
from collections.abc import Callable, Sequence
from datetime import UTC, date, datetime
from enum import StrEnum

_EMPTY = {"", "nan", "na", "n/a", "null", "none", "-", "--", "---", "#n/a", "#na", "#nv", "nat"}
_DATE = re.compile(r"(\d{4})[-/.](\d{1,2})[-/.](\d{1,2})|(\d{1,2})([-/.])(\d{1,2})[-/.](\d{4})")
_CLOCK = re.compile(r"(?:(\d+) days? )?(?:(\d{1,3}):)?(\d{1,2}):(\d{1,2}(?:[.,]\d*|:\d{3})?)(?: ?([aApP])[mM])?")
_PARTED = re.compile(r"([\d./-]{8,10})[T_ ]+(\d+:[\d:.,]+(?: ?[aApP][mM])?) ?(Z|UTC|[+-]\d\d:?\d\d)?")
_STAMP = re.compile(rf"\d{{4}}[-/]?\d{{2}}[-/]?\d{{2}}[T_ ]\d{{2}}.*|{_PARTED.pattern}")


class CellKind(StrEnum):
    """What a column of a text table holds; times in words are read as seconds."""

    NUMBER = "number"
    DATE = "date"
    CLOCK = "clock"
    STAMP = "stamp"
    TEXT = "text"


def number(cell: str) -> float:
    """Return a number, NaN for an empty cell.

    Raises
    ------
    ValueError
        for anything else.
    """
    try:
        return float(cell)
    except ValueError:
        if cell.strip().lower() in _EMPTY:
            return math.nan
        raise


def is_number(cell: str) -> bool:
    """Return whether a cell is a number; `nan` and `inf` are, an empty cell is not."""
    try:
        float(cell)
    except ValueError:
        return False
    return True


def seconds_of_date(cell: str) -> float:
    """Return the seconds from 1970 to midnight of a date: year first, or day and month before the year."""
    found = _DATE.fullmatch(cell.strip())
    if not found:
        raise ValueError(f"'{cell}' is not a date")
    year, month, day, first, separator, second, last = found.groups()
    if year is None:
        month, day = (first, second) if separator == "/" and int(first) <= 12 else (second, first)
        year = last
    return datetime.combine(date(int(year), int(month), int(day)), datetime.min.time(), UTC).timestamp()


def seconds_of_clock(cell: str) -> float:
    """Return the seconds of a time of day, h:m:s or m:s, with days before it or AM or PM behind it."""
    found = _CLOCK.fullmatch(cell.strip())
    if not found:
        raise ValueError(f"'{cell}' is not a time of day")
    days, hours, half = int(found[1] or 0), int(found[2] or 0), (found[5] or "").lower()
    hours = hours % 12 + 12 * (half == "p") if half else hours
    return 86400.0 * days + 3600.0 * hours + 60.0 * int(found[3]) + float(found[4].replace(",", ".").replace(":", "."))


def seconds_of_stamp(cell: str) -> float:
    """Return the seconds from 1970 of a date and a time of day; without a zone it is taken as UTC."""
    parted = _PARTED.fullmatch(cell.strip())
    if parted and _DATE.fullmatch(parted[1]):
        zone = (parted[3] or "").replace(":", "")
        east = float(f"{zone[0]}1") * (60 * int(zone[1:3]) + int(zone[3:])) if zone[:1] in tuple("+-") else 0.0
        return seconds_of_date(parted[1]) + seconds_of_clock(parted[2]) - 60.0 * east
    stamp = datetime.fromisoformat(cell.strip().replace("_", "T").replace(",", ".").replace("/", "-"))
    return (stamp if stamp.tzinfo else stamp.replace(tzinfo=UTC)).timestamp()


VALUE: dict[CellKind, Callable[[str], float]] = {
    CellKind.NUMBER: number,
    CellKind.DATE: seconds_of_date,
    CellKind.CLOCK: seconds_of_clock,
    CellKind.STAMP: seconds_of_stamp,
}
"""Kind → its value; a text has none."""


def kind_of(cells: Sequence[str]) -> CellKind:
    """Return what a column holds, by its first cells."""
    filled = [cell for cell in cells if cell.strip().lower() not in _EMPTY]
    for kind, fits in (
        (CellKind.NUMBER, is_number),
        (CellKind.DATE, lambda cell: _DATE.fullmatch(cell.strip()) is not None),
        (CellKind.CLOCK, lambda cell: _CLOCK.fullmatch(cell.strip()) is not None),
        (CellKind.STAMP, lambda cell: _STAMP.fullmatch(cell.strip()) is not None),
    ):
        # Damaged lines among the first do not change what the column is.
        if sum(map(fits, filled)) >= max(1, 0.5 * len(filled)):
            return kind
    return CellKind.TEXT if filled else CellKind.NUMBER
