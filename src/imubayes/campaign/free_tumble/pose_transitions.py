"""The motion between poses, cut into steps over which the mean rate and a small correction say everything.

A rotation is not the integral of its rate: what averaging over a step leaves out (coning) is computed from all
samples with the nominal calibration, and is so small that the error of that calibration does not matter in it.
The fit then needs a step of a tenth of a second instead of every sample.
"""

from collections.abc import Sequence

import numpy as np

from imubayes.campaign.free_tumble.rotation import exponential, logarithm

STEP_SECONDS = 0.1
STEP_ANGLE = 0.15  # rad; faster motion gets shorter steps


def step_edges(time: np.ndarray, rate: np.ndarray, start: int, stop: int) -> np.ndarray:
    """Return the sample indices at which the steps from sample `start` to sample `stop` begin and end."""
    duration = np.diff(time[start : stop + 1])
    speed = np.linalg.norm(rate[start : stop + 1], axis=1)
    angle = 0.5 * (speed[1:] + speed[:-1]) * duration
    due = np.cumsum(np.maximum(duration / STEP_SECONDS, angle / STEP_ANGLE))
    count = min(max(1, int(np.ceil(due[-1]))), len(due))
    number = np.minimum((due * count / due[-1] - 1e-9).astype(int), count - 1)
    inner = np.flatnonzero(np.diff(number)) + 1
    return start + np.concatenate([[0], inner, [len(due)]])


def mean_readings(time: np.ndarray, readings: np.ndarray, edges: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the length of every step in s, and the trapezoidal mean of the readings over it, shape (K, C)."""
    time, readings, edges = _only(time, readings, edges)
    duration = np.diff(time)[:, None]
    area = 0.5 * (readings[1:] + readings[:-1]) * duration
    total = np.concatenate([np.zeros((1, readings.shape[1])), np.cumsum(area, axis=0)])
    length = time[edges[1:]] - time[edges[:-1]]
    return length, (total[edges[1:]] - total[edges[:-1]]) / length[:, None]


def coning(time: np.ndarray, rate: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Return each step's rotation vector less its mean rate times its length, shape (K, 3), rad.

    Between two samples the rate is taken as a straight line, whose rotation vector is
    ½(ω₀ + ω₁) dt + (ω₀ × ω₁) dt² / 12.
    """
    time, rate, edges = _only(time, rate, edges)
    duration = np.diff(time)[:, None]
    small = 0.5 * (rate[1:] + rate[:-1]) * duration + np.cross(rate[:-1], rate[1:]) * duration**2 / 12
    counts = np.diff(edges)
    rotation = np.broadcast_to(np.eye(3), (len(counts), 3, 3))
    for offset in range(int(counts.max())):
        active = offset < counts
        index = np.minimum(edges[:-1] + offset, len(small) - 1)
        rotation = rotation @ exponential(np.where(active[:, None], small[index], 0.0))
    _, mean = mean_readings(time, rate, edges)
    return logarithm(rotation) - mean * (time[edges[1:]] - time[edges[:-1]])[:, None]


def rotation_over(mean_rate: np.ndarray, length: np.ndarray, correction: np.ndarray) -> np.ndarray:
    """Return the body rotation over all steps together, C_before⁻¹ C_after, shape (3, 3)."""
    total = np.eye(3)
    for turn in exponential(mean_rate * length[:, None] + correction):
        total = total @ turn
    return total


def _only(time: np.ndarray, values: np.ndarray, edges: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the samples from the first edge to the last, and the edges counted from there."""
    inside = slice(edges[0], edges[-1] + 1)
    return time[inside], values[inside], edges - edges[0]


def padded(parts: Sequence[np.ndarray]) -> np.ndarray:
    """Stack arrays of different length along a new first axis, zeros behind the shorter ones."""
    longest = max((len(part) for part in parts), default=0)
    shape = (len(parts), longest, *(parts[0].shape[1:] if parts else ()))
    stacked = np.zeros(shape)
    for index, part in enumerate(parts):
        stacked[index, : len(part)] = part
    return stacked
