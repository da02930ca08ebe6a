"""Readers of the recording formats: each returns the columns of a run table, and how it understood the file.

Where a table has names, columns are found by name alone; by position only in the two layouts without names.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from imubayes.campaign.convert.recording_options import TIME_UNITS, ConvertOptions
from imubayes.campaign.convert.text_table import TextTable, inspect_table, pick_columns, read_numbers
from imubayes.covariates import recorded_columns
from imubayes.errors import InputError, Issue, closest_first, input_error

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
