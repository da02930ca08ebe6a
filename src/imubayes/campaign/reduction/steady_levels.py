"""The steady part of each level of the stimulus, by the outputs.

A table follows its command after seconds, ringing and creeping.  A steady output is a constant and, while the table
turns, a wave of its angle; its coefficients and its noise are found in a stretch far from both ends.  From either end,
windows of one block to an eighth of that stretch are compared with it, each judged by the scatter of windows of the
same length there.  Slow ripple and drift are therefore noise, and a remainder of a transient is detected down to what
the windows resolve: what is left is within the uncertainty of the mean.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

UNSETTLED = 6.0  # standard deviations of a window; a log has some ten thousand of them
LEAST_BLOCKS = 10  # of a level, to judge its settling
_STRETCHES = ((0.5, 0.95), (0.75, 0.97), (0.3, 0.6), (0.85, 1.0))  # of a level, the usual one first
_QUIETER = 3.0  # times less scatter: the stretches before were not steady
_LEAST_WINDOWS = 8
_GAP_BLOCKS, _GAP_SHARE = 5, 0.3  # steady blocks between the swings of one transient; share of what has passed
_LEAST_SWEEP = 0.5  # deg; a wave of the angle is not seen in less
_NEGLIGIBLE = 1e-6  # of the step to this level, which no output resolves
_MARGIN = 0.3  # of a transient: a servo has decayed tenfold more, and what is left is far below the noise of a mean
_STILL_MOVING = 0.02  # of the step to this level, over what is kept of it
_LEAST_SCATTER = 1e-100  # of a channel that is 0 throughout
_CLIP, _ROUNDS = 4.0, 3
_LEAST_STRETCH = (
    10  # blocks of a stretch other than the usual one: the quietest of several short ones is quiet by chance
)


@dataclass(frozen=True)
class Steady:
    """The steady part of a level.

    Attributes
    ----------
    first, last : its blocks, `last` exclusive.
    settled : whether the outputs settled at all.
    slowest : place of the output with the longest transient, or of the first that still changes; None without one.
    """

    first: int
    last: int
    settled: bool = True
    slowest: int | None = None


def steady_part(outputs: Sequence[np.ndarray], count: int, swept: np.ndarray, before: Sequence[float]) -> Steady:
    """Return the part of a level in which no output shows a transient.

    Parameters
    ----------
    outputs : block means of each channel, shape (n,) each; NaN where missing.
    count : samples per block.
    swept : angle of the table at each block, unwrapped, deg, shape (n,).
    before : output of each channel at the level before; NaN where there is none.
    """
    length = len(swept)
    if length < LEAST_BLOCKS:
        return Steady(0, length)
    design = _design(swept)
    heads, tails = [0] * len(outputs), [0] * len(outputs)
    for place, (values, was) in enumerate(zip(outputs, before, strict=True)):
        present = np.isfinite(values)
        if present.sum() < max(LEAST_BLOCKS, length // 2):
            continue
        unsteady = _unsteady(values, design, count, was)
        heads[place] = _transient(unsteady[0])
        tails[place] = _transient(unsteady[1][::-1])
    head, tail = max(heads, default=0), max(tails, default=0)
    slowest = int(np.argmax(np.add(heads, tails))) if head or tail else None
    first, last = head + round(_MARGIN * head), length - tail - round(_MARGIN * tail)
    if last - first < min(LEAST_BLOCKS, length // 4):
        return Steady(first, max(first, last), False, slowest)
    for place, (values, was) in enumerate(zip(outputs, before, strict=True)):
        if _moves(values[first:last], design[first:last], was):
            return Steady(first, last, False, place)
    return Steady(first, last, True, slowest)


def _design(swept: np.ndarray) -> np.ndarray:
    columns = [np.ones(len(swept))]
    if np.ptp(swept) > _LEAST_SWEEP:
        columns += [np.cos(np.deg2rad(swept)), np.sin(np.deg2rad(swept))]
    return np.stack(columns, axis=1)


@dataclass(frozen=True)
class _Fit:
    """A steady output: coefficients, their covariance over the variance of a block, residuals, scatter of a block."""

    covariance: np.ndarray
    residual: np.ndarray
    scatter: float
    stretch: slice


def _fit(values: np.ndarray, design: np.ndarray, count: int) -> _Fit:
    """Return the fit in the usual stretch, or in another that is far quieter."""
    best: _Fit | None = None
    for begin, end in _STRETCHES:
        stretch = slice(int(begin * len(values)), max(int(end * len(values)), int(begin * len(values)) + 4))
        if best is not None and stretch.stop - stretch.start < _LEAST_STRETCH:
            continue
        found = _fit_in(stretch, values, design, count)
        if best is None or found.scatter * _QUIETER < best.scatter:
            best = found
    assert best is not None
    return best


def _fit_in(stretch: slice, values: np.ndarray, design: np.ndarray, count: int) -> _Fit:
    there = np.isfinite(values[stretch])
    x, y = design[stretch][there], values[stretch][there]
    largest = float(np.nanmax(np.abs(values)))
    kept, scatter = np.ones(len(y), dtype=bool), np.inf
    beta = np.zeros(x.shape[1])
    for _ in range(_ROUNDS if len(y) > x.shape[1] else 0):
        beta = np.linalg.lstsq(x[kept], y[kept], rcond=None)[0]
        error = np.abs(y - x @ beta)
        scatter = 1.4826 * float(np.median(error[kept]))
        kept = error <= max(_CLIP * scatter, float(np.median(error)) + 1e-300)
    covariance = np.linalg.pinv(x[kept].T @ x[kept])
    # A coarse converter mostly outputs one code: its noise is at least that of rounding.
    step = np.abs(np.diff(values))
    quantum = float(step[step > 1e-12 * largest].min(initial=np.inf))
    coarse = quantum * np.sqrt(count / 12) if quantum * count > 3 * scatter and np.isfinite(quantum) else 0.0
    # Missing values are steady.
    residual = np.where(np.isfinite(values), values - design @ beta, 0.0)
    scatter = max(scatter, coarse, _successive_scatter(residual), 1e-9 * largest, _LEAST_SCATTER)
    return _Fit(covariance, residual, scatter, stretch)


def _successive_scatter(residual: np.ndarray) -> float:
    """Return the scatter of a block from successive differences in the second half of a level.

    It has more blocks than a stretch, from which the median of few deviations may come out far too small, and a slow
    transient does not enter it.
    """
    late = residual[len(residual) // 2 :]
    return 1.4826 * float(np.median(np.abs(np.diff(late)))) / np.sqrt(2.0)


def _unsteady(values: np.ndarray, design: np.ndarray, count: int, before: float) -> np.ndarray:
    """Return where a window that starts, and one that ends, at a block differs from the steady output, shape (2, n)."""
    fit, length = _fit(values, design, count), len(values)
    inside = fit.residual[fit.stretch]
    step = abs(float(np.nanmedian(values[fit.stretch])) - before) if np.isfinite(before) else 0.0
    sums = np.concatenate([[0.0], np.cumsum(fit.residual)])
    design_sums = np.concatenate([np.zeros((1, design.shape[1])), np.cumsum(design, axis=0)])
    found = np.zeros((2, length), dtype=bool)
    inflation, size = 1.0, 1
    while size * _LEAST_WINDOWS <= max(len(inside), _LEAST_WINDOWS):
        spread = max(_window_scatter(inside, size), fit.scatter / np.sqrt(size))
        inflation = max(inflation, spread**2 * size / fit.scatter**2)
        mean = (sums[size:] - sums[:-size]) / size
        middle = (design_sums[size:] - design_sums[:-size]) / size
        variance = spread**2 + fit.scatter**2 * inflation * np.einsum("ij,jk,ik->i", middle, fit.covariance, middle)
        beyond = np.abs(mean) > UNSETTLED * np.sqrt(variance) + _NEGLIGIBLE * step
        # A transient is there from the end of the level on; a disturbance further in is none.
        part = max(size // 4, 1)
        ends = (sums[part:] - sums[:-part]) / part
        found[0, : len(beyond)] |= beyond & (ends[: len(beyond)] * mean > 0.5 * mean**2)
        found[1, size - 1 :] |= beyond & (ends[size - part :] * mean > 0.5 * mean**2)
        size *= 2
    return found


def _window_scatter(values: np.ndarray, size: int) -> float:
    windows = len(values) // size
    means = values[: windows * size].reshape(windows, size).mean(axis=1)
    return 1.4826 * float(np.median(np.abs(means)))


def _transient(unsteady: np.ndarray) -> int:
    """Return the length of the transient at the beginning: unsteady blocks with no longer pauses than swings have."""
    end = 0
    for place in np.flatnonzero(unsteady).tolist():
        if place - end > max(_GAP_BLOCKS, _GAP_SHARE * end):
            break
        end = place + 1
    return end


def _moves(values: np.ndarray, design: np.ndarray, before: float) -> bool:
    """Whether an output still changes over the part that is kept, by a share of the step that led to it."""
    good = np.isfinite(values)
    if not np.isfinite(before) or good.sum() < LEAST_BLOCKS:
        return False
    slope = np.linspace(-0.5, 0.5, len(values))[:, None]
    x, y = np.concatenate([design, slope], axis=1)[good], values[good]
    beta = np.linalg.lstsq(x, y, rcond=None)[0]
    error = y - x @ beta
    deviation = np.sqrt(error @ error / len(y) * np.linalg.pinv(x.T @ x)[-1, -1])
    change, step = abs(beta[-1]), abs(float(np.mean(y)) - before)
    return bool(
        change > _STILL_MOVING * step and change > UNSETTLED * deviation and change > _NEGLIGIBLE * np.abs(y).max()
    )
