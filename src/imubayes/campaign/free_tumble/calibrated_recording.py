"""The raw log of a hand-held unit as vectors in body axes, by the nominal calibration."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from imubayes.campaign.free_tumble.pose_transitions import coning, rotation_over, step_means
from imubayes.campaign.free_tumble.static_detection import (
    LEAST_POSE_SECONDS,
    Pose,
    Rest,
    divide_rests,
    initial_rest,
    turning,
)
from imubayes.campaign_data import Channel
from imubayes.errors import input_error

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
    """

    time: np.ndarray
    readings: np.ndarray
    force: np.ndarray
    rate: np.ndarray
    initial: Rest
    interval: float


def record(
    numbers: Mapping[str, np.ndarray], channels: Sequence[Channel], initial_seconds: float | None, file: Path
) -> Recording:
    """Return the log with nominal calibration, gyro bias removed.

    Parameters
    ----------
    numbers : column → shape (N,), in the units of the file.
    initial_seconds : length of the initial rest, where stated.
    file : named in errors.

    Raises
    ------
    InputError
        if the log is too short, or accelerometers or gyros do not span three dimensions.
    """
    time = numbers["time_s"]
    readings = np.stack([numbers.get(c.name, np.full(len(time), np.nan)) for c in channels], axis=1)
    if len(time) < LEAST_ROWS or (used := np.isfinite(readings).all(axis=1)).sum() < LEAST_ROWS:
        what = f"the recording has fewer than {LEAST_ROWS} complete rows"
        raise input_error(what, str(file), "a raw log", "record for longer")
    time, readings = time[used], readings[used]
    force, rate = body_vectors(readings, channels, file)
    interval = float(np.median(np.diff(time)))
    initial = initial_rest(force, interval, initial_seconds)
    if initial_seconds is None:
        # The accelerometers do not see a first turn about the vertical.
        first = rate[initial.start : initial.start + round(LEAST_POSE_SECONDS / interval)].mean(0)
        initial = next(iter(divide_rests([initial], turning(rate - first, interval), interval)), initial)
    return Recording(time, readings, force, rate - initial_mean(rate, initial), initial, interval)


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


def angle_between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the angle between vectors, shape (…, 3) → (…), rad."""
    cosine = np.sum(a * b, axis=-1) / np.linalg.norm(a, axis=-1) / np.linalg.norm(b, axis=-1)
    return np.asarray(np.arccos(np.clip(cosine, -1.0, 1.0)))


def body_vectors(
    readings: np.ndarray, channels: Sequence[Channel], file: Path, sign: np.ndarray | float = 1.0
) -> tuple[np.ndarray, np.ndarray]:
    """Return nominal force and rate in body axes, (N, 3) each; `sign`, shape (C,), is −1 for a reversed channel."""
    signal = sign * (readings - [c.offset for c in channels]) / [c.scale_si for c in channels]
    return _body(signal, channels, "accelerometer", file), _body(signal, channels, "gyro", file)


def _body(signal: np.ndarray, channels: Sequence[Channel], kind: str, file: Path) -> np.ndarray:
    """Return the least-squares body vector of the channels of one kind, shape (N, 3)."""
    index = [i for i, channel in enumerate(channels) if channel.kind == kind]
    axes = np.array([channels[i].axes[0] for i in index]).reshape(len(index), 3)
    if np.linalg.matrix_rank(axes, tol=1e-3) < 3:
        raise input_error(
            f"a free tumble needs three {kind}s in different directions",
            f"{file}, [[channel]] of campaign.toml",
            f"three or more {kind} channels whose input axes are not coplanar",
            "add the missing channels, or choose another procedure",
        )
    return signal[:, index] @ np.linalg.pinv(axes).T
