"""Nonlinear least squares: Levenberg–Marquardt with two kinds of damping and linear algebra (optimistix).

Without a prior the damping is Marquardt's: each parameter is scaled by the norm of its column of the Jacobian, so that
the result depends neither on the units of the parameters nor on those of the data; the linear algebra is QR.  With a
prior, which keeps the matrix well conditioned and gives all parameters one scale, `GramCholesky` solves the
column-scaled normal equations, with half the digits in a tenth of the time.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.flatten_util
import jax.numpy as jnp
import lineax as lx
import optimistix as optx

from imubayes.foundations.arrays import Array, Bool, Float, Scalar
from imubayes.inference.least_squares import LeastSquares

# Initial damping, relative to columns of unit norm: nearly Gauss–Newton, without a leap onto a plateau.
_FIRST_DAMPING = 1e-2
# Relative change of the cost that is rounding: residuals are small differences of large observations.
_ROUNDING = 1e-11
# Largest remaining Gauss–Newton step at a minimum: relative to each parameter, or as a share of the residual norm.
_STEP_LEFT, _OFFSET_LEFT = 1e-5, 1e-4


class GramCholesky(lx.AbstractLinearSolver[Any]):
    """Least squares through the Cholesky factor of AᵀA, columns scaled to unit length."""

    def init(self, operator: lx.AbstractLinearOperator, options: dict[str, Any]) -> tuple:
        matrix = operator.as_matrix()
        scale = jnp.sqrt(jnp.sum(matrix**2, axis=0))
        scale = jnp.where(scale > 0, scale, 1.0)
        scaled = matrix / scale[None, :]
        unravel = jax.flatten_util.ravel_pytree(
            jax.tree.map(lambda s: jnp.zeros(s.shape, s.dtype), operator.in_structure())
        )[1]
        return jax.scipy.linalg.cho_factor(scaled.T @ scaled, lower=True)[0], scaled, scale, eqx.Partial(unravel)

    def compute(self, state: tuple, vector: Any, options: dict[str, Any]) -> tuple:
        factor, scaled, scale, unravel = state
        flat, _ = jax.flatten_util.ravel_pytree(vector)
        solution = jax.scipy.linalg.cho_solve((factor, True), scaled.T @ flat) / scale
        return unravel(solution), lx.RESULTS.successful, {}

    def transpose(self, state: tuple, options: dict[str, Any]) -> tuple:
        raise TypeError("the solver of a least-squares step is never transposed")

    def conj(self, state: tuple, options: dict[str, Any]) -> tuple:
        return state, options

    def assume_full_rank(self) -> bool:
        return True


class _Factorised(eqx.Module):
    """The Jacobian at the last accepted point, J = Q·upper·diag(scale), with Qᵀ·residual and ‖residual‖."""

    scale: Float[Array, " P"]
    upper: Float[Array, "P P"]
    rotated: Float[Array, " P"]
    length: Scalar


class _ScaledDescent(optx.AbstractDescent[Any, Any, _Factorised]):
    """The damped step: the least-squares solution of [J; √λ·diag(scale)] δ = [−r; 0] (Marquardt 1963).

    The scale of a parameter never decreases (Moré 1978), so that a parameter stays damped if its column vanishes far
    from the minimum.  One QR per accepted point serves all dampings tried there.
    """

    def init(self, y, f_info_struct):
        size = y.shape[0]
        return _Factorised(jnp.zeros(size), jnp.eye(size), jnp.zeros(size), jnp.zeros(()))

    def query(self, y, f_info, state):
        jacobian, residual = f_info.jac.as_matrix(), f_info.residual
        scale = jnp.maximum(state.scale, jnp.sqrt(jnp.sum(jacobian**2, axis=0)))
        scale = jnp.where(scale > 0, scale, 1.0)
        q, upper = jnp.linalg.qr(jacobian / scale[None, :])
        return _Factorised(scale, upper, q.T @ residual, jnp.linalg.norm(residual))

    def step(self, step_size, state):
        damping = _FIRST_DAMPING / jnp.maximum(step_size, jnp.finfo(step_size.dtype).tiny)
        size = state.scale.shape[0]
        q, upper = jnp.linalg.qr(jnp.concatenate([state.upper, jnp.sqrt(damping) * jnp.eye(size)]))
        step = jax.scipy.linalg.solve_triangular(upper, q[:size].T @ state.rotated)
        return -step / state.scale, optx.RESULTS.successful


class _ScaledLevenbergMarquardt(optx.AbstractGaussNewton[Any, Any, Any]):
    rtol: float
    atol: float
    norm: Callable = optx.max_norm
    descent: optx.AbstractDescent = _ScaledDescent()
    # The damping is reduced after a step that achieves three quarters of the predicted reduction (Moré 1978).
    search: optx.AbstractSearch = optx.ClassicalTrustRegion(
        high_cutoff=0.75, low_cutoff=1e-4, high_constant=3.0, low_constant=0.25
    )
    verbose: Callable = eqx.field(default=lambda **_: None)


class _UpToRounding(optx.AbstractSearch[Any, Any, Any, Any]):
    """The trust region of Levenberg–Marquardt, which also accepts steps that change the cost by rounding alone.

    Convergence is tested after accepted steps only.  At the minimum the cost changes by rounding errors; were steps
    rejected for these, the search would go on with ever shorter ones.
    """

    region: optx.ClassicalTrustRegion = optx.ClassicalTrustRegion()

    def init(self, y, f_info_struct):
        return self.region.init(y, f_info_struct)

    def step(self, first_step, y, y_eval, f_info, f_eval_info, state):
        size, accept, result, state = self.region.step(first_step, y, y_eval, f_info, f_eval_info, state)
        before, after = f_info.as_min(), f_eval_info.as_min()
        return size, accept | (jnp.abs(after - before) <= _ROUNDING * before), result, state


class _NormalEquationsLevenbergMarquardt(optx.AbstractGaussNewton[Any, Any, Any]):
    rtol: Scalar
    atol: Scalar
    descent: optx.AbstractDescent
    norm: Callable = optx.max_norm
    search: optx.AbstractSearch = _UpToRounding()
    verbose: Callable = eqx.field(default=lambda **_: None)


def minimise(
    residual: Callable,
    guess: Float[Array, " P"],
    arguments: Any = None,
    tolerance: Float[Array, ""] | float = 1e-9,
    most_steps: int = 1000,
    linear_solver: lx.AbstractLinearSolver | None = None,
    has_aux: bool = False,
) -> LeastSquares:
    """Return the minimum of ½ ‖residual(x, arguments)‖².

    Parameters
    ----------
    residual : differentiable function of x, shape (P,), and arguments.
    guess : start, shape (P,).
    tolerance : relative and absolute, of x and of the residual.
    most_steps : limit of the number of steps; a fit that reaches it is not successful.
    linear_solver : of the damped step with one scale for all parameters; None for scaled damping by QR.  In that case
        success means that the remaining undamped step is small compared with the parameters or their standard errors,
        whatever ended the iteration: a plateau, if damping makes the steps short, is not a minimum.
    has_aux : whether the residual returns a pair; its second member at the last accepted point is returned as `aux`.
    """
    pair = residual if has_aux else lambda x, given: (residual(x, given), None)
    if linear_solver is None:
        # Divided by its norm at the start, the residual has no unit.
        size = jnp.linalg.norm(pair(guess, arguments)[0])
        size = jnp.where(jnp.isfinite(size) & (size > 0), size, 1.0)

        def relative(x, given):
            value, aux = pair(x, given)
            return value / size, aux

        solution = _descended(relative, _ScaledLevenbergMarquardt(tolerance, tolerance), guess, arguments, most_steps)
        value, successful = _arrived(solution.state.descent_state, solution.value, tolerance)
    else:
        descent = optx.DampedNewtonDescent(linear_solver=linear_solver)
        solver = _NormalEquationsLevenbergMarquardt(tolerance, tolerance, descent=descent)
        solution = _descended(pair, solver, guess, arguments, most_steps)
        value, successful = solution.value, solution.result == optx.RESULTS.successful
    # `solution.aux` belongs to the previous point.
    return LeastSquares(value, solution.state.aux, solution.stats["num_steps"], successful)


def _descended(pair: Callable, solver: optx.AbstractGaussNewton, guess, arguments, most_steps: int):
    return optx.least_squares(pair, solver, guess, args=arguments, max_steps=most_steps, throw=False, has_aux=True)


def _arrived(
    at: _Factorised, value: Float[Array, " P"], tolerance: float
) -> tuple[Float[Array, " P"], Bool[Array, ""]]:
    """Return the end point and whether it is a minimum, by the remaining Gauss–Newton step, which is made if small."""
    left = jax.scipy.linalg.solve_triangular(at.upper, at.rotated) / at.scale
    small = jnp.max(jnp.abs(left) / (tolerance + jnp.abs(value))) < _STEP_LEFT
    # Relative offset (Bates & Watts 1981): the share of the residual that the parameters could still explain.
    flat = jnp.linalg.norm(at.rotated) < _OFFSET_LEFT * at.length
    perfect = at.length < tolerance
    return jnp.where(small, value - left, value), jnp.all(jnp.isfinite(left)) & (small | flat | perfect)
