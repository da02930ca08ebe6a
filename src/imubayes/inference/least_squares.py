"""The outcome of a least-squares fit, and the covariance of its parameters.

The minimiser is in `levenberg_marquardt`, which a process loads only if it compiles a fit.
"""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jax.scipy.linalg import solve_triangular

from imubayes.foundations.arrays import Array, Bool, Float, Int, Scalar


class LeastSquares(eqx.Module):
    """Outcome of a least-squares fit.

    Attributes
    ----------
    value : shape (P,), the end point.
    aux : second return value of the residual there, see `levenberg_marquardt.minimise`.
    steps : number of steps.
    successful : whether the end point is a minimum.
    """

    value: Float[Array, " P"]
    aux: Any
    steps: Int[Array, ""]
    successful: Bool[Array, ""]


def covariance(jacobian: Float[Array, "E P"], variance: Scalar | float = 1.0) -> Float[Array, "P P"]:
    """Return variance · (JᵀJ)⁻¹ from the QR of the column-scaled Jacobian.

    Forming JᵀJ squares the condition number, which loses all digits in badly scaled problems.
    """
    scale = jnp.sqrt(jnp.sum(jacobian**2, axis=0))
    scale = jnp.where(scale > 0, scale, 1.0)
    upper = jnp.linalg.qr(jacobian / scale[None, :], mode="r")
    inverse = solve_triangular(upper, jnp.eye(upper.shape[0])) / scale[:, None]
    return variance * inverse @ inverse.T
