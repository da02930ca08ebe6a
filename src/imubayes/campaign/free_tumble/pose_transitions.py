"""The motion between poses, condensed to steps of mean rate and coning correction.

A rotation is not the integral of its rate.  The part that averaging over a step neglects (coning) is computed from all
samples with the nominal calibration; it is so small that the error of that calibration is negligible.  The fit then
needs a step of a tenth of a second instead of every sample.
"""

import functools
from collections.abc import Sequence

import numpy as np
import scipy  # loads its parts when they are first used

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
