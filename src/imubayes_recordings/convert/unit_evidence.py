"""Units of the channels: as stated, or as the numbers say, with the evidence; asked for if two fit.

Accelerometers at rest read g in some unit.  Gyros at rest say little; the turns between poses do: the angle between the
directions of gravity before and after a turn is what the gyros integrate to, in rad, deg or counts.  Turns through a
stated angle, and the rate of a table, do as well (`stated_motion`).
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from imubayes.campaign.reduction.rests import reads_gravity
from imubayes.foundations.errors import InputError, input_error
from imubayes_recordings.convert.column_names import ACCEL_UNITS, ACCELEROMETERS, GYRO_UNITS, GYROS, SIX, TIME
from imubayes_recordings.convert.motion_kind import per_radian_in_motion
from imubayes_recordings.convert.options import ConvertOptions
from imubayes_recordings.convert.raw_counts import LEAST_TURNS, estimate_gyros, find_poses
from imubayes_recordings.convert.stated_motion import per_radian_of_stated_motion
from imubayes_recordings.convert.unnamed_columns import GRAVITY, READ, rest_means, unit_of_gravity

_PER_RADIAN = {"rad/s": 1.0, "deg/s": 57.29578, "mrad/s": 1000.0, "mdeg/s": 57295.78}
_NEAR = 0.25  # of a unit; the next is a factor of 17 away
_MOST_SAMPLES = 300_000
_FEW_COUNTS = 20
# The largest zero-rate output of MEMS gyros: 20 deg/s, MPU-6050 product specification.
_LARGEST_BIAS = {"rad/s": 0.35, "deg/s": 20.0}
_FAR = 1.5  # times the unit that is stated: ranges of a gyro differ by factors of 2, scale factors by some percent
_OTHER_RATE = 4.0  # times the sampling rate, within which another is offered


@dataclass(frozen=True)
class Units:
    """Units of a recording.

    Attributes
    ----------
    accel, gyro : keys of `ACCEL_UNITS` and `GYRO_UNITS`; empty if there are no such channels.
    guesses : option → why its value was taken, if numbers said it.
    """

    accel: str
    gyro: str
    guesses: dict[str, str]


def find_units(
    columns: Mapping[str, np.ndarray],
    stated: Mapping[str, str],
    options: ConvertOptions,
    where: str,
) -> Units:
    """Return the units of the channels.

    Parameters
    ----------
    columns : target → values, shape (N,), with `time_s` in s if the rows have times.
    stated : channel → unit that its name or the recording states.
    where : for errors.

    Raises
    ------
    InputError
        if the unit is not known and the numbers fit none or several.
    """
    guesses: dict[str, str] = {}
    names = [name for name in ACCELEROMETERS if name in columns]
    force = np.stack([columns[name][:READ] for name in names], axis=1) if names else np.zeros((0, 0))
    accel = options.accel_unit  # if gravity speaks for it, what the recording states is wrong
    if not accel or force.shape[1] != 3 or unit_of_gravity(force, rest_means(force))[0] != accel:
        accel = _stated("accel_unit", accel, ACCELEROMETERS, columns, stated, where)
    if accel:
        _refuse_no_gravity(accel, force, where)
    elif names:
        accel, guesses["accel_unit"] = _of_accelerometers(force, where)
    gyro = _of_stated_gyros(columns, stated, options, where)
    if not gyro and any(name in columns for name in GYROS):
        gyro, guesses["gyro_unit"] = _of_gyros(columns, accel, options, where)
    return Units(accel, gyro, guesses)


def _stated(
    option: str, given: str, names: tuple[str, ...], columns: Mapping[str, np.ndarray], stated: Mapping[str, str],
    where: str,
) -> str:  # fmt: skip
    own = {stated[name] for name in names if name in columns and stated.get(name)}
    allowed = ACCEL_UNITS if option == "accel_unit" else GYRO_UNITS
    if given and own - {given}:
        raise input_error(
            f"the columns {' '.join(names)} are in {' and '.join(sorted(own))}, but {given} is requested",
            where,
            "the unit that the recording states, or no statement",
            f"leave out --{option.replace('_', '-')} (or {option} of the mapping), or correct the recording",
        )
    if given or not own:
        return given
    if len(own) > 1 or not own <= set(allowed):
        what = f"the columns {' '.join(names)} are in {' and '.join(sorted(own))}"
        remedy = f"state the unit with --{option.replace('_', '-')}"
        raise input_error(what, where, "one unit for the three: " + ", ".join(allowed), remedy)
    return own.pop()


def _of_stated_gyros(
    columns: Mapping[str, np.ndarray], stated: Mapping[str, str], options: ConvertOptions, where: str
) -> str:
    """Return the unit that is stated, held against the turns between poses; an option is right if they agree."""
    given, own = options.gyro_unit, {stated[name] for name in GYROS if name in columns and stated.get(name)}
    wanted = given or (own.pop() if len(own) == 1 else "")
    size = 0.0
    if wanted in _PER_RADIAN and all(name in columns for name in (*SIX, TIME)):
        size, _ = per_radian({name: columns[name] for name in (*SIX, TIME)}, where)
        if size and not 1 / _FAR < size / _PER_RADIAN[wanted] < _FAR:
            raise _other_turns(wanted, size, columns[TIME], where)
    return given if given and size else _stated("gyro_unit", given, GYROS, columns, stated, where)


def _other_turns(unit: str, size: float, time: np.ndarray, where: str) -> InputError:
    near = unit_of_turns(size)
    scale = f"state the scale: --gyro-unit count --gyro-scale {size:.4g} --gyro-offset 0"
    remedy = f"state the unit: --gyro-unit {near}" if near else scale + _other_rate(time, size)
    what = f"the gyros are in {unit}, and turns between poses integrate to {size:.4g} {unit}·s per radian"
    return input_error(what, where, f"about {_PER_RADIAN[unit]:.4g}", remedy)


def _refuse_no_gravity(unit: str, force: np.ndarray, where: str) -> None:
    """Raise InputError if three accelerometers read at rest what is not g in their unit."""
    known = ACCEL_UNITS.get(unit)
    if force.shape[1] != 3 or known is None or known.increment or unit == "count":
        return
    gravity = known.scale * GRAVITY[known.per]
    # At rest, or in each row if a row is a pose.
    sizes = [float(np.nanmedian(np.linalg.norm(part, axis=1))) for part in (rest_means(force), force) if len(part)]
    if sizes and not any(reads_gravity(size, gravity) for size in sizes):
        size, in_g = sizes[0], sizes[0] / gravity
        raise input_error(
            f"at rest the accelerometers read |f| = {size:.4g} {unit}, which is {in_g:.4g} g",
            where,
            "about 1 g at rest",
            "correct the unit (header, --accel-unit or mapping), or state the columns: --column ax=NAME …"
            + (f"; {_REMOVED}" if in_g < _NO_GRAVITY else ""),
        )


_NO_GRAVITY = 0.05  # of g at rest
_REMOVED = (
    "if gravity was subtracted (linear or user acceleration), record the full reading of the accelerometers, "
    "or both parts"
)


def _of_accelerometers(force: np.ndarray, where: str) -> tuple[str, str]:
    rest = rest_means(force)
    unit, size = unit_of_gravity(force, rest) if force.shape[1] == 3 else ("", float(np.median(np.abs(rest))))
    if unit == "mg" and _rivals_of_mg(force, size):
        raise input_error(
            f"the unit of the accelerometers is not known: |f| = {size:.5g} at rest is g in mg, cm/s^2 or counts",
            where,
            "g is 1000 mg or 980.7 cm/s^2; counts of 1024 per g are common",
            "state it: --accel-unit mg, cm/s^2 or count",
        )
    if unit:
        return unit, f"|f| = {size:.5g} at rest is g in {unit}"
    if _whole(force):
        return "count", f"whole numbers, and |f| = {size:.5g} at rest is g in no usual unit"
    raise input_error(
        f"the unit of the accelerometers is not known: |f| = {size:.5g} at rest",
        where,
        "g is 9.81 m/s^2, 1 g or 1000 mg; counts have any scale: " + ", ".join(ACCEL_UNITS),
        "state it, such as --accel-unit g; or --accel-unit count with --accel-scale and --accel-offset"
        + (f"; {_REMOVED}" if size < 9.81 * _NO_GRAVITY and not _whole(force) else ""),
    )


def _rivals_of_mg(force: np.ndarray, size: float) -> bool:
    """Return whether |f| is nearer to g in cm/s², or in the counts of a common converter, than to 1000 mg."""
    rivals = [980.665, *([1024.0] if _whole(force) else [])]
    return min(abs(size - rival) for rival in rivals) < abs(size - 1000.0)


def _whole(values: np.ndarray) -> bool:
    """Return whether readings are whole numbers, and not few of them, as those of a converter."""
    part = values[:1000][np.isfinite(values[:1000]).all(axis=1)]
    return bool((part % 1 == 0).all() and np.ptp(values, axis=0).max() > _FEW_COUNTS)


def _of_gyros(columns: Mapping[str, np.ndarray], accel: str, options: ConvertOptions, where: str) -> tuple[str, str]:
    """Return the unit of the gyros by a stated motion or the turns between poses; else that of the other SI unit."""
    rate = np.stack([columns[name] for name in GYROS if name in columns], axis=1)
    stated, how = per_radian_of_stated_motion(columns, options, where)
    size_of_turn, turned = (stated, f" ({how})") if stated else _of_poses(columns, where)
    if _whole(rate):  # counts may have nearly the scale of a unit
        return "count", f"whole numbers{turned}"
    if near := unit_of_turns(size_of_turn):
        return near, how or f"turns between poses integrate to {size_of_turn:.4g} {near.split('/')[0]} per radian"
    size = float(np.median(np.linalg.norm(rest_means(rate), axis=1)))
    if accel == "m/s^2" and not turned:
        if size < _LARGEST_BIAS["rad/s"]:
            return "rad/s", (
                f"{size:.3g} at rest; with accelerometers in m/s^2, gyros are usually in rad/s. Without turns this "
                "is not tested: if the unit is deg/s, state --gyro-unit deg/s"
            )
        if size < _LARGEST_BIAS["deg/s"]:
            return "deg/s", (
                f"{size:.3g} at rest is too large for a bias in rad/s. Without turns this is not tested: if the unit "
                "is another one, state --gyro-unit"
            )
    told = "no usual one fits" if stated else _not_told(accel)
    raise input_error(
        f"the unit of the gyros is not known{turned}: {told}", where, ", ".join(GYRO_UNITS),
        "state it, such as --gyro-unit deg/s" + _other_rate(columns.get(TIME), size_of_turn),
    )  # fmt: skip


def unit_of_turns(size: float) -> str:
    """Return the unit of gyros that read `size` for one radian; empty if it is near none."""
    return next((unit for unit, per in _PER_RADIAN.items() if abs(size / per - 1) < _NEAR), "")


def _of_poses(columns: Mapping[str, np.ndarray], where: str) -> tuple[float, str]:
    """Return what the gyros read for one radian by the turns between poses; 0 and nothing if they are not known."""
    names = (*SIX, TIME)
    known = all(name in columns for name in names)
    return per_radian({name: columns[name] for name in names}, where) if known else (0.0, "")


def _not_told(accel: str) -> str:
    if accel:
        return "the accelerometers do not determine it"
    return "there are no accelerometers and no turns to determine it"


def _other_rate(time: np.ndarray | None, per_radian: float) -> str:
    """Return at which sampling rate the turns would be right in a usual unit; empty if at none."""
    if time is None or not per_radian:
        return ""
    rate = 1 / float(np.median(np.diff(time)))
    shares = {unit: per_radian / _PER_RADIAN[unit] for unit in ("deg/s", "rad/s")}
    return "".join(
        f"; the turns are right in {unit} at a sampling rate of {rate * share:.4g} Hz (--sample-rate-hz)"
        for unit, share in shares.items()
        if 1 / _OTHER_RATE < share < _OTHER_RATE
    )


def _of_motion(part: Mapping[str, np.ndarray]) -> tuple[float, str]:
    """Return what the gyros read for one radian if there are no turns between poses; 0 if it is not known."""
    size = per_radian_in_motion(part)
    return size, f" (gravity turns by {size:.4g} per radian)" if size else ""


def per_radian(columns: Mapping[str, np.ndarray], where: str) -> tuple[float, str]:
    """Return how much the gyros read for one radian, from the turns between poses; 0 if there are too few.

    Parameters
    ----------
    columns : the six channels and `time_s`, shape (N,) each.
    where : for errors.
    """
    part = {name: np.asarray(values[:_MOST_SAMPLES]) for name, values in columns.items()}
    used = np.isfinite(np.stack(list(part.values()))).all(axis=0)
    part = {name: values[used] for name, values in part.items()}
    force, rate = (np.stack([part[name] for name in names], axis=1) for names in (ACCELEROMETERS, GYROS))
    time = part["time_s"]
    if len(time) < 200:
        return 0.0, ""
    rests, initial = find_poses(force, float(np.median(np.diff(time))), None)
    if len(rests) <= LEAST_TURNS:
        return _of_motion(part)
    down = np.array([force[rest.start : rest.stop].mean(0) for rest in rests])
    down /= np.linalg.norm(down, axis=1, keepdims=True)
    try:
        found = estimate_gyros(rate, down, time, rests, initial, where)
    except (InputError, np.linalg.LinAlgError):
        return _of_motion(part)
    sizes = np.abs(found.scale)
    if sizes.max() > 1.5 * sizes.min():
        return _of_motion(part)
    return float(np.median(sizes)), f" (turns between poses integrate to {float(np.median(sizes)):.4g} per radian)"
