"""Normal equations of the linear model of plausible errors, of one run or of several at once."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

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
        moments = self.moments * np.asarray(factor)[..., None, None]
        return NormalTerms(moments, self.volume * factor, np.rint(self.values * factor))

    def sums(self, starts: np.ndarray) -> "NormalTerms":
        """Return the sums over parts of the first axis, from one start to the next."""
        return NormalTerms(*(np.add.reduceat(each, starts) for each in (self.moments, self.volume, self.values)))

    def total(self) -> "NormalTerms":
        """Return the sum over the first axis."""
        return NormalTerms(self.moments.sum(axis=0), self.volume.sum(axis=0), self.values.sum(axis=0))


def stacked_terms(terms: Sequence[NormalTerms]) -> NormalTerms:
    """Return terms with a first axis for each of several."""
    return NormalTerms(
        np.stack([each.moments for each in terms]),
        np.array([each.volume for each in terms]),
        np.array([each.values for each in terms]),
    )


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
    spread : their standard deviations, shape (K, q).
    """
    both, own = np.concatenate([design, error[..., None]], axis=-1), own * spread[:, None, :]
    heavy, turned = both * weight[..., None], own.swapaxes(-2, -1)
    inner = np.eye(own.shape[-1]) + turned @ (own * weight[..., None])
    across = turned @ heavy
    moments = both.swapaxes(-2, -1) @ heavy - across.swapaxes(-2, -1) @ np.linalg.solve(inner, across)
    return Weighted(moments, np.linalg.slogdet(inner)[1])
