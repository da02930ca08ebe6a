"""The procedure of a unit that nobody put on a table, and the unit of its gyros, by how it moves.

A unit that rests in four attitudes and more is a free tumble.  One that is hardly ever at rest turns about one axis of
its body (`free_rotation`), or about all (`slow_motion`); accelerometers alone are in slow motion.
"""

from collections.abc import Mapping

import numpy as np

from imubayes.procedures.carried import LEAST_SECONDS, about_one_axis
from imubayes_recordings.convert.column_names import ACCELEROMETERS, GYROS, TIME

ONE_AXIS = "free_rotation"
_BLOCK_SECONDS, _PARTS = 0.8, 5
_STEADY = 0.015  # scatter of the parts of a block at rest, of |f|
_SAME = 0.1  # of |f|: between attitudes
_POSES = 4
_MOVING_SHARE = 0.6
_FOLLOWS = 0.7  # correlation of the change of the force with what the gyros make of it


def procedure_in_motion(columns: Mapping[str, np.ndarray], rates: np.ndarray) -> tuple[str, str]:
    """Return the procedure of a unit that moves, and why; by default `free_tumble`, without evidence.

    Parameters
    ----------
    columns : target → values, shape (N,).
    rates : what the gyros measure at their nominal scale, rad/s, shape (N, G).
    """
    if not all(name in columns for name in (*ACCELEROMETERS, TIME)) or len(columns[TIME]) < 100:
        return "free_tumble", ""
    force = np.stack([columns[name] for name in ACCELEROMETERS], axis=1)
    used = np.isfinite(force).all(axis=1) & np.isfinite(rates).all(axis=1)
    force, rates, time = force[used], rates[used], columns[TIME][used]
    if len(time) < 100 or not time[-1] > time[0]:
        return "free_tumble", ""
    interval = float(np.median(np.diff(time)))
    poses, moving = _poses(force, interval)
    seconds = moving * len(time) * interval
    if poses >= _POSES or moving < _MOVING_SHARE or seconds < LEAST_SECONDS:
        return "free_tumble", ""
    if not all(name in columns for name in GYROS):
        return "slow_motion", f"{seconds:.3g} s of motion without rest, no gyros about three axes: windows of |f| = g"
    if about_one_axis(rates):
        axis = np.linalg.eigh(rates.T @ rates)[1][:, -1]
        axis = axis * np.sign(axis[np.argmax(np.abs(axis))])
        named = ", ".join(f"{part:.2f}" for part in axis + 0.0)
        return ONE_AXIS, f"{seconds:.3g} s of rotation without rest about one axis of the body, ({named})"
    return "slow_motion", f"{seconds:.3g} s of motion about all axes without rest"


def _poses(force: np.ndarray, interval: float) -> tuple[int, float]:
    """Return how many attitudes a unit rests in, and the share of the blocks in which it moves."""
    size = max(_PARTS, round(_BLOCK_SECONDS / interval) // _PARTS * _PARTS)
    count = len(force) // size
    if not count:
        return 0, 0.0
    parts = force[: count * size].reshape(count, _PARTS, size // _PARTS, 3).mean(axis=2)
    gravity = float(np.median(np.linalg.norm(force, axis=1)))
    still = np.linalg.norm(parts.std(axis=1), axis=1) < _STEADY * gravity
    poses, last, before = 0, None, False
    for mean, rests in zip(parts.mean(axis=1), still, strict=True):
        if rests and (last is None or np.linalg.norm(mean - last) > _SAME * gravity):
            poses += not before or last is None
            last = mean
        before = bool(rests)
    return poses, float(1 - still.mean())


def per_radian_in_motion(columns: Mapping[str, np.ndarray]) -> float:
    """Return what the gyros read for one radian, from a unit in motion; 0 if its force does not follow them.

    Gravity turns in body axes by −ω × f.  The change of the mean force from one tenth of a second to the next is
    regressed on that: the jerk of the hand is noise of the dependent variable.
    """
    time = columns[TIME]
    size = max(1, round(0.1 / float(np.median(np.diff(time)))))
    count = len(time) // size
    if count < LEAST_SECONDS / 0.12:  # a log that may be reduced
        return 0.0
    force, rate = (
        np.stack([columns[name] for name in names], axis=1)[: count * size].reshape(count, size, 3).mean(axis=1)
        for names in (ACCELEROMETERS, GYROS)
    )
    seconds = time[: count * size].reshape(count, size).mean(axis=1)
    change = (force[2:] - force[:-2]) / (seconds[2:] - seconds[:-2])[:, None]
    expected = -np.cross(rate, force)[1:-1]
    both, alone = float(np.sum(change * expected)), float(np.sum(expected**2))
    if not alone > 0 or both < _FOLLOWS * np.sqrt(alone * float(np.sum(change**2))):
        return 0.0
    return alone / both
