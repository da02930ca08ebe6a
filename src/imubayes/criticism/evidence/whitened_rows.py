"""Rows whitened by the whole noise of a hypothesis, and their Gram matrices.

Correlation in time that the model states goes first, then the structure of the rows or the weights of heavy tails, then
offsets of runs: a term of low rank.  Gram matrices are kept; whitened columns only those used last.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from imubayes.criticism.evidence.linear_problem import ChannelRows
from imubayes.criticism.evidence.noise_structures import NoiseOfUnit

_KEPT = 3
"""Sets of whitened columns of a channel that are kept.  Numerical: each is as large as the columns themselves."""


@dataclass(frozen=True)
class GramMatrix:
    """Inner products of the whitened columns of a channel, the residual last, and the log determinant of whitening."""

    products: np.ndarray
    log_det: float


@dataclass(frozen=True)
class WhitenedColumns:
    """Columns whitened but for offsets of runs, (n, C), the response to such an offset, (n,), and log determinant."""

    columns: np.ndarray
    offset: np.ndarray
    log_det: float


class WhitenedRows:
    """The rows of a channel under any noise."""

    def __init__(self, rows: ChannelRows):
        self.rows = rows
        self._kept: dict[object, WhitenedColumns] = {}
        self._gram: dict[object, GramMatrix] = {}

    def gram(self, noise: NoiseOfUnit, weight: np.ndarray | None = None) -> GramMatrix:
        """Return the Gram matrix of all columns that the channel responds to."""
        key = noise.rows, noise.size, noise.scatter
        if weight is None and key in self._gram:
            return self._gram[key]
        found = with_scatter(self.rows, self._own(noise, weight), noise.scatter)
        if weight is None:
            self._gram[key] = found
        return found

    def gram_of(self, noise: NoiseOfUnit, places: np.ndarray, weight: np.ndarray | None) -> GramMatrix:
        """Return the Gram matrix of some columns, and of the residual after them."""
        chosen = np.append(places, -1)
        if weight is None:
            whole = self.gram(noise)
            return GramMatrix(whole.products[chosen[:, None], chosen], whole.log_det)
        (columns, offset), root = self.independent(noise), np.sqrt(weight)
        own = WhitenedColumns(columns[:, chosen] * root[:, None], offset * root, self._log_det_in_time(noise))
        return with_scatter(self.rows, own, noise.scatter)

    def whitened(self, noise: NoiseOfUnit, weight: np.ndarray | None = None) -> np.ndarray:
        """Return all columns, the residual last, whitened by the whole noise, (n, L + 1)."""
        own = self._own(noise, weight)
        return _less_offsets(own.columns, self.rows, own.offset, noise.scatter)

    def whiten(self, noise: NoiseOfUnit, columns: np.ndarray, weight: np.ndarray | None = None) -> np.ndarray:
        """Return further columns, (n, C), whitened by the whole noise."""
        white = self.in_time(noise, columns)[0]
        white = noise.rows.whiten(self.rows, white)[0] if weight is None else white * np.sqrt(weight)[:, None]
        return _less_offsets(white, self.rows, self._own(noise, weight).offset, noise.scatter)

    def in_time(self, noise: NoiseOfUnit, columns: np.ndarray) -> tuple[np.ndarray, float]:
        """Return columns (n, C) less what the model states of their correlation in time, and the log determinant."""
        if not self.rows.correlations:
            return columns, 0.0
        known = self.rows.correlations[noise.size]
        return known.whiten(columns), known.log_det

    def independent(self, noise: NoiseOfUnit) -> tuple[np.ndarray, np.ndarray]:
        """Return all columns, and the response to an offset of a run, whitened by the correlation in time alone."""
        if not self.rows.correlations:
            return self.rows.columns, self.rows.root
        found = self._remembered(("in time", noise.size), lambda: self._in_time(noise))
        return found.columns, found.offset

    def structured(self, noise: NoiseOfUnit, columns: np.ndarray) -> WhitenedColumns:
        """Return columns (n, C), or a residual (n,), whitened but for offsets of runs; tails leave them as they are."""
        both, in_time = self.in_time(noise, np.column_stack([columns, self.rows.root]))
        both, log_det = noise.rows.whiten(self.rows, both)
        return WhitenedColumns(both[:, :-1], both[:, -1], log_det + in_time)

    def _in_time(self, noise: NoiseOfUnit) -> WhitenedColumns:
        both, log_det = self.in_time(noise, np.column_stack([self.rows.columns, self.rows.root]))
        return WhitenedColumns(both[:, :-1], both[:, -1], log_det)

    def _own(self, noise: NoiseOfUnit, weight: np.ndarray | None) -> WhitenedColumns:
        if weight is not None:
            (columns, offset), root = self.independent(noise), np.sqrt(weight)
            return WhitenedColumns(columns * root[:, None], offset * root, self._log_det_in_time(noise))
        if noise.rows.is_white and not self.rows.correlations:
            return WhitenedColumns(self.rows.columns, self.rows.root, 0.0)
        return self._remembered((noise.rows, noise.size), lambda: self.structured(noise, self.rows.columns))

    def _log_det_in_time(self, noise: NoiseOfUnit) -> float:
        return self.rows.correlations[noise.size].log_det if self.rows.correlations else 0.0

    def _remembered(self, key: object, make: Callable[[], WhitenedColumns]) -> WhitenedColumns:
        found = self._kept.pop(key) if key in self._kept else make()
        self._kept[key] = found
        while len(self._kept) > _KEPT:
            del self._kept[next(iter(self._kept))]
        return found


def _sums_of_runs(rows: ChannelRows, white: np.ndarray, offset: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the projections of columns on the offset of each run, (runs, C), and its squared lengths, (runs,)."""
    starts = [start for start, _ in rows.series]
    along = np.add.reduceat(offset[:, None] * white, starts, axis=0)
    return along, np.add.reduceat(offset**2, starts)


def with_scatter(rows: ChannelRows, own: WhitenedColumns, scatter: float) -> GramMatrix:
    """Return the Gram matrix of columns beside offsets of runs of a standard deviation (Woodbury)."""
    products, log_det = own.columns.T @ own.columns, own.log_det
    if scatter == 0:
        return GramMatrix(products, log_det)
    along, squared = _sums_of_runs(rows, own.columns, own.offset)
    share = scatter**2 / (1 + scatter**2 * squared)
    log_det -= 0.5 * float(np.log1p(scatter**2 * squared).sum())
    return GramMatrix(products - along.T @ (share[:, None] * along), log_det)


@dataclass(frozen=True)
class RunOffsets:
    """Offsets of runs beside a residual.

    Attributes
    ----------
    size : shape (runs,), posterior mean of each, in units of the noise of a row as known.
    scatter : standard deviation of their prior, in units of the noise of a row.
    information : shape (runs,), that the rows of each determine, at a noise of 1.
    taken : shape (n,), what they take of the residual.
    variance : shape (n,), what remains uncertain of that, over the variance of a row.
    """

    size: np.ndarray
    scatter: float
    information: np.ndarray
    taken: np.ndarray
    variance: np.ndarray

    def log_density(self, scale: float) -> float:
        """Return what they add to the log likelihood of the rows less them, at a noise scale (Laplace)."""
        if self.scatter == 0:
            return 0.0
        gain = np.log1p(self.scatter**2 * self.information)
        return -0.5 * float(gain.sum() + np.sum((self.size / self.scatter / scale) ** 2))


def offsets_of_runs(
    rows: ChannelRows, residual: np.ndarray, offset: np.ndarray, weight: np.ndarray, scatter: float
) -> RunOffsets:
    """Return the offsets of runs beside a residual (n,) at weights (n,); `offset` is the response to one, (n,)."""
    if scatter == 0:
        zero = np.zeros_like(residual)
        return RunOffsets(zero[:0], 0.0, zero[:0], zero, zero)
    root = np.sqrt(weight)
    along, squared = _sums_of_runs(rows, (root * residual)[:, None], root * offset)
    share, sizes = scatter**2 / (1 + scatter**2 * squared), [length for _, length in rows.series]
    mean = share * along[:, 0]
    return RunOffsets(mean, scatter, squared, offset * np.repeat(mean, sizes), offset**2 * np.repeat(share, sizes))


def _less_offsets(white: np.ndarray, rows: ChannelRows, offset: np.ndarray, scatter: float) -> np.ndarray:
    """Return columns whitened by offsets of runs as well: shrunk along the offset of each."""
    if scatter == 0:
        return white
    along, squared = _sums_of_runs(rows, white, offset)
    shrink = (1 - 1 / np.sqrt(1 + scatter**2 * squared)) / np.where(squared > 0, squared, 1.0)
    sizes = [length for _, length in rows.series]
    return white - offset[:, None] * np.repeat(shrink[:, None] * along, sizes, axis=0)
