"""Standard deviation of the length of a normal vector, and what a run that narrows the vector leaves of it.

An angle near 0 is the length of a vector of two small angles.  At 0 a length has no derivative, so its standard
deviation does not follow from a gradient: the length of N(0, σ²I) in two dimensions has 0.66 σ (Rayleigh).

With Q = |x|², E√Q = π^(−½) ∫ (1 − φ(s²)) / s² ds over s > 0, where φ(t) = E exp(−tQ) is elementary for a normal x
(Mathai and Provost, Quadratic Forms in Random Variables, § 3.2a).
"""

import numpy as np

# Nodes in log s: the integrand falls like exp(−|v|) on both sides, so that the ends leave out 1e-11 of it.
_LOGARITHM = np.linspace(-25.0, 25.0, 501)
# Length in standard deviations from which the gradient serves: its error there is below 1e-6 of the variance, and the
# difference of two large squares is lost to rounding.
_FAR = 1e3
# Nodes per dimension over the estimates that a further run may leave.
_ESTIMATES = 16


def length_deviation(mean: np.ndarray, covariance: np.ndarray) -> float:
    """Return the standard deviation of |x|, x normal with mean (m,) and covariance (m, m)."""
    return float(np.sqrt(_variance(mean[None], covariance)[0]))


def expected_length_deviation(mean: np.ndarray, before: np.ndarray, after: np.ndarray) -> float:
    """Return the standard deviation of |x| that is expected of data that narrow x from covariance `before` to `after`.

    The root of the mean variance over the estimates of x that the data may give: normal about `mean` (m,), with
    covariance `before` − `after`, (m, m).
    """
    nodes, weights = np.polynomial.hermite_e.hermegauss(_ESTIMATES)
    grid = np.stack(np.meshgrid(*[nodes] * len(mean), indexing="ij"), axis=-1).reshape(-1, len(mean))
    product = np.prod(np.stack(np.meshgrid(*[weights] * len(mean), indexing="ij"), axis=-1), axis=-1).reshape(-1)
    gained, axes = np.linalg.eigh(before - after)
    estimates = mean + (grid * np.sqrt(np.maximum(gained, 0.0))) @ axes.T
    return float(np.sqrt(product @ _variance(estimates, after) / product.sum()))


def _variance(means: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Return the variance of |x| for each of several means, (n, m) → (n,)."""
    spread, axes = np.linalg.eigh(covariance)
    spread, squares = np.maximum(spread, 0.0), (means @ axes) ** 2
    size = squares.sum(axis=1) + spread.sum()
    root = np.sqrt(np.where(size > 0, size, 1.0))
    # s in units of 1/√E Q, so that one set of nodes serves all.
    t = np.exp(2 * _LOGARITHM)[None, :, None] / root[:, None, None] ** 2
    widened = 1 + 2 * t * spread
    exponent = -(t * squares[:, None, :] / widened).sum(axis=2) - 0.5 * np.log(widened).sum(axis=2)
    integrand = -np.expm1(exponent) * np.exp(-_LOGARITHM)
    mean_length = root * np.trapezoid(integrand, _LOGARITHM, axis=1) / np.sqrt(np.pi)
    square = squares.sum(axis=1)
    along = squares @ spread / np.where(square > 0, square, 1.0)
    return np.where(square > _FAR**2 * spread.sum(), along, np.maximum(size - mean_length**2, 0.0))
