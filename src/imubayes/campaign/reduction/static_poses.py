"""The log of a hand-held unit: means of its poses at rest (`rests`), and the motion between them.

The raw log is converted to vectors in body axes by the nominal calibration.

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

from imubayes.campaign.reduction.rests import LEAST_POSE_SECONDS, Pose, Rest, divide_rests, initial_rest, turning
from imubayes.campaign.sampling_rate import refuse_impossible_rate
from imubayes.foundations.body_axes import body_vector, spans_space
from imubayes.foundations.campaign_data import Channel
from imubayes.foundations.errors import input_error
from imubayes.foundations.numerics import angle_between

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


def body_vectors(readings: np.ndarray, channels: Sequence[Channel], file: str) -> tuple[np.ndarray, np.ndarray]:
    """Return nominal force and rate in body axes, (N, 3) each; no rate if the gyros do not span three dimensions."""
    if not spans_space(channels, "accelerometer"):
        raise input_error(
            "a free tumble needs three accelerometers in different directions",
            f"{file}, [[channel]] of campaign.toml",
            "three or more accelerometer channels whose input axes are not coplanar",
            "add the missing channels, or choose another procedure",
        )
    force = body_vector(readings, channels, "accelerometer")
    return force, body_vector(readings, channels, "gyro") if spans_space(channels, "gyro") else np.zeros_like(force)
