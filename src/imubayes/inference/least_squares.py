"""Nonlinear least squares: Levenberg–Marquardt (optimistix) with two linear solvers.

`GramCholesky` works on the column-scaled normal equations: half the digits, a tenth of the time.  It is for problems
whose prior keeps the matrix well conditioned.  For bare least squares the default is QR.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.flatten_util
import jax.numpy as jnp
import lineax as lx
import optimistix as optx

from imubayes.types import Array, Bool, Float, Int, Scalar


class GramCholesky(lx.AbstractLinearSolver[Any]):
    """Least squares through the Cholesky factor of AᵀA, columns scaled to unit length."""

    def init(self, operator, options):
        matrix = operator.as_matrix()
        scale = jnp.sqrt(jnp.sum(matrix**2, axis=0))
        scale = jnp.where(scale > 0, scale, 1.0)
        scaled = matrix / scale
        unravel = jax.flatten_util.ravel_pytree(
            jax.tree.map(lambda s: jnp.zeros(s.shape, s.dtype), operator.in_structure())
        )[1]
        return jax.scipy.linalg.cho_factor(scaled.T @ scaled, lower=True)[0], scaled, scale, eqx.Partial(unravel)

    def compute(self, state, vector, options):
        factor, scaled, scale, unravel = state
        flat, _ = jax.flatten_util.ravel_pytree(vector)
        solution = jax.scipy.linalg.cho_solve((factor, True), scaled.T @ flat) / scale
        return unravel(solution), lx.RESULTS.successful, {}

    def transpose(self, state, options):
        raise TypeError("the solver of a least-squares step is never transposed")

    def conj(self, state, options):
        return state, options

    def assume_full_rank(self) -> bool:
        return True


class LeastSquares(eqx.Module):
    """Outcome of a least-squares fit.

    Attributes
    ----------
    value : shape (P,), where it ended.
    steps : number of steps taken.
    successful : whether the steps became smaller than the tolerance.
    """

    value: Float[Array, " P"]
    steps: Int[Array, ""]
    successful: Bool[Array, ""]


def minimise(
    residual: Callable,
    guess: Float[Array, " P"],
    arguments: Any = None,
    tolerance: float = 1e-9,
    most_steps: int = 100,
    linear_solver: lx.AbstractLinearSolver | None = None,
) -> LeastSquares:
    """Return the minimum of ½ |residual(x, arguments)|².

    Parameters
    ----------
    residual : differentiable function of x, shape (P,), and arguments.
    guess : where to begin, shape (P,).
    tolerance : relative and absolute, of x and of the residual.
    most_steps : after so many steps the outcome is not successful.
    linear_solver : of the damped Newton step; QR where None.
    """
    solver = optx.LevenbergMarquardt(
        rtol=tolerance, atol=tolerance, linear_solver=linear_solver or lx.QR(), norm=optx.max_norm
    )
    solution = optx.least_squares(residual, solver, guess, args=arguments, max_steps=most_steps, throw=False)
    return LeastSquares(solution.value, solution.stats["num_steps"], solution.result == optx.RESULTS.successful)


def covariance(jacobian: Float[Array, "E P"], variance: Scalar | float = 1.0) -> Float[Array, "P P"]:
    """Return variance · (JᵀJ)⁻¹ from the QR of the column-scaled Jacobian.

    (JᵀJ)⁻¹ formed directly squares the condition number, which loses all digits on badly scaled problems.
    """
    scale = jnp.sqrt(jnp.sum(jacobian**2, axis=0))
    scale = jnp.where(scale > 0, scale, 1.0)
    upper = jnp.linalg.qr(jacobian / scale, mode="r")
    inverse = jax.scipy.linalg.solve_triangular(upper, jnp.eye(upper.shape[0])) / scale[:, None]
    return variance * inverse @ inverse.T
