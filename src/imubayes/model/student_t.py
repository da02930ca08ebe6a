"""Student's t as a law for one reading, written so that a normal law is the value 0 of its parameter.

x is a reading's distance from its prediction over the scale of the law, κ one over the degrees of freedom ν.  Formulas:
Lange, Little and Taylor, Robust statistical modeling using the t distribution (J. Am. Stat. Assoc. 84, 1989).
"""

import jax.numpy as jnp
from jax.scipy.special import gammaln

from imubayes.types import Array, Float

# Below this the series serves: the next term is its third power over 4.
_SMALL = 1e-5


def deviance(x: Float[Array, "..."], tail: Float[Array, "..."]) -> Float[Array, "..."]:
    """Return what stands in the place of x² in twice the negative logarithm: (ν + 1) log(1 + x²/ν)."""
    return x**2 * _flattened(x, tail)


def irls_weight(x: Float[Array, "..."], tail: Float[Array, "..."]) -> Float[Array, "..."]:
    """Return (ν + 1)/(ν + x²): half the slope of the square over x, the weight of a reading."""
    return (1 + tail) / (1 + tail * x**2)


def curvature(x: Float[Array, "..."], tail: Float[Array, "..."]) -> Float[Array, "..."]:
    """Return half the second derivative of the square: 1 for a normal law, negative far out."""
    return (1 + tail) * (1 - tail * x**2) / (1 + tail * x**2) ** 2


def deviance_root_slope(x: Float[Array, "..."], tail: Float[Array, "..."]) -> Float[Array, "..."]:
    """Return the derivative of the root of the square by x."""
    return irls_weight(x, tail) / jnp.sqrt(_flattened(x, tail))


def deviance_root_over_slope(x: Float[Array, "..."], tail: Float[Array, "..."]) -> Float[Array, "..."]:
    """Return the root of the square over its derivative: where a straight line of that slope would cross zero."""
    return x * _flattened(x, tail) / irls_weight(x, tail)


def fisher_information(tail: Float[Array, "..."]) -> Float[Array, "..."]:
    """Return the Fisher information of one reading about its prediction: (ν + 1)/(ν + 3), for a scale of 1."""
    return (1 + tail) / (1 + 3 * tail)


def normaliser(tail: Float[Array, "..."]) -> Float[Array, "..."]:
    """Return twice the logarithm of the density of N(0, 1) over that of the law, both at zero."""
    heavy = tail > 0
    degrees = 1 / jnp.where(heavy, tail, 1.0)
    at_zero = gammaln((degrees + 1) / 2) - gammaln(degrees / 2) - 0.5 * jnp.log(degrees / 2)
    return jnp.where(heavy, -2 * at_zero, 0.0)


def log_determinant_correction(tail: Float[Array, "..."]) -> Float[Array, "..."]:
    """Return what the log determinant of the normal law of the same information lacks for one reading."""
    return jnp.log(fisher_information(tail)) + normaliser(tail)


def _flattened(x: Float[Array, "..."], tail: Float[Array, "..."]) -> Float[Array, "..."]:
    """Return the square over x²: (1 + κ) log(1 + κx²)/(κx²)."""
    grown = tail * x**2
    small = grown < _SMALL
    safe = jnp.where(small, 1.0, grown)
    return (1 + tail) * jnp.where(small, 1 - grown / 2 + grown**2 / 3, jnp.log1p(safe) / safe)
