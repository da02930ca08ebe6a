"""One-dimensional densities given by a table, with their map to the standard normal.

Between knots the logarithm of the density is linear, and beyond the last ones it falls linearly: distribution function
and quantiles are elementary, several modes are no difficulty, and the tails are heavier than those of any normal
distribution.  What is below the middle is reckoned from the lower end and what is above it from the upper one, so that
no digits are lost far out.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy  # loads its parts when they are first used
from jax.scipy.special import ndtr, ndtri

from imubayes.array_shapes import Array, Float

# The slope of a tail is at least this, per scale of the table: beyond its end the prior lets no density stay level.
_LEAST_SLOPE = 0.5
# Finer cells of the table for each of the coarse ones that are given.
_CELLS = 4
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
    splines = [scipy.interpolate.CubicSpline(row, height) for row, height in zip(knots, log_density, strict=True)]
    values = np.array([spline(row) for spline, row in zip(splines, at, strict=True)]).reshape(shape)
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
    return TabulatedDensity(*(jnp.asarray(array) for array in arrays))


def from_normal(table: TabulatedDensity, normal: Float[Array, " H"]) -> Float[Array, " H"]:
    """Return the variables that standard normal ones stand for, by their distribution functions."""
    low = jax.vmap(_quantile)(table, ndtr(jnp.minimum(normal, 0.0)))
    high = -jax.vmap(_quantile)(_reflected(table), ndtr(-jnp.maximum(normal, 0.0)))
    return jnp.where(normal < 0, low, high)


def to_normal(table: TabulatedDensity, value: Float[Array, " H"]) -> Float[Array, " H"]:
    """Return the standard normal variables that values stand for."""
    below, above = jax.vmap(_mass_below)(table, value), jax.vmap(_mass_below)(_reflected(table), -value)
    return jnp.where(below < above, ndtri(jnp.maximum(below, _LEAST_MASS)), -ndtri(jnp.maximum(above, _LEAST_MASS)))


def log_density(table: TabulatedDensity, value: Float[Array, " H"]) -> Float[Array, " H"]:
    """Return the logarithms of the densities at values."""

    def at(table: TabulatedDensity, value):
        inside = jnp.interp(value, table.knots, table.log_density)
        left = table.tails[0] * jnp.minimum(value - table.knots[0], 0.0)
        return inside + left - table.tails[1] * jnp.maximum(value - table.knots[-1], 0.0)

    return jax.vmap(at)(table, value)


def _reflected(table: TabulatedDensity) -> TabulatedDensity:
    """Return the densities of the negative variables."""
    return TabulatedDensity(
        -table.knots[:, ::-1],
        table.log_density[:, ::-1],
        table.tails[:, ::-1],
        table.above[:, ::-1],
        table.below[:, ::-1],
    )


def _cell(table: TabulatedDensity, cell):
    """Return left knot, density there, mass below it and slope of the logarithm in a cell."""
    left = table.knots[cell]
    slope = (table.log_density[cell + 1] - table.log_density[cell]) / (table.knots[cell + 1] - left)
    return left, jnp.exp(table.log_density[cell]), table.below[cell], jnp.where(jnp.abs(slope) < _LEVEL, _LEVEL, slope)


def _quantile(table: TabulatedDensity, mass):
    cell = jnp.clip(jnp.sum(table.below < mass) - 1, 0, table.knots.shape[0] - 2)
    left, density, below, slope = _cell(table, cell)
    within = left + jnp.log1p(jnp.maximum(mass - below, 0.0) * slope / density) / slope
    outside = table.knots[0] + jnp.log(jnp.maximum(mass / table.below[0], _LEAST_MASS)) / table.tails[0]
    return jnp.where(mass < table.below[0], outside, within)


def _mass_below(table: TabulatedDensity, value):
    cell = jnp.clip(jnp.sum(table.knots < value) - 1, 0, table.knots.shape[0] - 2)
    left, density, below, slope = _cell(table, cell)
    within = below + density * jnp.expm1(slope * jnp.minimum(value - left, table.knots[cell + 1] - left)) / slope
    outside = table.below[0] * jnp.exp(table.tails[0] * jnp.minimum(value - table.knots[0], 0.0))
    # Beyond the last knot it stays at the mass below that knot: there the other end is the one to reckon from.
    return jnp.where(value < table.knots[0], outside, within)
