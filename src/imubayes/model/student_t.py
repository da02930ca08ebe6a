"""Student's t for one observation, parametrised so that κ = 0 is the normal distribution.

x is the residual over the scale of the distribution, κ one over the degrees of freedom ν.  Formulas:
Lange, Little and Taylor, Robust statistical modeling using the t distribution (J. Am. Stat. Assoc. 84, 1989).
"""

import jax.numpy as jnp
import numpy as np
from jax.scipy.special import gammaln

from imubayes.array_shapes import Array, Float

# Below this a series is used; the first neglected term is its third power over 4.
_SMALL = 1e-5


def deviance(x: Float[Array, "..."], tail: Float[Array, "..."]) -> Float[Array, "..."]:
    """Return the deviance (ν + 1) log(1 + x²/ν), which replaces x² in −2 log density."""
    return x**2 * _flattened(x, tail)


def irls_weight(x: Float[Array, "..."], tail: Float[Array, "..."]) -> Float[Array, "..."]:
    """Return (ν + 1)/(ν + x²): half the slope of the deviance over x, the weight in reweighted least squares."""
    return (1 + tail) / (1 + tail * x**2)


def curvature(x: Float[Array, "..."], tail: Float[Array, "..."]) -> Float[Array, "..."]:
    """Return half the second derivative of the deviance: 1 for a normal distribution, negative for outliers."""
    return (1 + tail) * (1 - tail * x**2) / (1 + tail * x**2) ** 2


def deviance_root_slope(x: Float[Array, "..."], tail: Float[Array, "..."]) -> Float[Array, "..."]:
    """Return the derivative by x of the signed root of the deviance."""
    return irls_weight(x, tail) / jnp.sqrt(_flattened(x, tail))


def deviance_root_over_slope(x: Float[Array, "..."], tail: Float[Array, "..."]) -> Float[Array, "..."]:
    """Return the signed root of the deviance over its derivative: the residual of its linearisation."""
    return x * _flattened(x, tail) / irls_weight(x, tail)


def fisher_information(tail: Float[Array, "..."]) -> Float[Array, "..."]:
    """Return the Fisher information about the location, (ν + 1)/(ν + 3), for a scale of 1."""
    return (1 + tail) / (1 + 3 * tail)


def normaliser(tail: Float[Array, "..."]) -> Float[Array, "..."]:
    """Return 2 log of the density of N(0, 1) over that of the t distribution, both at zero."""
    heavy = tail > 0
    degrees = 1 / jnp.where(heavy, tail, 1.0)
    at_zero = gammaln((degrees + 1) / 2) - gammaln(degrees / 2) - 0.5 * jnp.log(degrees / 2)
    return jnp.where(heavy, -2 * at_zero, 0.0)


def log_determinant_correction(tail: Float[Array, "..."]) -> Float[Array, "..."]:
    """Return what one observation adds to the log determinant of the normal distribution of the same information."""
    return jnp.log(fisher_information(tail)) + normaliser(tail)


def _flattened(x: Float[Array, "..."], tail: Float[Array, "..."]) -> Float[Array, "..."]:
    """Return the deviance over x²: (1 + κ) log(1 + κx²)/(κx²)."""
    grown = tail * x**2
    small = grown < _SMALL
    safe = jnp.where(small, 1.0, grown)
    return (1 + tail) * jnp.where(small, 1 - grown / 2 + grown**2 / 3, jnp.log1p(safe) / safe)


def heavy_tailed(tail: np.ndarray, stream: np.random.Generator) -> np.ndarray:
    """Return the factors that turn normal variates into Student's t; `tail` is the inverse degrees of freedom."""
    if not tail.any():
        return np.ones(tail.shape)
    degrees = 1 / np.where(tail > 0, tail, 1.0)
    return np.where(tail > 0, np.sqrt(degrees / stream.chisquare(degrees)), 1.0)
