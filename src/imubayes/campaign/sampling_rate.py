"""The sampling rate of a log, by its times: what it is, and whether an inertial unit can have it."""

import math

import numpy as np

from imubayes.foundations.errors import input_error

MOST_HZ, USUAL_HZ = 2e5, (0.6, 5000.0)
"""Sampling rate that no inertial unit exceeds, and usual ones."""


def sampling_interval(time: np.ndarray | None) -> float | None:
    """Return the median positive step of a time column, s; None if there is none."""
    steps = np.diff(time) if time is not None else np.zeros(0)
    steps = steps[steps > 0]
    return float(np.median(steps)) if len(steps) else None


def refuse_impossible_rate(interval: float | None, where: str) -> None:
    """Raise InputError for a log whose times are not in seconds, or do not increase."""
    if interval is None or interval >= 1 / MOST_HZ:
        return
    rate = 1 / interval if interval > 0 else math.inf
    factor = next((each for each in (1e3, 1e6, 1e9) if USUAL_HZ[0] <= rate / each <= USUAL_HZ[1]), None)
    remedy = "correct the times" if factor is None else f"multiply the column by {factor:g}: {rate / factor:.4g} Hz"
    what = f"the sampling rate is {rate:.4g} Hz" if interval > 0 else "most times do not increase"
    raise input_error(what, f"{where}, column 'time_s'", f"seconds: at most {MOST_HZ:g} Hz", remedy)
