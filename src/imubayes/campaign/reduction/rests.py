"""Rests of a unit in hand, by the variance of its accelerometers, and the poses that they make.

In a sliding window of about a second the
variance of each accelerometer is compared with its variance during the initial rest.  The largest ratio over the
channels is near 1 at rest and orders of magnitude larger in motion.  The threshold is chosen later, by how well |f| = g
holds in the poses found (Tedaldi, Pretto, Menegatti, ICRA 2014).  The accelerometers do not see a turn about the
vertical, and see the slow beginning of any other late: the gyros divide the interval at the one, and trim both ends for
the other.
"""

from dataclasses import dataclass

import numpy as np

from imubayes.foundations.numerics import true_stretches

WINDOW_SECONDS = 1.0
"""Length of the window in which the variance is compared with that at rest."""
LEAST_POSE_SECONDS = 0.8
QUIET_SHARE = 0.05  # this share of the windows, those of least variance, is assumed to be at rest
INITIAL_RATIO = 20.0  # variance ratio to the quietest windows at which the initial rest ends
TURNING_SECONDS = 0.1  # window in which the gyros distinguish turning from noise, of at least
TURNING_SAMPLES = 10
TURNING_RATIO = 3.0  # mean square of the rate, in medians over the rest, at which the unit turns
MOST_ROTATION = np.deg2rad(2.0)
"""Rotation within a window, by the gyros, from which on the unit was not still, rad."""
TURN = np.deg2rad(30.0)  # a rotation beyond is meant: what is before and after it are two poses
SAME_POSE = np.deg2rad(0.5)
SAME_POSE_GAP_SECONDS = 5.0
_LEAST_G, _MOST_G = 0.6, 1.6  # what bias and scale factor leave of g at rest; another unit is further away


@dataclass(frozen=True)
class Rest:
    """Consecutive samples at rest, `start` to `stop` (exclusive)."""

    start: int
    stop: int


@dataclass(frozen=True)
class Pose:
    """A static pose: one rest, or several in the same attitude interrupted by a shock."""

    rests: tuple[Rest, ...]

    @property
    def start(self) -> int:
        """First sample."""
        return self.rests[0].start

    @property
    def stop(self) -> int:
        """One past the last sample."""
        return self.rests[-1].stop

    def indices(self) -> np.ndarray:
        """Return the indices of the samples at rest."""
        return np.concatenate([np.arange(rest.start, rest.stop) for rest in self.rests])


def variance_ratio(force: np.ndarray, interval: float, initial: Rest | None) -> np.ndarray:
    """Return the variance about every sample relative to that at rest, shape (N,), the largest over the channels.

    Parameters
    ----------
    force : accelerometer samples, shape (N, C), any units.
    interval : sampling interval, s.
    initial : an interval known to be at rest; None to take the quietest windows of the recording.
    """
    half = window_half(interval)
    variance, rounding = windowed_variance(force, half), _rounding_variance(force)
    if initial is not None:
        inner = variance[initial.start + half : initial.stop - half]
        floor = (inner if len(inner) else variance[initial.start : initial.stop]).mean(0)
    else:
        usual = np.maximum(np.median(variance, axis=0), rounding)
        order = np.argsort(np.max(variance / usual, axis=1))
        floor = np.median(variance[order[: max(1, int(QUIET_SHARE * len(order)))]], axis=0)
    return np.max(variance / np.maximum(floor, rounding), axis=1)


def _rounding_variance(readings: np.ndarray) -> np.ndarray:
    """Return the variance of rounding to the step of each channel, (C,): at rest a coarse unit reads one value."""
    steps = [np.min(np.diff(np.unique(column)), initial=np.inf) for column in readings.T]
    rounding = np.array([step**2 / 12 if np.isfinite(step) else 0.0 for step in steps])
    return np.maximum(rounding, 1e-12 * np.var(readings, axis=0) + 1e-300)


def windowed_variance(readings: np.ndarray, half: int) -> np.ndarray:
    """Return the variance in a window of 2·half + 1 samples about every sample, (N, C) → (N, C) (edges repeated)."""
    width = 2 * half + 1
    padded = np.pad(readings - readings.mean(0), ((half, half), (0, 0)), mode="edge")
    zero = np.zeros((1, readings.shape[1]))
    total, square = (np.concatenate([zero, np.cumsum(p, axis=0)]) for p in (padded, padded**2))
    mean = (total[width:] - total[:-width]) / width
    return np.maximum((square[width:] - square[:-width]) / width - mean**2, 0.0)


def find_rests(quiet: np.ndarray, interval: float) -> list[Rest]:
    """Return the intervals where `quiet` holds for at least `LEAST_POSE_SECONDS`.

    The sliding window keeps every rest half a window away from motion.
    """
    least = round(LEAST_POSE_SECONDS / interval)
    return [Rest(a, b) for a, b in true_stretches(quiet).tolist() if b - a >= least]


def turning(rate: np.ndarray, interval: float) -> np.ndarray:
    """Return where the unit turns on purpose, by more than `TURN`, about any axis, shape (N,).

    Parameters
    ----------
    rate : in body axes, bias removed, shape (N, 3), rad/s.
    interval : sampling interval, s.
    """
    half = window_half(interval)
    total = np.cumsum(np.pad(rate * interval, ((half + 1, half), (0, 0)), mode="edge"), axis=0)
    moving = np.linalg.norm(total[2 * half + 1 :] - total[: -2 * half - 1], axis=1) > MOST_ROTATION
    turns = np.zeros(len(rate), dtype=bool)
    for start, stop in true_stretches(moving):
        turns[start:stop] = np.linalg.norm(np.cumsum(rate[start:stop], axis=0), axis=1).max() * interval > TURN
    return turns


def divide_rests(rests: list[Rest], turns: np.ndarray, interval: float) -> list[Rest]:
    """Return the rests without turns that the accelerometers do not see, and without half a window beside these.

    A turn at the ends of a rest, within half a window, is left to `trim_rests`.
    """
    half = window_half(interval)
    beside = np.convolve(turns, np.ones(2 * half + 1), mode="same") > 0.5
    divided = []
    for rest in rests:
        if turns[rest.start + half : rest.stop - half].any():
            parts = find_rests(~beside[rest.start : rest.stop], interval)
            divided += [Rest(rest.start + part.start, rest.start + part.stop) for part in parts]
        else:
            divided.append(rest)
    return divided


def trim_rests(rests: list[Rest], rate: np.ndarray, interval: float) -> list[Rest]:
    """Return the rests without the beginning and the end of turns, which the gyros see before the accelerometers.

    From either end samples are dropped up to the first window whose mean square rate, about the median of the rest, is
    that of the rest, and this window with them: a turn that begins smoothly is hidden by the noise at first.  A turn
    reaches half a window of the accelerometers' variance into a rest at most.  A rest that turns further inside was
    disturbed: it is returned whole, to be flagged by its rotation.

    Parameters
    ----------
    rate : gyro samples, shape (N, C), any units.
    interval : sampling interval, s.
    """
    width = max(TURNING_SAMPLES, round(TURNING_SECONDS / interval))
    least = round(LEAST_POSE_SECONDS / interval)
    trimmed = []
    for rest in rests:
        square = np.sum((rate[rest.start : rest.stop] - np.median(rate[rest.start : rest.stop], axis=0)) ** 2, axis=1)
        if len(square) < 2 * width:
            trimmed.append(rest)
            continue
        total = np.concatenate([[0.0], np.cumsum(square)])
        power = total[width:] - total[:-width]
        still = np.flatnonzero(power <= TURNING_RATIO * np.median(power))
        first, last = still[0], still[-1] + width
        if max(first, len(square) - last) > window_half(interval):
            trimmed.append(rest)
            continue
        start = rest.start + first + (width if first else 0)
        stop = rest.start + last - (width if last < len(square) else 0)
        if stop - start >= least:
            trimmed.append(Rest(int(start), int(stop)))
    return trimmed


def join_rests(rests: list[Rest], force: np.ndarray, interval: float, turns: np.ndarray) -> list[Pose]:
    """Return the poses; consecutive rests in the same attitude, a short interval without a turn between, are one."""
    poses: list[Pose] = []
    for rest in rests:
        between = slice(poses[-1].stop, rest.start) if poses else slice(0)
        if poses and not turns[between].any() and _same_attitude(poses[-1].rests[-1], rest, force, interval):
            poses[-1] = Pose((*poses[-1].rests, rest))
        else:
            poses.append(Pose((rest,)))
    return poses


def initial_rest(force: np.ndarray, interval: float, seconds: float | None) -> Rest:
    """Return the initial rest: of the stated length, or until the variance rises."""
    if seconds is not None:
        return Rest(0, max(2, min(len(force), round(seconds / interval))))
    loud = variance_ratio(force, interval, None) > INITIAL_RATIO
    begin = int(np.argmin(loud))
    after = np.flatnonzero(loud[begin:])
    return Rest(begin, begin + int(after[0]) if len(after) else len(force))


def window_half(interval: float) -> int:
    """Return half the width of the window, samples."""
    return max(2, round(WINDOW_SECONDS / interval / 2))


def _same_attitude(before: Rest, after: Rest, force: np.ndarray, interval: float) -> bool:
    if (after.start - before.stop) * interval > SAME_POSE_GAP_SECONDS:
        return False
    first, second = force[before.start : before.stop].mean(0), force[after.start : after.stop].mean(0)
    return bool(np.linalg.norm(first - second) < SAME_POSE * np.linalg.norm(first))


def reads_gravity(size: float, gravity: float) -> bool:
    """Return whether a specific force at rest is gravity in the same unit, but for bias and scale factor."""
    return bool(_LEAST_G < size / gravity < _MOST_G)
