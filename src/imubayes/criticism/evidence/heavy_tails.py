"""Student's t as a normal law with a weight for each row (West, JRSS B 46, 431, 1984), and its lower bound."""

import math

import numpy as np
from scipy import special


def tail_weights(squares: np.ndarray, degrees: float) -> np.ndarray:
    """Return the weight of each row, (n,), of expected squared residuals in units of its noise."""
    return (degrees + 1) / (degrees + squares)


def tail_bound(squares: np.ndarray, weight: np.ndarray, degrees: float) -> float:
    """Return what Student's t adds to the normal of weights w: a lower bound of its logarithm (variational)."""
    t = _log_density(squares, degrees)
    normal = -0.5 * math.log(2 * math.pi) + 0.5 * np.log(weight) - 0.5 * weight * squares
    return float(np.sum(t - normal + 0.5 * np.log(weight)))


def tail_log_density(residual: np.ndarray, degrees: float) -> float:
    """Return the logarithm of the density of residuals (n,) under Student's t of scale 1."""
    return float(_log_density(residual**2, degrees).sum())


def _log_density(squares: np.ndarray, degrees: float) -> np.ndarray:
    constant = special.gammaln((degrees + 1) / 2) - special.gammaln(degrees / 2) - 0.5 * math.log(degrees * math.pi)
    return constant - (degrees + 1) / 2 * np.log1p(squares / degrees)
