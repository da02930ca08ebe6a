"""The linear model of plausible errors: how large they may be, and the normal equations of runs.

Standard deviations are per grade of the unit, in SI: the default priors of the catalogue of effects, widened to the
largest values of data sheets (see `imubayes.foundations.campaign_data`), since the model of the fit is not known here.
Nonlinearity, cross coupling and all else that a linear model omits is a share of the input.  Normal equations
are of one run or of several at once.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imubayes.foundations.campaign_data import Grade
from imubayes.foundations.units import to_si

_DEG, _DEG_S, _DEG_H, _MG = to_si("deg"), to_si("deg/s"), to_si("deg/h"), to_si("mg")


@dataclass(frozen=True)
class Widths:
    """Standard deviations of the errors of one kind of channel; rad/s and m/s² for rates and accelerations.

    Attributes
    ----------
    scale, misalignment : of the scale factor, and of the input axis toward either of the others, rad.
    bias, offset : common to all runs, and of one run.
    bias_slope, scale_slope : per 10 °C; of curvatures per (10 °C)² a third of it.
    share : of the input, what a linear model leaves out.
    rest : at zero input, what a linear model leaves out.
    """

    scale: float
    misalignment: float
    bias: float
    offset: float
    bias_slope: float
    scale_slope: float
    share: float
    rest: float


@dataclass(frozen=True)
class Steadiness:
    """The errors of channels that change, over those of a poor unit; of all gyros and accelerometers or each, (K,).

    Attributes
    ----------
    rows : what the linear model leaves out of single rows.
    runs : offsets of single runs.
    noise : over what the campaign states.
    """

    rows: float | np.ndarray = 1.0
    runs: float | np.ndarray = 1.0
    noise: float | np.ndarray = 1.0

    def times(self, rows: float, runs: float) -> "Steadiness":
        """Return the steadiness with so many times the errors of rows and runs."""
        return Steadiness(self.rows * rows, self.runs * runs, self.noise)

    def poor(self) -> "Steadiness":
        """Return the steadiness of a poor unit, or less if channels show less."""
        return Steadiness(np.maximum(self.rows, 1.0), np.maximum(self.runs, 1.0))


POOR = Steadiness()

_GYRO = {
    "navigation": Widths(0.005, 0.3 * _DEG, _DEG_S, 10 * _DEG_H, 50 * _DEG_H, 0.001, 0.002, 1.0 * _DEG_H),
    "tactical": Widths(0.005, 0.3 * _DEG, _DEG_S, 10 * _DEG_H, 200 * _DEG_H, 0.001, 0.002, 1.0 * _DEG_H),
    "industrial": Widths(0.01, 0.5 * _DEG, 2 * _DEG_S, 200 * _DEG_H, 600 * _DEG_H, 0.002, 0.005, 10 * _DEG_H),
    "consumer": Widths(0.03, 1.5 * _DEG, 20 * _DEG_S, 0.3 * _DEG_S, 3000 * _DEG_H, 0.005, 0.015, 100 * _DEG_H),
}
_ACCELEROMETER = {
    "navigation": Widths(0.005, 0.3 * _DEG, 20 * _MG, _MG, 2 * _MG, 0.001, 0.002, _MG),
    "tactical": Widths(0.005, 0.3 * _DEG, 20 * _MG, _MG, 2 * _MG, 0.001, 0.002, _MG),
    "industrial": Widths(0.01, 0.5 * _DEG, 20 * _MG, 3 * _MG, 5 * _MG, 0.002, 0.005, 3 * _MG),
    "consumer": Widths(0.03, 1.5 * _DEG, 80 * _MG, 15 * _MG, 15 * _MG, 0.005, 0.015, 15 * _MG),
}
G_SENSITIVITIES = (
    0.02 * _DEG_H,
    0.2 * _DEG_H,
    1.5 * _DEG_H,
    5 * _DEG_H,
    15 * _DEG_H,
    50 * _DEG_H,
    150 * _DEG_H,
    500 * _DEG_H,
)
"""Standard deviations of the g-sensitivity of gyros that are tried, rad/s per g: gyros of a make share it, and no
data sheet of a grade determines it within a factor of ten.  Optical gyros have next to none."""
G_SQUARED = 10 * _DEG_H
"""Standard deviation of each term quadratic in g of a gyro, rad/s per g²."""
GROSS = {"gyro": 0.1 * _DEG_S, "accelerometer": 20 * _MG}
"""Standard deviation of errors at zero input beyond which outputs contradict the set-up although no mistake is known
that explains it; smaller ones are the business of a diagnosis."""
LOOSE_OFFSET = 10.0
"""How many times as large as others the bias of one run may be that rivals a mistake in its temperatures."""
COMPENSATED = 0.03
"""Slopes with the temperature of a compensated unit, over those that are plausible without."""
LEVER_ARM = 0.5
"""Largest distance of an accelerometer from the axis of a table, m."""
MOUNTING_UNSTATED, TABLE_UNSTATED = 1.0 * _DEG, 0.2 * _DEG
"""Standard deviations of a mounting and of the axis of a table that are assumed if none is stated, rad."""
MOUNTING_LEAST, TABLE_LEAST = 0.05 * _DEG, 0.02 * _DEG
"""The least that are assumed, rad."""


def widths(kind: str, grade: Grade) -> Widths:
    """Return the standard deviations for a gyro or an accelerometer of a grade."""
    return (_GYRO if kind == "gyro" else _ACCELEROMETER)[grade]


type Numbers = np.ndarray | np.number
"""One number for each of several runs, or that of one."""


@dataclass(frozen=True)
class NormalTerms:
    """What a run adds to the normal equations, and to the log likelihood; of several ones with leading axes.

    Attributes
    ----------
    moments : weighted products of the responses to the errors and, last, the outputs, shape (..., P + 1, P + 1).
    volume : sum of the logarithms of the variances, shape (...).
    values : number of outputs, shape (...).
    """

    moments: np.ndarray
    volume: Numbers
    values: Numbers

    def __add__(self, other: "NormalTerms") -> "NormalTerms":
        return NormalTerms(self.moments + other.moments, self.volume + other.volume, self.values + other.values)

    def __sub__(self, other: "NormalTerms") -> "NormalTerms":
        return NormalTerms(self.moments - other.moments, self.volume - other.volume, self.values - other.values)

    def __getitem__(self, places: int | Sequence[int] | np.ndarray) -> "NormalTerms":
        return NormalTerms(self.moments[places], np.asarray(self.volume)[places], np.asarray(self.values)[places])

    def with_volume(self, more: Numbers) -> "NormalTerms":
        """Return the terms with more volume."""
        return NormalTerms(self.moments, self.volume + more, self.values)

    def scaled(self, factor: Numbers) -> "NormalTerms":
        """Return the terms of so many times as many outputs, shape (...)."""
        if np.all(np.equal(factor, 1)):
            return self
        moments = self.moments * np.asarray(factor)[..., None, None]
        return NormalTerms(moments, self.volume * factor, np.rint(self.values * factor))

    def sums(self, starts: np.ndarray) -> "NormalTerms":
        """Return the sums over parts of the first axis, from one start to the next."""
        if len(starts) == len(self.moments):
            return self
        return NormalTerms(*(np.add.reduceat(each, starts) for each in (self.moments, self.volume, self.values)))

    def total(self) -> "NormalTerms":
        """Return the sum over the first axis."""
        return NormalTerms(self.moments.sum(axis=0), self.volume.sum(axis=0), self.values.sum(axis=0))


def stacked_terms(terms: Sequence[NormalTerms]) -> NormalTerms:
    """Return terms with a first axis for each of several."""
    together = zip(*((each.moments, each.volume, each.values) for each in terms), strict=True)
    return NormalTerms(*map(np.stack, together))


@dataclass(frozen=True)
class Weighted:
    """The normal equations of each channel in one run.

    Attributes
    ----------
    moments : weighted products of the responses to the errors and, last, the outputs, (..., K, n + 1, n + 1).
    volume : of the errors of the run, (..., K).
    """

    moments: np.ndarray
    volume: np.ndarray


def weighted(
    design: np.ndarray, error: np.ndarray, weight: np.ndarray, own: np.ndarray, spread: np.ndarray
) -> Weighted:
    """Return the normal equations of the channels in one run; the errors of each in this run alone are integrated out.

    Parameters
    ----------
    design : response to the errors that are estimated, shape (..., K, R, n).
    error, weight : of each output, shape (..., K, R).
    own : response to the errors of the run, shape (..., K, R, q).
    spread : their standard deviations, shape (..., K, q).
    """
    both, own = np.concatenate([design, error[..., None]], axis=-1), own * spread[..., None, :]
    heavy, turned = both * weight[..., None], own.swapaxes(-2, -1)
    inner = np.eye(own.shape[-1]) + turned @ (own * weight[..., None])
    across = turned @ heavy
    moments = both.swapaxes(-2, -1) @ heavy - across.swapaxes(-2, -1) @ np.linalg.solve(inner, across)
    return Weighted(moments, np.linalg.slogdet(inner)[1])
