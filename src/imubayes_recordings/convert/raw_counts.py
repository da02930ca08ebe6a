"""Nominal scale and offset of channels in raw counts: as given, or estimated from the recording itself.

The static means of the accelerometers lie on an ellipsoid whose semi-axes are g times the scales and whose centre is
the offset.  The gyro offset is the mean at rest, and the gyro scales are those with which the rotations between poses
propagate gravity from each pose to the next.  An accuracy of a few per cent suffices for a nominal value; the fit of
the campaign estimates the rest.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy  # loads its parts when they are first used

from imubayes.campaign.reduction.rests import Rest, find_rests, initial_rest, variance_ratio
from imubayes.foundations.errors import InputError, input_error
from imubayes.foundations.numerics import angle_between
from imubayes.foundations.units import to_si
from imubayes.foundations.wording import counted
from imubayes_recordings.convert.column_names import ACCELEROMETERS, GYROS, SIX, TIME
from imubayes_recordings.convert.options import ConvertOptions
from imubayes_recordings.convert.stated_motion import counts_of_table
from imubayes_recordings.convert.stated_turns import counts_of_turns

QUIET = 6.0  # multiple of the variance at rest
LEAST_POSES = 6  # of as many unknowns: the faces of a six-position test
LEAST_SPREAD = 0.02  # least singular value over the largest; six faces have 0.5, poses in a plane about 0
LEAST_TURNS = 4
LEAST_ANGLE = 0.3  # rad between the directions of gravity in two poses, for a transition that determines the scale
MOST_MISSED = 0.2  # rad; biases and scale factors of 10 % miss less
SEARCH = np.geomspace(0.2, 2.0, 60)
REFINEMENTS = 12
_WIDTHS = (16, 24, 32)  # bits of a number
_PROBED = 1000  # rows
_SEVERAL = 3  # jumps


_STATE_GYROS = (
    "give those of the datasheet: --gyro-scale and --gyro-offset; after turns through a known angle, --turn-deg 360"
)


@dataclass(frozen=True)
class Nominal:
    """Nominal calibration, output = scale · input + offset; per axis, shape (3,) each."""

    scale: np.ndarray
    offset: np.ndarray


def find_poses(force: np.ndarray, interval: float, seconds: float | None) -> tuple[list[Rest], Rest]:
    """Return the rests of a recording and its initial rest; `force` is (N, 3) in any unit."""
    initial = initial_rest(force, interval, seconds)
    return find_rests(variance_ratio(force, interval, initial) < QUIET, interval), initial


def signed_counts(columns: Mapping[str, np.ndarray]) -> tuple[dict[str, np.ndarray], tuple[str, ...]]:
    """Return the columns with negative counts that were written as unsigned turned back, and a note if there are.

    A number in two's complement that is read as unsigned jumps by nearly the whole range if it changes its sign.
    A converter with an offset passes through the values between.
    """
    found = [column[np.isfinite(column)] for name, column in columns.items() if name in SIX]
    if not all(len(column) and (column[:_PROBED] % 1 == 0).all() and column.min() >= 0 for column in found):
        return dict(columns), ()
    most = max((float(column.max()) for column in found), default=0.0)
    width = next((2.0**bits for bits in _WIDTHS if 0.9 * 2.0**bits < most < 2.0**bits), 0.0)
    if not width or not any(_jumps(column, width) for column in found):
        return dict(columns), ()
    signed = {
        name: np.where(column >= width / 2, column - width, column) for name, column in columns.items() if name in SIX
    }
    return {**columns, **signed}, (
        f"negative counts were written as unsigned: those of {width / 2:.0f} and more are reduced by {width:.0f}",
    )


def _jumps(column: np.ndarray, width: float) -> bool:
    """Return whether steps over half the range are gone once the upper half is taken as negative."""
    far = np.count_nonzero(np.abs(np.diff(column)) > width / 2)
    near = np.count_nonzero(np.abs(np.diff(np.where(column >= width / 2, column - width, column))) > width / 2)
    return bool(far > _SEVERAL and near < far / 10)


def estimate_accelerometers(means: np.ndarray, gravity: float, where: str) -> Nominal:
    """Return scale (counts per m/s²) and offset by an ellipsoid fitted to the means of static poses, shape (n, 3).

    Raises
    ------
    InputError
        if there are too few poses, or they do not determine an ellipsoid.
    """
    if len(means) >= LEAST_POSES:
        centre, size = means.mean(0), np.ptp(means, axis=0).max()
        scaled = (means - centre) / size
        solution, _, rank, _ = np.linalg.lstsq(np.hstack([scaled**2, scaled]), np.ones(len(scaled)), rcond=LEAST_SPREAD)
        square, linear = solution[:3], solution[3:]
        if rank == 6 and (square > 0).all():
            middle = -linear / (2 * square)
            half = np.sqrt((1 + np.sum(square * middle**2)) / square)
            return Nominal(half * size / gravity, centre + size * middle)
    raise input_error(
        f"the accelerometer scale cannot be estimated from {counted(len(means), 'static pose')}",
        where,
        f"{LEAST_POSES} or more poses, each axis up and down, or accel_scale and accel_offset",
        "give those of the datasheet: --accel-scale and --accel-offset",
    )


def estimate_gyros(
    rate: np.ndarray, down: np.ndarray, time: np.ndarray, rests: list[Rest], initial: Rest, where: str
) -> Nominal:
    """Return scale (counts per rad/s) and offset.

    Parameters
    ----------
    rate : raw samples, shape (N, 3), counts.
    down : unit direction of the specific force in each rest, shape (rests, 3).
    time : shape (N,), s.
    where : named in errors.

    Raises
    ------
    InputError
        if fewer than four transitions change the direction of gravity, or none of the scales explains them.
    """
    offset = rate[initial.start : initial.stop].mean(0)
    pairs = [
        (index, rest.stop - 1, after.start)
        for index, (rest, after) in enumerate(pairwise(rests))
        if angle_between(down[index], down[index + 1]) > LEAST_ANGLE
    ]
    if len(pairs) < LEAST_TURNS:
        raise _too_few_turns(len(pairs), where)
    before = down[[index for index, _, _ in pairs]]
    after = down[[index + 1 for index, _, _ in pairs]]
    turns = _increments(rate - offset, time, pairs)
    # The integral of |rate| is at least the angle between the two directions of gravity.
    most = float(np.median(np.linalg.norm(turns, axis=2).sum(1) / angle_between(before, after)))
    trial = [float(np.sum(_mismatch(np.full(3, 1 / (most * s)), turns, before, after) ** 2)) for s in SEARCH]
    inverse = np.full(3, 1 / (most * SEARCH[int(np.argmin(trial))]))
    for _ in range(REFINEMENTS):
        inverse = _refine(inverse, turns, before, after)
    missed = float(np.median(np.linalg.norm(_mismatch(inverse, turns, before, after).reshape(-1, 3), axis=1)))
    if not missed < MOST_MISSED:
        raise input_error(
            f"no scale of the gyros carries gravity from pose to pose: {np.rad2deg(missed):.3g} deg are missed",
            where,
            "gyros and accelerometers of one right-handed system, and the whole turn from each pose to the next",
            f"check the columns, and whether turns were cut out of the recording; or {_STATE_GYROS}",
        )
    return Nominal(1 / inverse, offset)


def _too_few_turns(turns: int, where: str) -> InputError:
    return input_error(
        f"the gyro scale cannot be estimated from {turns} rotations between poses",
        where,
        f"{LEAST_TURNS} or more rotations about all axes, or gyro_scale and gyro_offset",
        _STATE_GYROS,
    )


def _increments(rate: np.ndarray, time: np.ndarray, pairs: list[tuple[int, int, int]]) -> np.ndarray:
    """Return rate × time per sample interval of every rotation, shape (turns, longest, 3), padded with zeros."""
    longest = max(stop - start for _, start, stop in pairs)
    steps = np.zeros((len(pairs), longest, 3))
    for row, (_, start, stop) in enumerate(pairs):
        mean = 0.5 * (rate[start:stop] + rate[start + 1 : stop + 1])
        steps[row, : stop - start] = mean * np.diff(time[start : stop + 1])[:, None]
    return steps


def _mismatch(inverse: np.ndarray, turns: np.ndarray, before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Return propagated less observed direction of gravity for every rotation, shape (3·turns,)."""
    propagated = before[:, :, None]
    rotations = (
        scipy.spatial.transform.Rotation.from_rotvec(-(turns * inverse).reshape(-1, 3))
        .as_matrix()
        .reshape(*turns.shape, 3)
    )
    for step in range(turns.shape[1]):
        propagated = rotations[:, step] @ propagated
    return (propagated[:, :, 0] - after).ravel()


def _refine(inverse: np.ndarray, turns: np.ndarray, before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Return the scales after one Gauss–Newton step, with Huber weights against disturbed rotations."""
    base = _mismatch(inverse, turns, before, after)
    change = 1e-4 * np.abs(inverse)
    slopes = [
        (_mismatch(inverse + change * unit, turns, before, after) - base) / change[axis]
        for axis, unit in enumerate(np.eye(3))
    ]
    scatter = 1.4826 * np.median(np.abs(base)) + 1e-12
    root = np.sqrt(1 / np.maximum(1, np.abs(base) / (2 * scatter)))
    step = np.linalg.lstsq(root[:, None] * np.stack(slopes, axis=1), -root * base, rcond=None)[0]
    return inverse + np.clip(step, -0.2 * np.abs(inverse), 0.2 * np.abs(inverse))


_UNITS_OF_INPUT = {"accelerometers": ("m/s^2", "mg"), "gyros": ("rad/s", "deg/s")}  # of scales and biases
SIGNIFICANT = 5  # digits of an estimated scale


def nominal_of_counts(
    columns: Mapping[str, np.ndarray], options: ConvertOptions, gravity: float, notes: list[str], source: str
) -> dict[str, tuple[float, float]]:
    """Return channel → (scale, offset) of the channels in counts: given, or estimated from poses and rotations.

    Raises
    ------
    InputError
        if an estimate is needed and columns, poses or rotations are missing.
    """
    accel = _given(options.accel_unit, options.accel_scale, options.accel_offset)
    gyro = _given(options.gyro_unit, options.gyro_scale, options.gyro_offset)
    gyro = _by_turns(columns, options, notes, source) if gyro is None else gyro
    gyro = _by_table(columns, options, notes) if gyro is None else gyro
    if accel is None or gyro is None:
        accel, gyro = _estimated(columns, options, gravity, accel, gyro, notes, source)
    pairs = {}
    if options.accel_unit == "count":
        pairs |= {name: (accel.scale[i], accel.offset[i]) for i, name in enumerate(ACCELEROMETERS)}
    if options.gyro_unit == "count":
        pairs |= {name: (gyro.scale[i], gyro.offset[i]) for i, name in enumerate(GYROS)}
    return {name: (float(scale), float(offset)) for name, (scale, offset) in pairs.items() if name in columns}


def _by_turns(
    columns: Mapping[str, np.ndarray], options: ConvertOptions, notes: list[str], source: str
) -> Nominal | None:
    """Return the nominal calibration of gyros by turns through a stated angle; None if none is stated."""
    names = [name for name in GYROS if name in columns]
    if options.turn_deg is None or not names or TIME not in columns:
        return None
    scale, offset = counts_of_turns(columns, names, np.radians(options.turn_deg), source)
    places = [GYROS.index(name) for name in names]
    found = Nominal(np.full(3, scale.mean()), np.zeros(3))
    found.scale[places], found.offset[places] = scale, offset
    how = f"turns through {options.turn_deg:g} deg"
    gyro, note = _nominal("gyros", how, found, options.gyro_scale, options.gyro_offset)
    notes.append(note)
    return gyro


def _by_table(columns: Mapping[str, np.ndarray], options: ConvertOptions, notes: list[str]) -> Nominal | None:
    """Return the nominal calibration of gyros by the rate of the table; None if it is not recorded."""
    names = [name for name in GYROS if name in columns]
    if (known := counts_of_table(columns, names)) is None:
        return None
    found = Nominal(np.full(3, known[0]), np.zeros(3))
    found.offset[[GYROS.index(name) for name in names]] = known[1]
    gyro, note = _nominal("gyros", "the rate of the table", found, options.gyro_scale, options.gyro_offset)
    notes.append(note)
    return gyro


def _given(unit: str, scale: Sequence[float] | None, offset: Sequence[float] | None) -> Nominal | None:
    """Return the nominal calibration of the options, None if incomplete; a channel not in counts has scale 1."""
    if unit != "count":
        return Nominal(np.ones(3), np.zeros(3))
    if scale is None or offset is None:
        return None
    return Nominal(np.asarray(scale, dtype=float), np.asarray(offset, dtype=float))


def _estimated(
    columns: Mapping[str, np.ndarray],
    options: ConvertOptions,
    gravity: float,
    accel: Nominal | None,
    gyro: Nominal | None,
    notes: list[str],
    source: str,
) -> tuple[Nominal, Nominal]:
    force, rate = (_three(columns, names) for names in (ACCELEROMETERS, GYROS))
    if force is None or (gyro is None and rate is None):
        absent = ", ".join(name for name in SIX if name not in columns)
        raise input_error(
            f"the scale of counts cannot be estimated without {absent}",
            source,
            "three accelerometers, and three gyros where these are in counts; scale and offset of the datasheet; for "
            "gyros, turns through a known angle",
            "state the columns, the angle of the turns (--turn-deg 360), or --accel-scale, --accel-offset, --gyro-scale"
            " and --gyro-offset",
        )
    time = columns.get(TIME)
    poses = None if time is None else find_poses(force, float(np.median(np.diff(time))), options.initial_rest_s)
    means = force if poses is None else np.array([force[rest.start : rest.stop].mean(0) for rest in poses[0]])
    if accel is None:
        found = estimate_accelerometers(means.reshape(-1, 3), gravity, source)
        how = "the static poses, |f| = g"
        accel, note = _nominal("accelerometers", how, found, options.accel_scale, options.accel_offset)
        notes.append(note)
    if gyro is None:
        if rate is None or time is None or poses is None:
            raise _too_few_turns(0, source)
        level = (means - accel.offset) / accel.scale
        down = level / np.linalg.norm(level, axis=1, keepdims=True)
        found, how = (
            estimate_gyros(rate, down, time, *poses, source),
            "the initial rest and the rotations between poses",
        )
        gyro, note = _nominal("gyros", how, found, options.gyro_scale, options.gyro_offset)
        notes.append(note)
    return accel, gyro


def _three(columns: Mapping[str, np.ndarray], names: Sequence[str]) -> np.ndarray | None:
    """Return the three columns of a kind, shape (N, 3); None if one is missing."""
    return np.stack([columns[name] for name in names], axis=1) if all(name in columns for name in names) else None


def _nominal(
    what: str, how: str, found: Nominal, scale: Sequence[float] | None, offset: Sequence[float] | None
) -> tuple[Nominal, str]:
    """Return the rounded estimate, replaced by what was stated, and a note on both and on the bias in the offset."""
    nominal = Nominal(
        np.array([float(f"{value:.{SIGNIFICANT}g}") for value in (found.scale if scale is None else scale)]),
        np.round(found.offset if offset is None else np.asarray(offset, dtype=float), 1),
    )
    scales, offsets = (", ".join(f"{value:g}" for value in values) for values in (nominal.scale, nominal.offset))
    origin, other = (f"estimated from {how}" if given is None else "as stated" for given in (scale, offset))
    per, shown = _UNITS_OF_INPUT[what]
    said = f"nominal scale of the {what} {origin}: {scales} count per {per}; offset {other}: {offsets} count"
    if offset is not None:
        return nominal, said
    biases = ", ".join(f"{value:.3g}" for value in nominal.offset / nominal.scale / to_si(shown))
    return nominal, f"{said}, a bias of {biases} {shown}; the biases of a fit are in addition to it"
