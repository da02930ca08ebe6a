"""Scale and offset of channels in raw counts: as given, or estimated from the recording."""

from collections.abc import Sequence

import numpy as np

from imubayes.campaign.convert.estimated_calibration import Nominal, estimate_accelerometers, estimate_gyros, find_poses
from imubayes.campaign.convert.recording_formats import ACCELEROMETERS, GYROS, SIX, Columns
from imubayes.campaign.convert.recording_options import ConvertOptions
from imubayes.errors import input_error

SIGNIFICANT = 5  # digits of an estimated scale


def nominal_of_counts(
    columns: Columns, options: ConvertOptions, gravity: float, notes: list[str], source: str
) -> dict[str, tuple[float, float]]:
    """Return channel → (scale, offset) of the channels in counts: given, or estimated from poses and rotations.

    Raises
    ------
    InputError
        if an estimate is needed and columns, poses or rotations are missing.
    """
    accel = _given(options.accel_unit, options.accel_scale, options.accel_offset)
    gyro = _given(options.gyro_unit, options.gyro_scale, options.gyro_offset)
    if accel is None or gyro is None:
        accel, gyro = _estimated(columns, options, gravity, accel, gyro, notes, source)
    pairs = {}
    if options.accel_unit == "count":
        pairs |= {name: (accel.scale[i], accel.offset[i]) for i, name in enumerate(ACCELEROMETERS)}
    if options.gyro_unit == "count":
        pairs |= {name: (gyro.scale[i], gyro.offset[i]) for i, name in enumerate(GYROS)}
    return {name: (float(scale), float(offset)) for name, (scale, offset) in pairs.items() if name in columns}


def _given(unit: str, scale: Sequence[float] | None, offset: Sequence[float] | None) -> Nominal | None:
    """Return the nominal calibration of the options, None where incomplete; a channel not in counts has scale 1."""
    if unit != "count":
        return Nominal(np.ones(3), np.zeros(3))
    if scale is None or offset is None:
        return None
    return Nominal(np.asarray(scale, dtype=float), np.asarray(offset, dtype=float))


def _estimated(
    columns: Columns,
    options: ConvertOptions,
    gravity: float,
    accel: Nominal | None,
    gyro: Nominal | None,
    notes: list[str],
    source: str,
) -> tuple[Nominal, Nominal]:
    missing = [name for name in SIX if name not in columns]
    if missing:
        raise input_error(
            f"the scale of counts cannot be estimated without {', '.join(missing)}",
            source,
            "all six columns, or accel_scale, accel_offset, gyro_scale, gyro_offset",
            "give the nominal scales and offsets",
        )
    force, rate = (np.stack([columns[name] for name in names], axis=1) for names in (ACCELEROMETERS, GYROS))
    time = columns["time_s"]
    rests, initial = find_poses(force, float(np.median(np.diff(time))), options.initial_rest_s)
    if accel is None:
        accel = _combine(
            estimate_accelerometers(force, rests, gravity, source), options.accel_scale, options.accel_offset
        )
        notes.append(_note("accelerometers", "the static poses, |f| = g", accel, "m/s^2"))
    if gyro is None:
        means = np.array([force[rest.start : rest.stop].mean(0) for rest in rests])
        level = (means - accel.offset) / accel.scale
        down = level / np.linalg.norm(level, axis=1, keepdims=True)
        gyro = _combine(
            estimate_gyros(rate, down, time, rests, initial, source), options.gyro_scale, options.gyro_offset
        )
        notes.append(_note("gyros", "the initial rest and the rotations between poses", gyro, "rad/s"))
    return accel, gyro


def _combine(found: Nominal, scale: Sequence[float] | None, offset: Sequence[float] | None) -> Nominal:
    """Return the rounded estimate, replaced by what was given."""
    return Nominal(
        np.array([float(f"{value:.{SIGNIFICANT}g}") for value in (found.scale if scale is None else scale)]),
        np.round(found.offset if offset is None else np.asarray(offset, dtype=float), 1),
    )


def _note(what: str, how: str, nominal: Nominal, unit: str) -> str:
    scales, offsets = (", ".join(f"{value:g}" for value in values) for values in (nominal.scale, nominal.offset))
    return f"nominal scale of the {what} estimated from {how}: {scales} count per {unit}; offset {offsets} count"
