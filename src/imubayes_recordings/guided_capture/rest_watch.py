"""Rests of a unit turned by hand while it is recorded.

As in `imubayes.campaign.reduction.rests`, the variance in a window of a second is compared with the quietest seen, and
the gyros determine turns that the accelerometers do not see.  The result steers the operator; the poses of the campaign
are found in the whole recording.
"""

import numpy as np

from imubayes.campaign.reduction import rests
from imubayes.foundations.numerics import angle_between

_LOUD = 10.0  # times the variance of the quietest window
_SAME = np.deg2rad(5.0)  # closer to the rest before: no other attitude


class RestWatch:
    """The rest that goes on, if any: its samples without half a window at both ends, and the number of those before."""

    def __init__(self, interval: float, step: np.ndarray) -> None:
        """Begin; `interval` in s, and the least step of each channel, for readings whose noise is below it."""
        self._interval, self._half, self._least = interval, rests.window_half(interval), step[:3] ** 2 / 12 + 1e-300
        self._floor = np.full(3, np.inf)
        self._tail = self._rest = np.zeros((0, len(step)))
        self._bias: np.ndarray | None = None
        self._before: np.ndarray | None = None
        self.rests = 0

    def add(self, values: np.ndarray) -> None:
        """Add samples of force, and rates if there are gyros about three axes: (n, 3) or (n, 6), SI."""
        self._tail = np.concatenate([self._tail, values])
        width = 2 * self._half + 1
        if len(self._tail) < width:
            return
        inner = self._tail[self._half : len(self._tail) - self._half]
        variance = rests.windowed_variance(self._tail[:, :3], self._half)[self._half : len(self._tail) - self._half]
        self._floor = np.minimum(self._floor, np.maximum(variance, self._least).min(axis=0))
        loud = (variance > _LOUD * self._floor).any(axis=1) | self._turning(width)
        if loud.any():
            self.end()
        self._rest = np.concatenate([self._rest, inner[len(loud) - int(np.argmax(loud[::-1])) if loud.any() else 0 :]])
        self._tail = self._tail[len(self._tail) - 2 * self._half :]

    def end(self, missing: bool = False) -> None:
        """End the rest; if samples are missing, the window as well."""
        if self.still > rests.WINDOW_SECONDS:
            self.rests += not self.repeated
            self._before, self._bias = self._rest[:, :3].mean(axis=0), self._rest[:, 3:].mean(axis=0)
        self._rest = self._rest[:0]
        self._tail = self._tail[:0] if missing else self._tail

    @property
    def still(self) -> float:
        """Seconds of the rest so far; 0 in motion."""
        return len(self._rest) * self._interval

    @property
    def noise(self) -> float:
        """Standard deviation of one sample of the accelerometers in this rest, m/s²."""
        return float(np.sqrt(np.maximum(self._rest[:, :3].var(axis=0), self._least).mean()))

    @property
    def repeated(self) -> bool:
        """Whether the unit rests in the attitude of the rest before."""
        if self._before is None or not len(self._rest):
            return False
        return bool(angle_between(self._rest[:, :3].mean(axis=0), self._before) < _SAME)

    def _turning(self, width: int) -> np.ndarray:
        if self._tail.shape[1] == 3:
            return np.zeros(len(self._tail) - width + 1, dtype=bool)
        total = np.concatenate([np.zeros((1, 3)), np.cumsum(self._tail[:, 3:], axis=0)])
        mean = (total[width:] - total[:-width]) / width
        bias = mean[0] if self._bias is None else self._bias
        self._bias = bias
        return np.linalg.norm(mean - bias, axis=1) * rests.WINDOW_SECONDS > rests.MOST_ROTATION
