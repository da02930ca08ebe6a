"""Levels of a stimulus column: where a rate, an angle or a current keeps one value to within its noise.

The noise of a column is estimated from the log itself, so that a set-point, the rate of a tachometer and the
differences of a quantised encoder are divided alike.  A level lasts until the smoothed column has moved from its mean
by more than the tolerance; a ramp is therefore a sequence of levels too short to be kept.
"""

import numpy as np

WIDTH = 5  # blocks of the running median; an odd number
NOISE_FACTOR = 5.0  # standard deviations of a block mean within which a level is one level
LEAST_BLOCKS = 25  # of a log, for an estimate of the noise
MOST_NOISE = 0.01  # of the range of a column; what varies more than this is no noise about levels
_QUANTILE, _IN_DEVIATIONS = 0.9, 1.645  # of the absolute value of a normal variable
_RECENT = 50  # blocks over which the mean of a level is taken: slow ripple of a table ends no level


def column_noise(values: np.ndarray) -> float:
    """Return the standard deviation of block means about their running median; 0 for a set-point.

    Moving and still blocks are judged apart, since the rate of an encoder is quiet at rest only.
    """
    good = values[np.isfinite(values)]
    if len(good) < LEAST_BLOCKS:
        return 0.0
    middle = running_median(good)
    apart = np.abs(good - middle)
    moving = np.abs(middle) > 1e-3 * np.abs(middle).max()
    parts = [part for part in (apart, apart[moving], apart[~moving]) if len(part) >= LEAST_BLOCKS]
    noise = max(float(np.quantile(part, _QUANTILE)) for part in parts) / _IN_DEVIATIONS
    return noise if noise < MOST_NOISE * np.ptp(good) or np.ptp(good) < 20 * noise else 0.0


def running_median(values: np.ndarray) -> np.ndarray:
    """Return the median of every value and its neighbours; it keeps steps where they are."""
    if len(values) < WIDTH:
        return values
    padded = np.pad(values, WIDTH // 2, mode="edge")
    return np.median(np.lib.stride_tricks.sliding_window_view(padded, WIDTH), axis=1)


def level_labels(values: np.ndarray, relative: float, absolute: float) -> np.ndarray:
    """Return the number of the level of every block, increasing, shape (len(values),).

    Parameters
    ----------
    values : block means, smoothed.
    relative, absolute : tolerance about the mean of a level, as a share of it and in units of the column.
    """
    label = np.zeros(len(values), dtype=int)
    number, mean, count = 0, float(values[0]), 1
    for place, value in enumerate(values.tolist()[1:], start=1):
        if abs(value - mean) <= relative * abs(mean) + absolute:
            count = min(count + 1, _RECENT)
            mean += (value - mean) / count
        else:
            number, mean, count = number + 1, value, 1
        label[place] = number
    return label
