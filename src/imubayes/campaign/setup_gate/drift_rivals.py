"""How the outputs of a run may change smoothly with time, which a reversed column of temperatures passes for.

A bias that drifts, follows the rate of the temperature or lags behind it is common; a column in the wrong order is not.
Over one slow swing of the temperature they look alike: a sine reversed in time is a sum of the sine and its rate.
"""

import numpy as np

from imubayes.campaign.setup_gate.error_model import NormalTerms, Widths
from imubayes.campaign.setup_gate.evidence import ErrorModel, RunDrift
from imubayes.campaign.setup_gate.setup_view import RunView

LAGS = (300.0, 1200.0, 4800.0)
"""Times in seconds by which a bias may lag behind the temperature."""
_MINUTE, _TEN_DEGREES = 60.0, 10.0
_DEGREE = 3  # of the polynomial in time


def score_with_drift(model: ErrorModel, view: RunView, rest: NormalTerms) -> float:
    """Return −2 log evidence if the outputs of one run drift, each channel by the course that it supports best.

    Parameters
    ----------
    rest : terms of all other runs.
    """
    seen = model.seen(view)

    def score(sd: np.ndarray) -> float:
        return float(model.score(rest + model.terms_of(seen, drift=RunDrift(courses, sd))))

    courses, families, sizes = _courses(view, model.widths)
    none = np.zeros(sizes.shape)
    chosen, still = none.copy(), score(none)
    for channel in range(len(sizes)):
        tried = [_only(sizes, channel, family) for family in families]
        best = min(tried, key=score)
        if score(best) < still:
            chosen += best
    return min(still, score(chosen))


def _only(sizes: np.ndarray, channel: int, family: list[int]) -> np.ndarray:
    """Return the standard deviations of the courses of one family in one channel, none in others."""
    found = np.zeros(sizes.shape)
    found[channel, family] = sizes[channel, family]
    return found


def _courses(view: RunView, widths: list[Widths]) -> tuple[np.ndarray, list[list[int]], np.ndarray]:
    """Return courses (R, q), which of them act together, and their standard deviations in each channel, (K, q)."""
    time = view.time - view.time[0]
    if np.any(np.diff(time) <= 0):
        time = np.arange(view.rows, dtype=float)
    progress = 2 * time / float(time[-1]) - 1
    columns = [np.polynomial.legendre.Legendre.basis(degree)(progress) for degree in range(1, _DEGREE + 1)]
    families, sizes = [list(range(_DEGREE))], [[width.offset] * _DEGREE for width in widths]
    for temperature in view.temperatures.values():
        # A slope per 10 °C acts on a lag in 10 °C; by default a rate of 1 °C/min does as much as 1 °C.
        thermal = [np.gradient(temperature, time) * _MINUTE / _TEN_DEGREES]
        thermal += [(temperature - _lagging(temperature, time, lag)) / _TEN_DEGREES for lag in LAGS]
        families += [[len(columns) + k] for k in range(len(thermal))]
        columns += thermal
        for own, width in zip(sizes, widths, strict=True):
            own += [width.bias_slope] * len(thermal)
    return np.stack(columns, axis=1), families, np.array(sizes)


def _lagging(values: np.ndarray, time: np.ndarray, lag: float) -> np.ndarray:
    """Return the output of a first-order lag whose input changes linearly between rows, at rest in the beginning."""
    found = values.astype(float).copy()
    for place in range(1, len(values)):
        elapsed = float(time[place] - time[place - 1]) / lag
        change = values[place] - values[place - 1]
        gained = -np.expm1(-elapsed) / elapsed
        behind = (values[place - 1] - found[place - 1]) * np.exp(-elapsed) + gained * change
        found[place] = values[place] - behind
    return found
