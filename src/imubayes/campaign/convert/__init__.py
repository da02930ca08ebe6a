"""Foreign recordings become campaigns.

A recording does not say its units, its site or what was done; the options say it.  What they leave open and
the recording can tell (the nominal scale of raw counts) is estimated, and the campaign carries a note of it.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from imubayes.campaign.columns import NEEDS_TABLE
from imubayes.campaign.convert.estimate import Nominal, estimate_accelerometers, estimate_gyros, find_poses
from imubayes.campaign.convert.options import ACCEL_UNITS, GYRO_UNITS, ConvertOptions, read_options
from imubayes.campaign.convert.recordings import ACCELEROMETERS, GYROS, KINDS, SIX, Columns
from imubayes.campaign.convert.write import refuse_occupied, write_campaign
from imubayes.earth import normal_gravity
from imubayes.errors import InputError, Problem, closest_first

DEFAULT_LATITUDE = 45.0
SIGNIFICANT = 5

__all__ = ["KINDS", "ConvertOptions", "convert", "write_campaign"]


def convert(kind: str, files: Sequence[str | Path], out: str | Path, **options: Any) -> Path:
    """Make a campaign folder of a foreign recording.

    Parameters
    ----------
    kind : ``imu-tk`` (two text files, accelerometers and gyros, each time x y z) or ``six-column``
        (ax ay az gx gy gz, or the columns that are named).
    files : the recording.
    out : the campaign folder to make; must not exist or be empty.
    options : see `ConvertOptions`.

    Raises
    ------
    InputError
        with everything that keeps the recording from becoming a campaign.
    """
    if kind not in KINDS:
        raise InputError(
            Problem(f"'{kind}' is no kind of recording", "KIND", closest_first(kind, KINDS), "use one of these kinds")
        )
    chosen = read_options(options)
    folder = Path(out)
    refuse_occupied(folder)
    columns = KINDS[kind]([Path(file) for file in files], chosen)
    table, document = _campaign(columns, chosen, folder, kind, ", ".join(Path(file).name for file in files))
    write_campaign(folder, document, {"runs/recording.csv": table})
    return folder


def _campaign(
    columns: Columns, options: ConvertOptions, folder: Path, kind: str, source: str
) -> tuple[Columns, dict[str, Any]]:
    notes = [f"converted from {source} ({kind})"]
    latitude = options.latitude_deg
    if latitude is None:
        latitude = DEFAULT_LATITUDE
        notes.append(
            f"the latitude was not given: {latitude:g} deg is taken, for Earth rate and for gravity if not given"
        )
    gravity = options.gravity_m_s2 or normal_gravity(float(np.deg2rad(latitude)), options.height_m)
    channels = _channels(columns, options, gravity, notes, source)
    site = {"latitude_deg": float(latitude), "height_m": float(options.height_m)}
    if options.gravity_m_s2 is not None:
        site["gravity_m_s2"] = float(options.gravity_m_s2)
    run: dict[str, Any] = {"name": "recording", "procedure": options.procedure, "file": "runs/recording.csv"}
    for key in ("temperature_degC", "initial_rest_s"):
        if getattr(options, key) is not None:
            run[key] = float(getattr(options, key))
    document: dict[str, Any] = {"format": 1, "name": options.name or folder.name, "notes": notes, "site": site}
    if options.serial:
        document["unit"] = {"serial": options.serial}
    document["channel"] = channels
    if options.procedure in NEEDS_TABLE:
        document["table"] = [{"name": "bench", "elevation_deg": 90.0}]
        document["mounting"] = [{"name": "aligned", "preset": "aligned"}]
        run |= {"table": "bench", "mounting": "aligned"}
    document["run"] = [run]
    return {"time_s": columns["time_s"], **columns}, document


def _channels(
    columns: Columns, options: ConvertOptions, gravity: float, notes: list[str], source: str
) -> list[dict[str, Any]]:
    nominal: dict[str, tuple[float, float]] = {}
    if "count" in (options.accel_unit, options.gyro_unit):
        nominal = _nominal_of_counts(columns, options, gravity, notes, source)
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


def _nominal_of_counts(
    columns: Columns, options: ConvertOptions, gravity: float, notes: list[str], source: str
) -> dict[str, tuple[float, float]]:
    """Return scale and offset of the channels in counts: given, or estimated from poses and turns."""
    given = {
        "accel": _given(options.accel_unit, options.accel_scale, options.accel_offset),
        "gyro": _given(options.gyro_unit, options.gyro_scale, options.gyro_offset),
    }
    if all(one is not None for one in given.values()):
        accel, gyro = given["accel"], given["gyro"]
    else:
        accel, gyro = _estimated(columns, options, gravity, given, notes, source)
    pairs = {}
    if options.accel_unit == "count":
        pairs |= {name: (accel.scale[i], accel.offset[i]) for i, name in enumerate(ACCELEROMETERS)}
    if options.gyro_unit == "count":
        pairs |= {name: (gyro.scale[i], gyro.offset[i]) for i, name in enumerate(GYROS)}
    return {name: (float(scale), float(offset)) for name, (scale, offset) in pairs.items() if name in columns}


def _given(unit: str, scale: Sequence[float] | None, offset: Sequence[float] | None) -> Nominal | None:
    """Return what the options say; a channel not in counts has scale 1."""
    if unit != "count":
        return Nominal(np.ones(3), np.zeros(3))
    if scale is None or offset is None:
        return None
    return Nominal(np.asarray(scale, dtype=float), np.asarray(offset, dtype=float))


def _estimated(
    columns: Columns,
    options: ConvertOptions,
    gravity: float,
    given: dict[str, Nominal | None],
    notes: list[str],
    source: str,
) -> tuple[Nominal, Nominal]:
    missing = [name for name in SIX if name not in columns]
    if missing:
        raise InputError(
            Problem(
                f"the scale of counts cannot be estimated without {', '.join(missing)}",
                source,
                "all six columns, or accel_scale, accel_offset, gyro_scale, gyro_offset",
                "give the nominal scales and offsets",
            )
        )
    force, rate = (np.stack([columns[name] for name in names], axis=1) for names in (ACCELEROMETERS, GYROS))
    time = columns["time_s"]
    rests, initial = find_poses(force, float(np.median(np.diff(time))), options.initial_rest_s)
    accel = given["accel"]
    if accel is None:
        accel = _combine(
            estimate_accelerometers(force, rests, gravity, source), options.accel_scale, options.accel_offset
        )
        notes.append(_say("accelerometers", "the static poses, |f| = g", accel, "m/s^2"))
    gyro = given["gyro"]
    if gyro is None:
        means = np.array([force[rest.start : rest.stop].mean(0) for rest in rests])
        level = (means - accel.offset) / accel.scale
        down = level / np.linalg.norm(level, axis=1, keepdims=True)
        gyro = _combine(
            estimate_gyros(rate, down, time, rests, initial, source), options.gyro_scale, options.gyro_offset
        )
        notes.append(_say("gyros", "the first rest and the turns between poses", gyro, "rad/s"))
    return accel, gyro


def _combine(found: Nominal, scale: Sequence[float] | None, offset: Sequence[float] | None) -> Nominal:
    """Return the estimate, rounded, with what was given in its place."""
    return Nominal(
        np.array([float(f"{value:.{SIGNIFICANT}g}") for value in (found.scale if scale is None else scale)]),
        np.round(found.offset if offset is None else np.asarray(offset, dtype=float), 1),
    )


def _say(what: str, how: str, nominal: Nominal, unit: str) -> str:
    scales, offsets = (", ".join(f"{value:g}" for value in values) for values in (nominal.scale, nominal.offset))
    return f"nominal scale of the {what} estimated from {how}: {scales} count per {unit}; offset {offsets} count"
