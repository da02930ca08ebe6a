"""Conversion of recordings of other tools into campaign folders, written atomically.

A recording does not state its units, its site or the procedure; the options do.  The nominal scale of raw counts is
estimated from the recording where the options do not give it, and noted in the campaign.  A campaign folder is written
to a temporary folder, which is renamed at the end.
"""

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv as pacsv
import tomlkit

from imubayes.campaign.campaign_reader import CAMPAIGN_FILE, inspect_campaign
from imubayes.campaign.convert.raw_counts import nominal_of_counts
from imubayes.campaign.convert.recording_formats import (
    ACCEL_UNITS,
    GYRO_UNITS,
    GYROS,
    KINDS,
    SIX,
    Columns,
    ConvertOptions,
    ReadRecording,
    read_options,
)
from imubayes.foundations.earth import normal_gravity
from imubayes.foundations.errors import InputError, closest_first, input_error
from imubayes.foundations.files import new_folder
from imubayes.procedures import procedure_named


def write_campaign(
    out: Path,
    document: Mapping[str, Any],
    tables: Mapping[str, Mapping[str, np.ndarray]],
    check: bool = True,
    came_from: Callable[[str], str] = lambda where: where,
) -> None:
    """Write `campaign.toml` and run tables into a new folder.

    Parameters
    ----------
    out : the folder; must not exist, or be empty.
    document : content of `campaign.toml`.
    tables : path of a run table within the folder → its columns.
    check : read the campaign back before it is moved into place.
    came_from : place in the campaign → the place in its source, for errors.

    Raises
    ------
    InputError
        if the folder is not empty, or the campaign would not load.
    """
    refuse_occupied(out)
    with new_folder(out) as draft:
        for name, columns in tables.items():
            (draft / name).parent.mkdir(parents=True, exist_ok=True)
            _write_csv(draft / name, columns)
        (draft / CAMPAIGN_FILE).write_text(tomlkit.dumps(document), encoding="utf-8")
        issues = inspect_campaign(draft).issues if check else ()
        if issues:
            raise InputError(
                replace(issue, where=came_from(issue.where.replace(str(draft), str(out)))) for issue in issues
            )


def refuse_occupied(out: Path) -> None:
    """Raise an `InputError` if the folder is not empty, or is a file."""
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise input_error(
            f"'{out}' exists and is not an empty folder",
            str(out),
            "a folder that does not exist yet, or an empty one",
            "choose another name, or remove the folder first",
        )


def _write_csv(file: Path, columns: Mapping[str, np.ndarray]) -> None:
    with file.open("wb") as stream:
        stream.write((",".join(columns) + "\n").encode())
        pacsv.write_csv(pa.table(dict(columns)), stream, pacsv.WriteOptions(include_header=False))


RECORDING = "runs/recording.csv"
DEFAULT_LATITUDE = 45.0
# Without a site: the rounded value assumed by bench calibration tools and their published results.
DEFAULT_GRAVITY = 9.81  # m/s²

__all__ = ["KINDS", "ConvertOptions", "convert", "write_campaign"]


def convert(kind: str, files: Sequence[str | Path], out: str | Path, **options: Any) -> Path:
    """Convert a recording of another tool into a campaign folder.

    Parameters
    ----------
    kind : ``imu-tk`` (two text files, accelerometers and gyros, each time x y z) or ``six-column``
        (ax ay az gx gy gz, or the columns that are named).
    files : the recording.
    out : the campaign folder to write; must not exist, or be empty.
    options : see `ConvertOptions`.

    Raises
    ------
    InputError
        with everything that prevents the conversion.
    """
    if kind not in KINDS:
        what = f"'{kind}' is not a kind of recording"
        raise input_error(what, "KIND", closest_first(kind, KINDS), "use one of these kinds")
    chosen = read_options(options)
    folder = Path(out)
    refuse_occupied(folder)
    read = KINDS[kind]([Path(file) for file in files], chosen)
    table, document = _campaign(read, chosen, folder, kind, ", ".join(Path(file).name for file in files))
    recording = " and ".join(str(file) for file in files)
    write_campaign(folder, document, {RECORDING: table}, came_from=lambda where: _came_from(where, recording))
    return folder


def _came_from(where: str, recording: str) -> str:
    """Return the place in the recording, or the option, that a place in the campaign was written from."""
    if found := re.search(rf"{re.escape(RECORDING)}(?::(\d+))?(.*)", where):
        # The first line of the table is its header.
        reading = f", sample {int(found[1]) - 1}" if found[1] else ""
        return f"{recording}{reading}{found[2]}"
    key = where.rpartition(".")[2].rpartition(" ")[2]
    return f"option {key}" if key in {option.name for option in fields(ConvertOptions)} else where


def _campaign(
    read: ReadRecording, options: ConvertOptions, folder: Path, kind: str, source: str
) -> tuple[Columns, dict[str, Any]]:
    columns, notes = read.columns, [f"converted from {source} ({kind})", *read.notes]
    site = _site(options, notes)
    gravity = site.get("gravity_m_s2") or normal_gravity(math.radians(site["latitude_deg"]), options.height_m)
    run: dict[str, Any] = {"name": "recording", "procedure": options.procedure, "file": RECORDING}
    for key in ("temperature_degC", "initial_rest_s"):
        if getattr(options, key) is not None:
            run[key] = float(getattr(options, key))
    channels = _channels(columns, options, gravity, notes, source)
    document: dict[str, Any] = {"format": 1, "name": options.name or folder.name, "notes": notes, "site": site}
    if options.serial:
        document["unit"] = {"serial": options.serial}
    document["channel"] = channels
    if procedure_named(options.procedure).needs_table:
        document["table"] = [{"name": "bench", "elevation_deg": 90.0}]
        document["mounting"] = [{"name": "aligned", "preset": "aligned"}]
        run |= {"table": "bench", "mounting": "aligned"}
    document["run"] = [run]
    return {"time_s": columns["time_s"], **columns}, document


def _site(options: ConvertOptions, notes: list[str]) -> dict[str, float]:
    latitude, gravity = options.latitude_deg, options.gravity_m_s2
    if latitude is None:
        latitude = DEFAULT_LATITUDE
        notes.append(f"the latitude was not given: {latitude:g} deg is assumed for the Earth rate")
        if gravity is None:
            gravity = DEFAULT_GRAVITY
            notes.append(
                f"neither gravity nor latitude was given: {gravity:g} m/s² is assumed; on Earth it is 9.78 to 9.83, "
                "and the relative error carries over to the accelerometer scale factors"
            )
    site = {"latitude_deg": float(latitude), "height_m": float(options.height_m)}
    return site if gravity is None else site | {"gravity_m_s2": float(gravity)}


def _channels(
    columns: Columns, options: ConvertOptions, gravity: float, notes: list[str], source: str
) -> list[dict[str, Any]]:
    nominal: dict[str, tuple[float, float]] = {}
    if "count" in (options.accel_unit, options.gyro_unit):
        nominal = nominal_of_counts(columns, options, gravity, notes, source)
    channels = []
    for index, name in enumerate(SIX):
        if name not in columns:
            continue
        gyro = name in GYROS
        unit = options.gyro_unit if gyro else options.accel_unit
        scale, offset = nominal.get(name, (1.0, 0.0))
        channels.append(
            {
                "name": name,
                "kind": "gyro" if gyro else "accelerometer",
                "input_axis": [float(index % 3 == axis) for axis in range(3)],
                "output_unit": unit,
                "scale": scale,
                "per": (GYRO_UNITS if gyro else ACCEL_UNITS)[unit],
                "offset": offset,
            }
        )
    return channels
