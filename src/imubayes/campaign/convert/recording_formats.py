"""Readers of the recording formats, on plain text tables, and the options that state what a recording does not.

A reader returns the columns of a run table, and how it understood the file.  Text tables have names or not, and are
delimited by commas, tabs, semicolons or spaces.  Where a table has names, columns are found by name alone; by position
only in the two layouts without names.
"""

import csv
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from imubayes.foundations.covariates import recorded_columns
from imubayes.foundations.errors import InputError, Issue, closest_first, input_error
from imubayes.procedures import PROCEDURES

ACCEL_UNITS = {"m/s^2": "m/s^2", "g": "g", "count": "m/s^2"}
GYRO_UNITS = {"rad/s": "rad/s", "deg/s": "deg/s", "count": "rad/s"}
TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
DELIMITERS = {"comma": ",", "semicolon": ";", "tab": "\t", "space": None}


@dataclass(frozen=True)
class ConvertOptions:
    """Options of a conversion."""

    name: str = ""
    """Name of the campaign; by default the name of its folder."""
    serial: str = ""
    """Serial number of the unit."""
    accel_unit: str = "m/s^2"
    """Unit of the accelerometers: m/s^2, g or count."""
    gyro_unit: str = "rad/s"
    """Unit of the gyros: rad/s, deg/s or count."""
    accel_scale: Sequence[float] | None = None
    """Nominal counts per m/s², one number or one per axis; by default estimated from the recording."""
    accel_offset: Sequence[float] | None = None
    """Counts at zero input, one number or one per axis."""
    gyro_scale: Sequence[float] | None = None
    """Nominal counts per rad/s, one number or one per axis; by default estimated from the recording."""
    gyro_offset: Sequence[float] | None = None
    """Counts at zero rate, one number or one per axis."""
    sample_rate_hz: float | None = None
    """Sampling rate of a recording without a time column."""
    time_unit: str = "s"
    """Unit of the time column: s, ms, us or ns."""
    columns: Mapping[str, str | int] = field(default_factory=dict)
    """Column of the run table → column of the recording, by name or by number from 1."""
    delimiter: str | None = None
    """comma, semicolon, tab or space; by default detected."""
    gravity_m_s2: float | None = None
    """Measured gravity of the site."""
    latitude_deg: float | None = None
    """Latitude of the site."""
    height_m: float = 0.0
    """Height of the site."""
    temperature_degC: float | None = None
    """Temperature during the recording."""
    initial_rest_s: float | None = None
    """Length of the initial rest."""
    procedure: str = "free_tumble"
    """Procedure of the run; free_tumble for a unit moved by hand."""


def read_options(given: Mapping[str, Any]) -> ConvertOptions:
    """Return the validated options.

    Raises
    ------
    InputError
        with every unknown option and every invalid value.
    """
    names = [option.name for option in fields(ConvertOptions)]
    issues = [
        Issue(f"'{key}' is not an option of convert", f"option {key}", closest_first(key, names), "correct the option")
        for key in given
        if key not in names
    ]
    known = {key: _three(key, value, issues) for key, value in given.items() if key in names}
    options = ConvertOptions(**known)
    choices = {
        "accel_unit": ACCEL_UNITS,
        "gyro_unit": GYRO_UNITS,
        "time_unit": TIME_UNITS,
        "procedure": tuple(PROCEDURES),
        "delimiter": (None, *DELIMITERS),
    }
    for key, allowed in choices.items():
        value = getattr(options, key)
        if value not in allowed:
            listed = closest_first(str(value), [word for word in allowed if word], most=len(allowed))
            issues.append(Issue(f"{key} = '{value}' is not known", f"option {key}", listed, "use an allowed value"))
    for key in ("sample_rate_hz", "gravity_m_s2", "initial_rest_s"):
        value = getattr(options, key)
        if value is not None and not value > 0:
            issues.append(Issue(f"{key} = {value} is not positive", f"option {key}", "more than 0", "correct it"))
    if issues:
        raise InputError(issues)
    return options


def _three(key: str, value: Any, issues: list[Issue]) -> Any:
    """Return one number repeated for three axes."""
    if not key.endswith(("_scale", "_offset")) or value is None:
        return value
    values = [float(value)] * 3 if isinstance(value, int | float) else [float(number) for number in value]
    values = values * 3 if len(values) == 1 else values
    if len(values) != 3 or (key.endswith("_scale") and 0.0 in values):
        issues.append(
            Issue(
                f"{key} has {len(values)} numbers, or a zero",
                f"option {key}",
                "one number, or three: x, y, z; a scale is not zero",
                "correct the numbers",
            )
        )
        return None
    return values


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


ACCELEROMETERS, GYROS = ("ax", "ay", "az"), ("gx", "gy", "gz")
SIX = (*ACCELEROMETERS, *GYROS)
Columns = dict[str, np.ndarray]
_TIMES = ("time_s", "time", "t")
_STATE = "state the column of each channel, such as ax=NAME or ax=NUMBER (--column on the command line)"


@dataclass(frozen=True)
class ReadRecording:
    """Columns of a run table, and notes on where in the recording they were found."""

    columns: Columns
    notes: tuple[str, ...]


def read_imu_tk(files: Sequence[Path], options: ConvertOptions) -> ReadRecording:
    """Return the columns of two text files, accelerometers and gyros, each with time x y z."""
    if len(files) != 2:
        allowed = "two: accelerometers first, gyros second, each with columns time x y z"
        raise _wrong_count("imu-tk", files, allowed, "give both files")
    if options.columns:
        allowed = "time x y z in each file"
        raise input_error("imu-tk has no option columns", "option columns", allowed, "convert one table as six-column")
    parts, notes = [], []
    for file, names in zip(files, (ACCELEROMETERS, GYROS), strict=True):
        table = inspect_table(file, options.delimiter)
        wanted = _imu_tk_columns(table, names)
        parts.append(read_numbers(table, pick_columns(table, wanted)))
        notes += _understood(table, wanted, parts[-1])
    force, rate = parts
    time = force.pop("time_s")
    clock = rate.pop("time_s")
    if len(clock) != len(time) or np.max(np.abs(clock - time)) > 0:
        # Two clocks: the rates are interpolated to the times of the accelerometers.
        inside = (time >= clock[0]) & (time <= clock[-1])
        force = {name: values[inside] for name, values in force.items()}
        rate = {name: np.interp(time[inside], clock, values) for name, values in rate.items()}
        time = time[inside]
    return ReadRecording({"time_s": time * TIME_UNITS[options.time_unit], **force, **rate}, tuple(notes))


def _imu_tk_columns(table: TextTable, channels: Sequence[str]) -> Mapping[str, str | int]:
    accepted = dict(zip(("time_s", *channels), (_TIMES, *((c, c[1]) for c in channels)), strict=True))
    if table.heading is None and table.width == len(accepted):
        return {target: place for place, target in enumerate(accepted, 1)}
    found = {target: [n for n in table.names if n.lower() in words] for target, words in accepted.items()}
    if not all(len(own) == 1 for own in found.values()):
        allowed = ", ".join(" or ".join(words) for words in accepted.values()) + "; or four columns without names"
        raise input_error(_unfit(table), table.where, allowed, "name the columns, or convert one table as six-column")
    return {target: own[0] for target, own in found.items()}


def _unfit(table: TextTable) -> str:
    """Return why the columns of a table are not known."""
    if table.heading is None:
        return f"the table has {table.width} columns and no names"
    if not table.names:
        return f"{len(table.heading.names)} names stand above {table.width} data fields"
    return f"the columns are named {closest_first('', table.names, most=12)}"


def read_six_column(files: Sequence[Path], options: ConvertOptions) -> ReadRecording:
    """Return the columns of one text file: ax ay az gx gy gz by name, or as the option `columns` states them."""
    if len(files) != 1:
        raise _wrong_count("six-column", files, "one file", "convert each recording into a campaign of its own")
    _check_targets(options)
    table = inspect_table(files[0], options.delimiter)
    wanted = _six_columns(table, options.columns)
    columns = read_numbers(table, pick_columns(table, wanted))
    notes = _understood(table, wanted, columns)
    rows = len(next(iter(columns.values())))
    if options.sample_rate_hz is not None:
        columns["time_s"] = np.arange(rows) / options.sample_rate_hz
    elif "time_s" in columns:
        columns["time_s"] = (columns["time_s"] - columns["time_s"][0]) * TIME_UNITS[options.time_unit]
    else:
        what = "the recording has no time column, and no sampling rate was given"
        allowed = "sample_rate_hz = 100, or time_s=COLUMN under columns"
        raise input_error(what, f"{files[0]}:1", allowed, "give the sampling rate")
    return ReadRecording(columns, notes)


def _six_columns(table: TextTable, stated: Mapping[str, str | int]) -> Mapping[str, str | int]:
    """Return the columns that are stated and those that are named; the six channels are whole, or all stated.

    Raises
    ------
    InputError
        where the table does not tell which of its columns are the channels.
    """
    if table.heading is None and table.width == len(SIX) and not stated:
        return {name: position for position, name in enumerate(SIX, start=1)}
    named = {n: n for n in (*SIX, *recorded_columns()) if n in table.names and n not in stated}
    missing = _missing(named, stated)
    readable = table.names or all(str(source).isdigit() for source in stated.values())
    if missing or not readable:
        what = f"{_unfit(table)}: there is no {', '.join(missing)}" if table.names else _unfit(table)
        allowed = f"columns named {' '.join(SIX)}, as many names as data fields; or these six columns without names"
        raise input_error(what, table.where, allowed, _STATE)
    return {**stated, **named}


def _missing(named: Mapping[str, str], stated: Mapping[str, str | int]) -> list[str]:
    """Return the channels without a column; none for a unit with fewer, all of them stated and none found by name."""
    if stated.keys() & set(SIX) and not named.keys() & set(SIX):
        return []
    return [name for name in SIX if name not in named and name not in stated]


def _understood(table: TextTable, wanted: Mapping[str, str | int], columns: Columns) -> tuple[str, ...]:
    """Return notes on what the first lines were taken for: channel ← column, with the first value."""
    positions = pick_columns(table, wanted)
    sources = [
        f"{name} ← column {place + 1}{f" '{table.names[place]}'" if table.names else ''} ({columns[name][0]:.6g} …)"
        for name, place in positions.items()
    ]
    unread = [name or "''" for place, name in enumerate(table.names) if place not in positions.values()]
    kind = f"names in line {table.heading.line}" if table.names and table.heading else "no names"
    left = f"; not read: {', '.join(unread)}" if unread else ""
    return (f"{table.file.name}, {kind}, numbers from line {table.first}: {', '.join(sources)}{left}",)


def _wrong_count(kind: str, files: Sequence[Path], allowed: str, remedy: str) -> InputError:
    where = ", ".join(map(str, files)) or "file list"
    return input_error(f"{len(files)} files were given for {kind}", where, allowed, remedy)


def _check_targets(options: ConvertOptions) -> None:
    allowed = (*SIX, *recorded_columns())
    issues = [
        Issue(
            f"'{target}' is not a column of a run table",
            "option columns",
            closest_first(target, allowed, most=len(allowed)),
            "write NAME=COLUMN with a name from the list",
        )
        for target in options.columns
        if target not in allowed
    ]
    if issues:
        raise InputError(issues)


KINDS: dict[str, Callable[[Sequence[Path], ConvertOptions], ReadRecording]] = {
    "imu-tk": read_imu_tk,
    "six-column": read_six_column,
}
"""Kind → reader; a further format is one more function and one more line."""
