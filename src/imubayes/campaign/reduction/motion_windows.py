"""Windows and steps of a log without rests: how a record of motion is divided, and the weights of its instants.

The record is divided into steps of equally many samples, several steps into a window, several windows into a stretch
from one pose to the next.  A row is the mean of the samples of a window.  The model knows the attitude at the ends of
steps only: the weights of these instants are such that they average every polynomial in time up to the fourth degree
as the samples do, so that nothing is lost if the unit turns by half a radian within a window.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imubayes.foundations.numerics import true_stretches
from imubayes.procedures.carried import STEP_ANGLE, about_one_axis

WINDOW_SECONDS = 0.8  # longer than the strokes of a hand that is not at rest
WINDOW_ANGLE = 1.2  # rad: a rotating vector is shortened by 6 % in the mean over it
STEP_SECONDS = 0.1
# Random walk and bias instability of a consumer gyro turn by some 0.05 deg over half of the longest.
STRETCH_SECONDS, MOST_STRETCH_SECONDS = 10.0, 60.0
MOST_STRETCHES, MOST_ABOUT_ONE_AXIS = 12, 1  # effort: each brings three angles
_FAST = 0.98  # quantile of the rate for which steps and windows are chosen
_LEAST_USED = 0.8  # of the most that stretches of any length use
_DEGREE = 4  # of polynomials that are averaged exactly


@dataclass(frozen=True)
class Division:
    """How a record is divided.

    Attributes
    ----------
    step, window, stretch : samples in a step, steps in a window, windows in a stretch.
    most : stretches that are used.
    """

    step: int
    window: int
    stretch: int
    most: int

    @property
    def per_window(self) -> int:
        """Samples of a window."""
        return self.step * self.window

    @property
    def steps(self) -> int:
        """Steps of a stretch."""
        return self.window * self.stretch

    @property
    def samples(self) -> int:
        """Intervals between samples of a stretch."""
        return self.steps * self.step


def divide(rate: np.ndarray, interval: float, parts: Sequence[tuple[int, int]]) -> Division:
    """Return the division of a record by how fast it turns.

    Parameters
    ----------
    rate : shape (N, 3), body axes, rad/s.
    interval : sampling interval, s.
    parts : first and last sample of each part of the record without a gap.
    """
    fast = max(float(np.quantile(np.linalg.norm(rate, axis=1), _FAST)), 1e-3)
    step = max(1, int(min(STEP_SECONDS, STEP_ANGLE / fast) / interval))
    window = min(WINDOW_SECONDS, WINDOW_ANGLE / fast) / (step * interval)
    steps = max(2, 2 * int(window / 2))
    whole = (len(rate) - 1) * interval
    most = MOST_ABOUT_ONE_AXIS if about_one_axis(rate) else MOST_STRETCHES
    count = max(1, min(most, math.ceil(whole / STRETCH_SECONDS)))
    longest = min(whole / count, MOST_STRETCH_SECONDS) / interval
    stretch = _longest_useful(np.array([stop - start for start, stop in parts]), longest, most) / (steps * step)
    return Division(step, steps, max(2, 2 * int(stretch / 2)), most)


def _longest_useful(lengths: np.ndarray, longest: float, most: int) -> float:
    """Return how long stretches are: as long as possible if that leaves out little of the parts of a record.

    Parameters
    ----------
    lengths : shape (n,), of the parts, in intervals.
    longest : that a stretch may be.
    most : stretches that are used.
    """
    tried = np.unique(np.minimum(lengths, longest))
    used = np.array([min(most, int(np.sum(lengths // length))) * length for length in tried])
    return float(tried[used >= _LEAST_USED * used.max()].max())


def contiguous(
    time: np.ndarray, interval: float, least: int, unusable: np.ndarray | None = None
) -> list[tuple[int, int]]:
    """Return first and last sample of the parts of a record without gaps, of at least so many intervals each.

    Unusable samples, (N,) bool, such as clipped ones, are gaps as well.
    """
    usable = np.ones(len(time), dtype=bool) if unusable is None else ~unusable
    joined = (np.diff(time) <= max(0.05, 3 * interval)) & usable[1:] & usable[:-1]
    return [(first, last) for first, last in true_stretches(joined).tolist() if last - first >= least]


def stretches(parts: list[tuple[int, int]], division: Division) -> tuple[list[tuple[int, int]], int]:
    """Return for each series of stretches its first sample and their number, and how many stretches are left out.

    More than the division allows are not used: they are taken spread evenly over the record, in series.
    """
    series = [(start, (stop - start) // division.samples) for start, stop in parts]
    whole, most = sum(count for _, count in series), division.most
    if whole <= most:
        return series, 0
    long = max(1, most // 2)
    short = [(start + place * division.samples, min(long, count - place)) for start, count in series
             for place in range(0, count, long)]  # fmt: skip
    chosen = np.unique(np.linspace(0, len(short) - 1, most // long).round().astype(int))
    kept = [short[place] for place in chosen]
    return kept, whole - sum(count for _, count in kept)


def window_weights(time: np.ndarray, division: Division) -> tuple[np.ndarray, np.ndarray]:
    """Return weights of the samples of a window, (S + 1,), and of the ends of its steps, (W + 1,); each sums to 1.

    Samples are weighted by the trapezoidal rule, the ends of steps by the least change of it that averages polynomials
    as the samples do.

    Parameters
    ----------
    time : shape (S + 1,), of the samples of one window, its ends included, equally spaced.
    """
    samples = np.ones(len(time))
    samples[[0, -1]] = 0.5
    samples /= samples.sum()
    place = 2 * (time - time[0]) / (time[-1] - time[0]) - 1
    at = place[:: division.step]
    rule = np.ones(len(at))
    rule[[0, -1]] = 0.5
    rule /= rule.sum()
    powers = np.arange(min(_DEGREE, division.window) + 1)[:, None]
    wanted = (place**powers) @ samples
    table = at**powers
    return samples, rule + np.linalg.pinv(table) @ (wanted - table @ rule)
