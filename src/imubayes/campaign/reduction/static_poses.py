"""Static poses of a hand-held unit by the variance of its accelerometers, and the motion between poses.

The raw log is converted to vectors in body axes by the nominal calibration.  In a sliding window of about a second the
variance of each accelerometer is compared with its variance during the initial rest.  The largest ratio over the
channels is near 1 at rest and orders of magnitude larger in motion.  The threshold is chosen later, by how well |f| = g
holds in the poses found (Tedaldi, Pretto, Menegatti, ICRA 2014).  The accelerometers do not see a turn about the
vertical, and see the slow beginning of any other late: the gyros divide the interval at the one, and trim both ends for
the other.

The motion between poses is condensed to steps of mean rate and coning correction.  A rotation is not the integral of
its rate.  The part that averaging over a step neglects (coning) is computed from all samples with the nominal
calibration; it is so small that the error of that calibration is negligible.  The fit then needs a step of a tenth of a
second instead of every sample.
"""

import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy  # loads its parts when they are first used

from imubayes.campaign.reduction.log_survey import refuse_impossible_rate
from imubayes.foundations.campaign_data import Channel
from imubayes.foundations.errors import input_error
from imubayes.foundations.numerics import true_stretches

STEP_SECONDS = 0.1
STEP_ANGLE = 0.15  # rad; faster motion gets shorter steps


def step_edges(time: np.ndarray, rate: np.ndarray, start: int, stop: int) -> np.ndarray:
    """Return the sample indices that bound the steps from sample `start` to sample `stop`, shape (K + 1,)."""
    duration = np.diff(time[start : stop + 1])
    speed = np.linalg.norm(rate[start : stop + 1], axis=1)
    angle = 0.5 * (speed[1:] + speed[:-1]) * duration
    due = np.cumsum(np.maximum(duration / STEP_SECONDS, angle / STEP_ANGLE))
    count = min(max(1, int(np.ceil(due[-1]))), len(due))
    number = np.minimum((due * count / due[-1] - 1e-9).astype(int), count - 1)
    inner = np.flatnonzero(np.diff(number)) + 1
    return start + np.concatenate([[0], inner, [len(due)]])


def step_means(time: np.ndarray, readings: np.ndarray, edges: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the duration of every step, shape (K,), s, and the trapezoidal means over it, shape (K, C)."""
    time, readings, edges = _only(time, readings, edges)
    duration = np.diff(time)[:, None]
    area = 0.5 * (readings[1:] + readings[:-1]) * duration
    total = np.concatenate([np.zeros((1, readings.shape[1])), np.cumsum(area, axis=0)])
    length = time[edges[1:]] - time[edges[:-1]]
    return length, (total[edges[1:]] - total[edges[:-1]]) / length[:, None]


def coning(time: np.ndarray, rate: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Return each step's rotation vector less its mean rate times its duration, shape (K, 3), rad.

    The rate is interpolated linearly between samples; the rotation vector of such an interval is
    ½(ω₀ + ω₁) dt + (ω₀ × ω₁) dt² / 12.
    """
    time, rate, edges = _only(time, rate, edges)
    duration = np.diff(time)[:, None]
    small = 0.5 * (rate[1:] + rate[:-1]) * duration + np.cross(rate[:-1], rate[1:]) * duration**2 / 12
    counts = np.diff(edges)
    rotation = scipy.spatial.transform.Rotation.identity(len(counts))
    for offset in range(int(counts.max())):
        active = offset < counts
        index = np.minimum(edges[:-1] + offset, len(small) - 1)
        rotation = rotation * scipy.spatial.transform.Rotation.from_rotvec(np.where(active[:, None], small[index], 0.0))
    _, mean = step_means(time, rate, edges)
    return rotation.as_rotvec() - mean * (time[edges[1:]] - time[edges[:-1]])[:, None]


def rotation_over(mean_rate: np.ndarray, length: np.ndarray, correction: np.ndarray) -> np.ndarray:
    """Return the body rotation over all steps together, C_before⁻¹ C_after, shape (3, 3)."""
    steps = scipy.spatial.transform.Rotation.from_rotvec(mean_rate * length[:, None] + correction).as_matrix()
    return functools.reduce(np.matmul, steps, np.eye(3))


def _only(time: np.ndarray, values: np.ndarray, edges: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the samples from the first to the last edge, and the edges relative to the first."""
    inside = slice(edges[0], edges[-1] + 1)
    return time[inside], values[inside], edges - edges[0]


def padded(parts: Sequence[np.ndarray]) -> np.ndarray:
    """Return arrays of different length stacked along a new first axis, padded with zeros."""
    longest = max((len(part) for part in parts), default=0)
    shape = (len(parts), longest, *(parts[0].shape[1:] if parts else ()))
    stacked = np.zeros(shape)
    for index, part in enumerate(parts):
        stacked[index, : len(part)] = part
    return stacked


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
LEAST_G, MOST_G = 0.6, 1.6
"""What bias and scale factor leave of g at rest; another unit is further away."""


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


LEAST_ROWS = 100
BLOCKS = 8


@dataclass(frozen=True)
class Recording:
    """A raw log with nominal calibration.

    Attributes
    ----------
    time : shape (N,), s.
    readings : raw samples of all channels, shape (N, C), output units.
    force, rate : in body axes, shape (N, 3), m/s² and rad/s; the rate less its initial mean.
    initial : the initial rest.
    interval : sampling interval, s.
    turns : whether there are gyros about three axes, whose rates integrate to the turns between poses; else rate is 0.
    """

    time: np.ndarray
    readings: np.ndarray
    force: np.ndarray
    rate: np.ndarray
    initial: Rest
    interval: float
    turns: bool = True


def record(
    numbers: Mapping[str, np.ndarray], channels: Sequence[Channel], initial_seconds: float | None, file: str
) -> Recording:
    """Return the log with nominal calibration, gyro bias removed.

    Parameters
    ----------
    numbers : column → shape (N,), in the units of the file.
    initial_seconds : length of the initial rest, if stated.
    file : named in errors.

    Raises
    ------
    InputError
        if the log is too short, or the accelerometers do not span three dimensions.
    """
    time = numbers["time_s"]
    readings = np.stack([numbers.get(c.name, np.full(len(time), np.nan)) for c in channels], axis=1)
    if len(time) < LEAST_ROWS or (used := np.isfinite(readings).all(axis=1)).sum() < LEAST_ROWS:
        what = f"the recording has fewer than {LEAST_ROWS} complete rows"
        raise input_error(what, file, "a raw log", "record for longer")
    time, readings = time[used], readings[used]
    force, rate = body_vectors(readings, channels, file)
    turns = spans_space(channels, "gyro")
    interval = float(np.median(np.diff(time)))
    refuse_impossible_rate(interval, file)
    initial = initial_rest(force, interval, initial_seconds)
    if initial_seconds is None and turns:
        # The accelerometers do not see a first turn about the vertical.
        first = rate[initial.start : initial.start + round(LEAST_POSE_SECONDS / interval)].mean(0)
        initial = next(iter(divide_rests([initial], turning(rate - first, interval), interval)), initial)
    return Recording(time, readings, force, rate - initial_mean(rate, initial), initial, interval, turns)


def pose_means(values: np.ndarray, poses: Sequence[Pose]) -> np.ndarray:
    """Return the mean over each pose, shape (poses, …)."""
    return np.array([values[pose.indices()].mean(0) for pose in poses]).reshape(len(poses), *values.shape[1:])


def magnitude_scatter(force: np.ndarray, poses: Sequence[Pose]) -> np.ndarray:
    """Return the standard deviation of the mean |force| of each pose by the scatter within all of them, (poses,).

    It is that of the means of blocks, which slow noise does not average out of, and of the typical pose.
    """
    counts = np.array([len(pose.indices()) for pose in poses])
    norms = [np.linalg.norm(force[pose.indices()], axis=1) for pose in poses]
    parts = [np.array_split(norm, min(BLOCKS, len(norm))) for norm in norms if len(norm) > 1]
    single = [
        np.std([part.mean() for part in blocks], ddof=1) * np.sqrt(sum(map(len, blocks)) / len(blocks))
        for blocks in parts
    ]
    return (np.median(single) if single else 0.0) / np.sqrt(counts)


def initial_mean(rate: np.ndarray, initial: Rest) -> np.ndarray:
    """Return the mean rate in the initial rest, shape (3,): the gyro bias."""
    return rate[initial.start : initial.stop].mean(0)


def rotation_between(recording: Recording, edges: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the rotation from the first to the last edge, body after → body before, (3, 3), and its coning (K, 3)."""
    length, rate = step_means(recording.time, recording.rate, edges)
    correction = coning(recording.time, recording.rate, edges)
    return rotation_over(rate, length, correction), correction


GAP_SECONDS = 0.05  # of a smooth turn of two seconds, what interpolation over so much loses is below 0.1 mrad
_GAP_INTERVALS = 3.0
_SIDE = 5  # samples on either side of a cut
_JUMP = np.deg2rad(10.0)  # of the direction of f over a cut
_STEADY = 0.2  # of the jump: scatter of a side; a turn through the same angle would have 0.4
_SEEN = 0.1  # share of a jump that the gyros see at least, if the unit turned


def broken_turn(recording: Recording, start: int, stop: int) -> str:
    """Return why the gyros do not show the turn from one sample to another in full; empty if they do.

    Samples may be missing in it, or the turn itself may have been cut out of the recording: the direction of f jumps
    between two samples, and the gyros see nothing of it.
    """
    step = np.diff(recording.time[start : stop + 1])
    if step.max(initial=0.0) > max(GAP_SECONDS, _GAP_INTERVALS * recording.interval):
        return f"{step.max():.3g} s are missing in it"
    part = slice(max(0, start - _SIDE), stop + _SIDE)
    sides = np.lib.stride_tricks.sliding_window_view(recording.force[part], _SIDE, axis=0)
    mean = sides.mean(axis=2)
    scatter = np.linalg.norm(sides - mean[:, :, None], axis=1).max(axis=1)
    first, second = mean[:-_SIDE], mean[_SIDE:]
    sudden = np.maximum(scatter[:-_SIDE], scatter[_SIDE:]) < _STEADY * np.linalg.norm(second - first, axis=1)
    jump = angle_between(first, second)
    path = np.cumsum(np.linalg.norm(recording.rate[part], axis=1)) * recording.interval
    seen = path[2 * _SIDE - 1 :] - path[: len(path) - 2 * _SIDE + 1]
    cut = sudden & (jump > _JUMP) & (seen < _SEEN * jump)
    return "the attitude jumps from one sample to the next" if cut.any() else ""


def angle_between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the angle between vectors, shape (…, 3) → (…), rad."""
    cosine = np.sum(a * b, axis=-1) / np.linalg.norm(a, axis=-1) / np.linalg.norm(b, axis=-1)
    return np.asarray(np.arccos(np.clip(cosine, -1.0, 1.0)))


def body_vectors(readings: np.ndarray, channels: Sequence[Channel], file: str) -> tuple[np.ndarray, np.ndarray]:
    """Return nominal force and rate in body axes, (N, 3) each; no rate if the gyros do not span three dimensions."""
    signal = (readings - [c.offset for c in channels]) / [c.scale_si for c in channels]
    if not spans_space(channels, "accelerometer"):
        raise input_error(
            "a free tumble needs three accelerometers in different directions",
            f"{file}, [[channel]] of campaign.toml",
            "three or more accelerometer channels whose input axes are not coplanar",
            "add the missing channels, or choose another procedure",
        )
    force = _body(signal, channels, "accelerometer")
    return force, _body(signal, channels, "gyro") if spans_space(channels, "gyro") else np.zeros_like(force)


def spans_space(channels: Sequence[Channel], kind: str) -> bool:
    """Return whether the input axes of the channels of one kind are not coplanar."""
    axes = [channel.axes[0] for channel in channels if channel.kind == kind]
    return len(axes) > 2 and int(np.linalg.matrix_rank(np.array(axes), tol=1e-3)) == 3


def _body(signal: np.ndarray, channels: Sequence[Channel], kind: str) -> np.ndarray:
    """Return the least-squares body vector of the channels of one kind, shape (N, 3)."""
    index = [i for i, channel in enumerate(channels) if channel.kind == kind]
    return signal[:, index] @ np.linalg.pinv(np.array([channels[i].axes[0] for i in index])).T
