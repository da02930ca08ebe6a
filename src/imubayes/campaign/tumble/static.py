"""When a hand-held unit was at rest: intervals in which no channel scatters more than it does at rest.

In every window of about a second the variance of each channel is compared with its own variance at rest (the
beginning of the recording).  The largest ratio over the channels, the *unrest*, is near 1 at rest and orders
of magnitude more while the unit is moved, and it has no units, so it serves accelerometers and gyros, counts
and m/s² alike.  Which multiple separates the two is decided later, by how well |f| = g comes out (Tedaldi,
Pretto, Menegatti, ICRA 2014).
"""

from dataclasses import dataclass

import numpy as np

WINDOW_SECONDS = 1.0
LEAST_POSE_SECONDS = 0.8
FLOOR_QUANTILE = 0.05  # the quietest twentieth of a recording is at rest


@dataclass(frozen=True)
class Rest:
    """Consecutive samples at rest, `start` to `stop` (exclusive)."""

    start: int
    stop: int


def unrest(readings: np.ndarray, interval: float, initial: Rest | None) -> tuple[np.ndarray, np.ndarray]:
    """Return the unrest of every sample, and each channel's variance at rest.

    Parameters
    ----------
    readings : shape (N, C), any units.
    interval : sampling interval in s.
    initial : a stretch known to be at rest; without it the quietest windows of the recording count as rest.
    """
    half = window_half(interval)
    variance = windowed_variance(readings, half)
    if initial is not None:
        floor = variance[initial.start + half : max(initial.stop - half, initial.start + half + 1)].mean(0)
    else:
        quiet = np.argsort(np.max(variance / np.median(variance, axis=0), axis=1))
        floor = np.median(variance[quiet[: max(1, int(FLOOR_QUANTILE * len(quiet)))]], axis=0)
    floor = np.maximum(floor, 1e-30 + 1e-12 * np.var(readings, axis=0))
    return np.max(variance / floor, axis=1), floor


def windowed_variance(readings: np.ndarray, half: int) -> np.ndarray:
    """Return the variance in the window of `2·half + 1` samples about every sample (ends repeated)."""
    centred = readings - readings.mean(0)
    width = 2 * half + 1
    padded = np.pad(centred, ((half + 1, half), (0, 0)), mode="edge")
    padded[0] = 0.0
    total, square = np.cumsum(padded, axis=0), np.cumsum(padded**2, axis=0)
    mean = (total[width:] - total[:-width]) / width
    return np.maximum((square[width:] - square[:-width]) / width - mean**2, 0.0)


def rests(quiet: np.ndarray, interval: float) -> list[Rest]:
    """Return the stretches where `quiet` holds, half a window in from the motion and long enough to count.

    A window that touches motion is unquiet up to half a window before it begins, so the stretches need not be
    narrowed.
    """
    padded = np.concatenate([[False], quiet, [False]]).astype(np.int8)
    starts, stops = np.flatnonzero(np.diff(padded) == 1), np.flatnonzero(np.diff(padded) == -1)
    least = round(LEAST_POSE_SECONDS / interval)
    return [Rest(int(a), int(b)) for a, b in zip(starts, stops, strict=True) if b - a >= least]


def initial_rest(readings: np.ndarray, interval: float, seconds: float | None) -> Rest:
    """Return the rest at the beginning of the recording: as stated, or as long as it stays quiet."""
    if seconds is not None:
        return Rest(0, max(2, min(len(readings), round(seconds / interval))))
    ratio, _ = unrest(readings, interval, None)
    loud = np.flatnonzero(ratio > 20.0)
    begin = int(np.argmax(ratio <= 20.0))
    after = loud[loud > begin]
    return Rest(begin, int(after[0]) if len(after) else len(readings))


def window_half(interval: float) -> int:
    """Return half the window in samples."""
    return max(2, round(WINDOW_SECONDS / interval / 2))
