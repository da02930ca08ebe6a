"""Tabulated densities: one-dimensional, with a map to the standard normal.

Between knots the logarithm of the density is linear, and beyond the last ones it falls linearly: distribution function
and quantiles are elementary, several modes are no difficulty, and the tails are heavier than those of any normal
distribution.  What is below the middle is reckoned from the lower end and what is above it from the upper one, so that
no digits are lost far out.
"""

import equinox as eqx
import numpy as np
import scipy  # loads its parts when they are first used
import scipy.special
from jax.scipy.special import ndtr, ndtri

from imubayes.foundations.arrays import Array, Float, namespace
from imubayes.foundations.tail_probabilities import normal_probability

# The slope of a tail is at least this, per scale of the table: beyond its end the prior lets no density stay level.
_LEAST_SLOPE = 0.5
# Finer cells of the table for each of the coarse ones that are given.
_CELLS = 4
# A spline that is higher than all knots by more than this has overshot: a fifth of a nat.
_OVERSHOT = 0.2
# Cells over which the logarithm changes by less are level.
_LEVEL = 1e-9
# What is farther out stays finite as a normal variable.
_LEAST_MASS = 1e-300


class TabulatedDensity(eqx.Module):
    """Densities of H independent variables, (H, K) knots each.

    Attributes
    ----------
    knots : shape (H, K), increasing.
    log_density : shape (H, K), at the knots, normalised.
    tails : shape (H, 2), slopes of the logarithm towards the middle beyond the first and the last knot, above 0.
    below : shape (H, K), mass below each knot.
    above : shape (H, K), mass above each knot.
    """

    knots: Float[Array, "H K"]
    log_density: Float[Array, "H K"]
    tails: Float[Array, "H 2"]
    below: Float[Array, "H K"]
    above: Float[Array, "H K"]

    def sd(self) -> np.ndarray:
        """Return the standard deviations (H,), the tails beyond the knots left out."""
        knots, density = np.asarray(self.knots), np.exp(np.asarray(self.log_density))
        mass = np.trapezoid(density, knots, axis=-1)
        mean = np.trapezoid(density * knots, knots, axis=-1) / mass
        return np.sqrt(np.trapezoid(density * (knots - mean[:, None]) ** 2, knots, axis=-1) / mass)


def tabulate(knots: np.ndarray, log_density: np.ndarray, scale: np.ndarray) -> TabulatedDensity:
    """Return densities from their logarithms, up to a constant, at a few knots.

    Parameters
    ----------
    knots : shape (H, K), increasing.
    log_density : shape (H, K), finite.
    scale : shape (H,), rough widths of the densities.
    """
    fine = np.linspace(0, knots.shape[-1] - 1, _CELLS * (knots.shape[-1] - 1) + 1)
    place = np.arange(knots.shape[-1])
    shape = (len(knots), len(fine))
    at = np.array([np.interp(fine, place, row) for row in knots]).reshape(shape)
    rows = zip(knots, log_density, at, strict=True)
    values = np.array([_interpolated(row, height, fine) for row, height, fine in rows]).reshape(shape)
    step, change = np.diff(at), np.diff(values)
    tails = np.stack([change[:, 0] / step[:, 0], -change[:, -1] / step[:, -1]], axis=-1)
    tails = np.maximum(tails, _LEAST_SLOPE / scale[:, None])
    values = values - values.max(axis=-1, keepdims=True, initial=-np.inf)
    level = np.abs(change) < _LEVEL
    cells = np.exp(values[:, :-1]) * step * np.where(level, 1.0, np.expm1(change) / np.where(level, 1.0, change))
    ends = np.exp(values[:, [0, -1]]) / tails
    below = np.cumsum(np.concatenate([ends[:, :1], cells], axis=-1), axis=-1)
    above = np.cumsum(np.concatenate([ends[:, 1:], cells[:, ::-1]], axis=-1), axis=-1)[:, ::-1]
    total = (below + above)[:, :1]
    arrays = (at, values - np.log(total), tails, below / total, above / total)
    return TabulatedDensity(*arrays)


def _interpolated(knots: np.ndarray, heights: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Return heights (K,) at knots (K,) interpolated by a cubic spline; shape-preserving if that overshoots.

    Beside a cliff, as of a scale that the data bound from above, a spline swings to maxima that no knot has, and the
    table holds its mass there.
    """
    spline = scipy.interpolate.CubicSpline(knots, heights)(at)
    if spline.max() <= heights.max() + _OVERSHOT:
        return spline
    return scipy.interpolate.PchipInterpolator(knots, heights)(at)


def from_normal(table: TabulatedDensity, normal: Float[Array, "*batch H"]) -> Float[Array, "*batch H"]:
    """Return the variables that standard normal ones stand for, by their distribution functions."""
    xp = namespace(table.knots, normal)
    probability = normal_probability if xp is np else ndtr
    low = _quantile(table, probability(xp.minimum(normal, 0.0)))
    high = -_quantile(_reflected(table), probability(-xp.maximum(normal, 0.0)))
    return xp.where(normal < 0, low, high)


def to_normal(table: TabulatedDensity, value: Float[Array, "*batch H"]) -> Float[Array, "*batch H"]:
    """Return the standard normal variables that values stand for."""
    xp = namespace(table.knots, value)
    quantile = scipy.special.ndtri if xp is np else ndtri
    below, above = _mass_below(table, value), _mass_below(_reflected(table), -value)
    return xp.where(below < above, quantile(xp.maximum(below, _LEAST_MASS)), -quantile(xp.maximum(above, _LEAST_MASS)))


def log_density(table: TabulatedDensity, value: Float[Array, "*batch H"]) -> Float[Array, "*batch H"]:
    """Return the logarithms of the densities at values."""
    xp = namespace(table.knots, value)
    cell = _cell(table, value)
    inside = xp.clip(value, table.knots[:, 0], table.knots[:, -1])
    knots, heights = ((_picked(each, cell), _picked(each, cell + 1)) for each in (table.knots, table.log_density))
    within = heights[0] + (inside - knots[0]) / (knots[1] - knots[0]) * (heights[1] - heights[0])
    left = table.tails[:, 0] * xp.minimum(value - table.knots[:, 0], 0.0)
    return within + left - table.tails[:, 1] * xp.maximum(value - table.knots[:, -1], 0.0)


def _reflected(table: TabulatedDensity) -> TabulatedDensity:
    """Return the densities of the negative variables."""
    return TabulatedDensity(
        -table.knots[:, ::-1],
        table.log_density[:, ::-1],
        table.tails[:, ::-1],
        table.above[:, ::-1],
        table.below[:, ::-1],
    )


def _picked(table: Float[Array, "H K"], cell: Array) -> Float[Array, "*batch H"]:
    """Return the value of each variable at its place, (…, H)."""
    return table[np.arange(table.shape[0]), cell]


def _cell(table: TabulatedDensity, value: Array) -> Array:
    """Return the cell between two knots in which each value lies, or the outermost."""
    return _last_below(table.knots, value)


def _last_below(table: Float[Array, "H K"], value: Float[Array, "*batch H"]) -> Array:
    xp, most = namespace(table, value), table.shape[1] - 2
    if xp is np:
        places = [np.searchsorted(row, value[..., place]) for place, row in enumerate(table)]
        found = np.stack(places, axis=-1) if places else np.zeros(value.shape, int)
    else:
        found = xp.sum(table < value[..., None], axis=-1)
    return xp.clip(found - 1, 0, most)


def _of_cell(table: TabulatedDensity, cell: Array) -> tuple[Array, Array, Array, Array]:
    """Return left end of a cell, density there, mass below it, and slope of the logarithm within."""
    xp = namespace(table.knots, cell)
    left, height = _picked(table.knots, cell), _picked(table.log_density, cell)
    slope = (_picked(table.log_density, cell + 1) - height) / (_picked(table.knots, cell + 1) - left)
    return left, xp.exp(height), _picked(table.below, cell), xp.where(xp.abs(slope) < _LEVEL, _LEVEL, slope)


def _quantile(table: TabulatedDensity, mass: Float[Array, "*batch H"]) -> Float[Array, "*batch H"]:
    xp = namespace(table.knots, mass)
    left, density, below, slope = _of_cell(table, _last_below(table.below, mass))
    within = left + xp.log1p(xp.maximum(mass - below, 0.0) * slope / density) / slope
    first = table.below[:, 0]
    outside = table.knots[:, 0] + xp.log(xp.maximum(mass / first, _LEAST_MASS)) / table.tails[:, 0]
    return xp.where(mass < first, outside, within)


def _mass_below(table: TabulatedDensity, value: Float[Array, "*batch H"]) -> Float[Array, "*batch H"]:
    xp, cell = namespace(table.knots, value), _cell(table, value)
    left, density, below, slope = _of_cell(table, cell)
    right, first = _picked(table.knots, cell + 1), table.knots[:, 0]
    within = below + density * xp.expm1(slope * xp.minimum(value - left, right - left)) / slope
    outside = table.below[:, 0] * xp.exp(table.tails[:, 0] * xp.minimum(value - first, 0.0))
    # Beyond the last knot it stays at the mass below that knot: there the other end is the one to reckon from.
    return xp.where(value < first, outside, within)
