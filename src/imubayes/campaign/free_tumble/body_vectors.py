"""The raw log of a hand-held unit with nominal calibration, as vectors in body axes."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from imubayes.campaign.free_tumble.pose_transitions import coning, mean_readings, rotation_over
from imubayes.campaign.free_tumble.static_detection import Pose, Rest, initial_rest
from imubayes.errors import InputError, Issue
from imubayes.run import Channel


@dataclass(frozen=True)
class Recording:
    """A raw log with nominal calibration: time (N,), readings (N, C), force and rate in body axes (N, 3)."""

    time: np.ndarray
    readings: np.ndarray
    force: np.ndarray
    rate: np.ndarray
    initial: Rest
    interval: float


def record(
    numbers: Mapping[str, np.ndarray], channels: Sequence[Channel], initial_seconds: float | None, file: Path
) -> Recording:
    """Return the log with nominal calibration; gyro bias from the rest at the beginning."""
    time = numbers["time_s"]
    readings = np.stack([numbers.get(c.name, np.full(len(time), np.nan)) for c in channels], axis=1)
    if len(time) < 100 or (used := np.isfinite(readings).all(axis=1)).sum() < 100:
        raise InputError(
            Issue("the recording has fewer than 100 complete rows", str(file), "a raw log", "record for longer")
        )
    time, readings = time[used], readings[used]
    force, rate = body_vectors(readings, channels, file)
    interval = float(np.median(np.diff(time)))
    initial = initial_rest(force, interval, initial_seconds)
    return Recording(time, readings, force, rate - initial_mean(rate, initial), initial, interval)


def pose_means(values: np.ndarray, poses: Sequence[Pose]) -> np.ndarray:
    """Return the mean over each pose, shape (poses, …)."""
    return np.array([values[pose.indices()].mean(0) for pose in poses]).reshape(len(poses), *values.shape[1:])


def initial_mean(rate: np.ndarray, initial: Rest) -> np.ndarray:
    """Return the mean rate in the rest at the beginning: the gyros' bias, shape (3,)."""
    return rate[initial.start : initial.stop].mean(0)


def turned_over(recording: Recording, edges: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the rotation over the steps between edges, body after → body before, and its coning correction."""
    length, rate = mean_readings(recording.time, recording.rate, edges)
    correction = coning(recording.time, recording.rate, edges)
    return rotation_over(rate, length, correction), correction


def body_vectors(
    readings: np.ndarray, channels: Sequence[Channel], file: Path, sign: np.ndarray | float = 1.0
) -> tuple[np.ndarray, np.ndarray]:
    """Return force and rate in body axes by nominal numbers, (N, 3) each; `sign` is −1 for reversed channels, (C,)."""
    signal = sign * (readings - [c.offset for c in channels]) / [c.scale_si for c in channels]
    return _body(signal, channels, "accelerometer", file), _body(signal, channels, "gyro", file)


def _body(signal: np.ndarray, channels: Sequence[Channel], kind: str, file: Path) -> np.ndarray:
    """Return the body vector that channels of one kind measure together, shape (N, 3)."""
    index = [i for i, channel in enumerate(channels) if channel.kind == kind]
    axes = np.array([channels[i].axes[0] for i in index]).reshape(len(index), 3)
    if np.linalg.matrix_rank(axes, tol=1e-3) < 3:
        raise InputError(
            Issue(
                f"a free tumble needs three {kind}s in different directions",
                f"{file}, [[channel]] of campaign.toml",
                f"three or more {kind} channels whose input axes are not in one plane",
                "complete the channels, or choose another procedure",
            )
        )
    return signal[:, index] @ np.linalg.pinv(axes).T
