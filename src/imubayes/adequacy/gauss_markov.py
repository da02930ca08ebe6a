"""Autocorrelated noise: white noise plus first-order Gauss–Markov noise, and how much of it each channel has.

The Gauss–Markov part (IEEE Std 952) has correlation φ from row to row and a share c of the variance; c = 1 is AR(1).
Whitening is by the innovations of its Kalman filter, exact for every record.  Share and correlation come from the
restricted likelihood (Patterson & Thompson, Biometrika 1971) on a grid: the fit has absorbed part of the slow noise, so
that the autocorrelation of the residual is biased towards zero.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from imubayes.adequacy.projection import Projection

_MARKOV_SHARES = (0.1, 0.2, 0.35, 0.5, 0.65, 0.8, 1.0)
"""Grid of the restricted likelihood: share of the variance that is correlated, correlation from row to row.  Effort."""
_MARKOV_CORRELATIONS = (0.2, 0.35, 0.5, 0.65, 0.8, 0.9, 0.96)
_MARKOV_NEARLY = 1.0
"""Grid points within this log likelihood of the best (1.4 standard deviations) are nearly as likely; the one with most
low-frequency noise is taken.  Blind study (7a6fcab): zero gives false alarms in correlated noise."""
_DIRECTION_HELD_MIN = 0.1
"""A projected direction with less than this share of its squared length in a channel is ignored there.  Numerical."""


@dataclass(frozen=True)
class MarkovNoise:
    """Noise of unit variance: share of the variance that is Gauss–Markov, and its correlation from row to row."""

    share: float
    correlation: float

    @property
    def low_frequency_power(self) -> float:
        """Power at zero frequency over that of white noise: 1 − c + c (1 + φ)/(1 − φ)."""
        return 1 - self.share + self.share * (1 + self.correlation) / (1 - self.correlation)


WHITE = MarkovNoise(0.0, 0.0)
GRID = (WHITE, *(MarkovNoise(*pair) for pair in product(_MARKOV_SHARES, _MARKOV_CORRELATIONS)))


@dataclass(frozen=True)
class InnovationsFilter:
    """Kalman filter that whitens entries with Gauss–Markov noise.

    Attributes
    ----------
    series : shape (G, M), entries of each record in the order of time, E where padded.
    share, correlation : shape (G,).
    """

    series: np.ndarray
    share: np.ndarray
    correlation: np.ndarray

    def __call__(self, white: np.ndarray) -> np.ndarray:
        """Return entries (E, C) whitened."""
        return self.filtered(white)[0]

    def filtered(self, white: np.ndarray) -> tuple[np.ndarray, float]:
        """Return entries (E, C) whitened, and the logarithm of the determinant of their covariance."""
        correlated = (self.share > 0) & (self.correlation > 0)
        share, correlation = self.share[correlated, None], self.correlation[correlated, None]
        result = np.concatenate([white, np.zeros((1, white.shape[1]))])
        series, count = self.series[correlated], len(white)
        state, variance, log_determinant = np.zeros((len(series), white.shape[1])), share.copy(), 0.0
        for place in series.T:
            there = (place < count)[:, None]
            whole = variance + 1 - share
            innovation = result[place] - state
            result[place] = np.where(there, innovation / np.sqrt(whole), 0.0)
            log_determinant += float(np.sum(np.log(whole)[there]))
            gain = variance / whole
            state = correlation * (state + gain * innovation)
            variance = correlation**2 * variance * (1 - gain) + share * (1 - correlation**2)
        return result[:-1], log_determinant


def estimate_markov_noise(projection: Projection, channels: Sequence[int]) -> dict[int, MarkovNoise]:
    """Return the Markov noise of some channels of one kind, by place.

    A channel has few runs of its own: the mean log likelihood of the other channels is added to its own.  Among grid
    points that are nearly as likely, the one with the most low-frequency power is taken: too little passes for effects.
    """
    tables = np.array([restricted_log_likelihoods(*_of_channel(projection, place)) for place in channels])
    others = (tables.sum(axis=0) - tables) / max(len(channels) - 1, 1)
    power = np.array([noise.low_frequency_power for noise in GRID])
    whole = tables + others
    likely = np.where(whole > whole.max(axis=1, keepdims=True) - _MARKOV_NEARLY, power, 0.0)
    return {place: GRID[int(np.argmax(own))] for place, own in zip(channels, likely, strict=True)}


def _of_channel(projection: Projection, channel: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return residual, projected-out directions and records of one channel, its entries numbered from 0."""
    entries, turn = projection.fitted.model.entries, projection.turn
    count = len(entries)
    groups = turn.series[(entries.channel[turn.series[:, 0]] == channel) & (turn.sizes > 2)]
    own = groups[groups < count]
    local = np.full(count + 1, len(own))
    local[own] = np.arange(len(own))
    rows = turn.reflect(np.concatenate([projection.residual[:count, None], projection.basis[:count]], axis=1))[own]
    return rows[:, 0], rows[:, 1:], local[groups]


def restricted_log_likelihoods(residual: np.ndarray, taken: np.ndarray, series: np.ndarray) -> np.ndarray:
    """Return the restricted log likelihood of whitened residuals at each point of the grid.

    Parameters
    ----------
    residual : shape (n,).
    taken : shape (n, k), the part of the projected-out directions in these entries.
    series : shape (G, M), entries of each record in the order of time, n where padded.
    """
    count = len(residual)
    if not count:
        return np.zeros(len(GRID))
    # The offset of a record is free: its scatter is a noise of its own.
    offsets = (series[:, :, None] == np.arange(count)).any(axis=1).T.astype(float)
    whole = np.concatenate([taken, offsets / np.sqrt(offsets.sum(axis=0))], axis=1)
    left, lengths, _ = np.linalg.svd(whole, full_matrices=False)
    columns = np.concatenate([residual[:, None], left[:, lengths**2 > _DIRECTION_HELD_MIN]], axis=1)
    found = []
    for noise in GRID:
        by = InnovationsFilter(series, np.full(len(series), noise.share), np.full(len(series), noise.correlation))
        white, determinant = by.filtered(columns)
        basis, upper = np.linalg.qr(white[:, 1:])
        misfit = white[:, 0] - basis @ (basis.T @ white[:, 0])
        determinant += 2 * float(np.sum(np.log(np.abs(np.diag(upper)))))
        freedom = count - basis.shape[1]
        found.append(-0.5 * (determinant + freedom * np.log(max(float(misfit @ misfit), 1e-300))))
    return np.array(found)
