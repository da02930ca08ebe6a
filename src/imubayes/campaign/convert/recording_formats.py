"""Readers of the recording formats: each returns the columns of a run table."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from imubayes.campaign.convert.recording_options import TIME_UNITS, ConvertOptions
from imubayes.campaign.convert.text_table import inspect_table, pick_columns, read_numbers
from imubayes.covariates import recorded_columns
from imubayes.errors import InputError, Issue, closest_first, input_error

ACCELEROMETERS, GYROS = ("ax", "ay", "az"), ("gx", "gy", "gz")
SIX = (*ACCELEROMETERS, *GYROS)
Columns = dict[str, np.ndarray]


def read_imu_tk(files: Sequence[Path], options: ConvertOptions) -> Columns:
    """Return the columns of two text files, accelerometers and gyros, each with time x y z."""
    if len(files) != 2:
        allowed = "two: accelerometers first, gyros second, each with columns time x y z"
        raise _wrong_count("imu-tk", files, allowed, "give both files")
    parts = []
    for file, names in zip(files, (ACCELEROMETERS, GYROS), strict=True):
        table = inspect_table(file, options.delimiter)
        parts.append(read_numbers(table, pick_columns(table, {"time_s": 1, **{n: i + 2 for i, n in enumerate(names)}})))
    force, rate = parts
    time = force.pop("time_s")
    clock = rate.pop("time_s")
    if len(clock) != len(time) or np.max(np.abs(clock - time)) > 0:
        # Two clocks: the rates are interpolated to the times of the accelerometers.
        inside = (time >= clock[0]) & (time <= clock[-1])
        force = {name: values[inside] for name, values in force.items()}
        rate = {name: np.interp(time[inside], clock, values) for name, values in rate.items()}
        time = time[inside]
    return {"time_s": time * TIME_UNITS[options.time_unit], **force, **rate}


def read_six_column(files: Sequence[Path], options: ConvertOptions) -> Columns:
    """Return the columns of one text file: ax ay az gx gy gz, or those that the option `columns` names."""
    if len(files) != 1:
        raise _wrong_count("six-column", files, "one file", "convert each recording into a campaign of its own")
    _check_targets(options)
    table = inspect_table(files[0], options.delimiter)
    default = {name: name for name in (*SIX, *recorded_columns()) if name in table.names}
    if not table.has_header:
        default = {name: position for position, name in enumerate(SIX, start=1)}
    wanted = dict(options.columns) or default
    columns = read_numbers(table, pick_columns(table, wanted or {name: name for name in SIX}))
    rows = len(next(iter(columns.values())))
    if options.sample_rate_hz is not None:
        columns["time_s"] = np.arange(rows) / options.sample_rate_hz
    elif "time_s" in columns:
        columns["time_s"] = (columns["time_s"] - columns["time_s"][0]) * TIME_UNITS[options.time_unit]
    else:
        what = "the recording has no time column, and no sampling rate was given"
        allowed = "sample_rate_hz = 100, or time_s=COLUMN under columns"
        raise input_error(what, f"{files[0]}:1", allowed, "give the sampling rate")
    return columns


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


KINDS: dict[str, Callable[[Sequence[Path], ConvertOptions], Columns]] = {
    "imu-tk": read_imu_tk,
    "six-column": read_six_column,
}
"""Kind → reader; a further format is one more function and one more line."""
