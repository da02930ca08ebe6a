"""A log density as a user wrote it: of many points or of one, vectorised, counted and kept within a budget."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from imubayes.foundations.errors import input_error
from imubayes.inference.laplace_proposal import BatchedDensity

# Points at which a vectorised function is held against the function of one point, and so many scales away a density
# that depends on its parameters is another.
_COMPARED, _FAR = 3, 1e6


class CountedDensity:
    """A log density of many points that counts them; NaN counts as zero density.

    Attributes
    ----------
    most : evaluations of the budget.
    used : evaluations made.
    """

    def __init__(self, log_density: BatchedDensity, most: int):
        self.log_density, self.most, self.used = log_density, most, 0

    def __call__(self, points: np.ndarray) -> np.ndarray:
        self.spend(len(points))
        values = np.asarray(self.log_density(points))
        return np.where(np.isnan(values), -np.inf, values)

    def spend(self, evaluations: int) -> None:
        """Count evaluations that were made elsewhere, as of gradients."""
        self.used += evaluations

    @property
    def left(self) -> int:
        """Evaluations that are left of the budget."""
        return max(self.most - self.used, 0)


def of_many_points(log_density: Callable[[Any], Any], points: np.ndarray, scale: np.ndarray) -> BatchedDensity:
    """Return a log density of points (n, D) → (n,): the one that is given, or a function of one point vectorised.

    Parameters
    ----------
    log_density : points (n, D) → (n,), or a point (D,) → a number.
    points : shape (n, D), n ≠ D, where it is tried.
    scale : shape (D,), rough standard deviations.

    Raises
    ------
    InputError
        if its values have another shape.  Errors raised by the function itself are handed on.
    """
    try:
        values = log_density(points)
    except Exception:
        # It may take one point alone; if it takes neither, what it says of many points is said.
        single = _of_one_point(log_density, points)
        if single is None:
            raise
        return single
    shape = np.shape(values)
    if shape == points.shape[:1]:
        return log_density
    single = _of_one_point(log_density, points)
    far = points[:1] + _FAR * scale
    if single is None or (np.ptp(single(points[:_COMPARED])) == 0 and single(far) == single(points[:1])):
        raise input_error(
            f"the log density of points {points.shape} has shape {shape}",
            "log_density",
            f"shape {points.shape[:1]}, one value per point, or a function of one point ({points.shape[1]},)",
            "sum over the parameters alone (`axis=1`), or return one number for one point",
        )
    return single


def _of_one_point(log_density: Callable[[Any], Any], points: np.ndarray) -> BatchedDensity | None:
    """Return a function of one point, vectorised; None if its value is no number."""

    def looped(at: np.ndarray) -> np.ndarray:
        return np.array([np.asarray(log_density(point)).reshape(()) for point in np.asarray(at)], dtype=float)

    tried = points[:_COMPARED]
    try:
        values = looped(tried)
    except Exception:
        return None
    vectorised = jax.jit(jax.vmap(lambda point: jnp.reshape(jnp.asarray(log_density(point)), ())))
    try:
        same = np.array_equal(np.isfinite(vectorised(tried)), np.isfinite(values))
        close = same and np.allclose(vectorised(tried), values, rtol=1e-3, equal_nan=True)
    # Whatever JAX does not take: it branches on values, or calls other programs.
    except Exception:
        close = False
    return vectorised if close else looped
