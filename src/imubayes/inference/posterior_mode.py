"""The joint fit: θ by Levenberg–Marquardt at given noise scales, the noise scales by their Laplace marginal.

The joint mode of θ and σ is biased low by about p/2n; the mode of the marginal, with θ integrated out, is not.  The two
are found in turns, a few rounds of each, because θ hardly depends on the noise scales.  The outcome is a value: a fit
that did not converge says so in a sentence.

Nonlinear least squares (optimistix) come with two kinds of damping and linear algebra.  Without a prior the damping is
Marquardt's: each parameter is scaled by the norm of its column of the Jacobian, so that the result depends neither on
the units of the parameters nor on those of the data; the linear algebra is QR.  With a prior, which keeps the matrix
well conditioned and gives all parameters one scale, `GramCholesky` solves the column-scaled normal equations, with half
the digits in a tenth of the time.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.flatten_util
import jax.numpy as jnp
import lineax as lx
import numpy as np
import optimistix as optx

from imubayes.compiled.kept_programs import kept
from imubayes.foundations.arrays import Array, Bool, Float, Int, Scalar, cho_solve, cholesky, on_host
from imubayes.inference.laplace_marginal import (
    Curvature,
    Linearised,
    climb,
    knowledge,
    linearise,
    linearised,
)
from imubayes.model.likelihood import (
    has_heavy_tails,
    least_squares_form,
    log_normaliser,
    whitened,
    with_normal_noise,
)
from imubayes.model.noise_covariance import whiten, whitener
from imubayes.model.problem import Problem, predict_many, prior_widths

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

    The scale of a parameter never decreases (Moré 1978), so that a parameter stays damped where its column vanishes far
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
    rtol: float
    atol: float
    descent: optx.AbstractDescent
    norm: Callable = optx.max_norm
    search: optx.AbstractSearch = _UpToRounding()
    verbose: Callable = eqx.field(default=lambda **_: None)


class LeastSquares(eqx.Module):
    """Outcome of a least-squares fit.

    Attributes
    ----------
    value : shape (P,), the end point.
    aux : second return value of the residual there, see `minimise`.
    steps : number of steps.
    successful : whether the end point is a minimum.
    """

    value: Float[Array, " P"]
    aux: Any
    steps: Int[Array, ""]
    successful: Bool[Array, ""]


def minimise(
    residual: Callable,
    guess: Float[Array, " P"],
    arguments: Any = None,
    tolerance: float = 1e-9,
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
        whatever ended the iteration: a plateau, where damping makes the steps short, is not a minimum.
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


def covariance(jacobian: Float[Array, "E P"], variance: Scalar | float = 1.0) -> Float[Array, "P P"]:
    """Return variance · (JᵀJ)⁻¹ from the QR of the column-scaled Jacobian.

    Forming JᵀJ squares the condition number, which loses all digits in badly scaled problems.
    """
    scale = jnp.sqrt(jnp.sum(jacobian**2, axis=0))
    scale = jnp.where(scale > 0, scale, 1.0)
    upper = jnp.linalg.qr(jacobian / scale[None, :], mode="r")
    inverse = jax.scipy.linalg.solve_triangular(upper, jnp.eye(upper.shape[0])) / scale[:, None]
    return variance * inverse @ inverse.T


# A Newton decrement of 0.01 moves no estimate by more than a hundredth of its standard deviation.
_DECREMENT = 1e-2
# Rounds of θ and h in turns; the change of h per round, in units of its prior, that ends them.
_ROUNDS, _SETTLED = 8, 1e-2
_STEPS, _POLISH_STEPS = 30, 20
_TOLERANCE = 1e-3
# Levenberg–Marquardt begins with a damping of 1 on the scale of the squared residual.  The prior damps already, so the
# residual is scaled up until the first step is Gauss–Newton's; a step that fails raises the damping as usual.
_UNDAMPED = 1e3


class Mode(eqx.Module):
    """Where the joint fit ended.

    Attributes
    ----------
    z, h : shapes (P,) and (H,).
    decrement : √(gᵀH⁻¹g), the size of the step still to go, in posterior standard deviations.
    about : the model linearised about z.
    marginal : the Laplace marginal of h at ĥ, with its curvature.
    steps : Levenberg–Marquardt steps in all.
    settled : whether h no longer changed.
    converged : whether all of it converged.
    """

    z: Float[Array, " P"]
    h: Float[Array, " H"]
    decrement: float
    about: Linearised
    marginal: Curvature
    steps: int
    settled: bool
    converged: bool


def linear_residual(problem: Problem, h: Float[Array, " H"]) -> Callable:
    """Return the residual as a function of z, with the model linearised there as its second value.

    To whoever takes its derivative the residual is the linear function about the point, whose Jacobian uses the
    sparsity of the problem: one forward derivative per colour instead of one per parameter.
    """
    widths = prior_widths(problem, h)

    def residual(z):
        here = jax.lax.stop_gradient(z)
        about = linearised(problem, here)
        by, straight = least_squares_form(problem, h, about.misfit)
        value = jnp.concatenate([whiten(problem, by, straight), here / widths])
        slope = jnp.concatenate([-whiten(problem, by, about.jacobian), jnp.diag(1 / widths)])
        return value + slope @ (z - here), about

    return residual


def fit_parameters(problem: Problem, z: Float[Array, " P"], h: Float[Array, " H"]) -> LeastSquares:
    """Return θ at given h, as a `LeastSquares` outcome with the model linearised there: Levenberg–Marquardt from z."""
    residual = linear_residual(problem, h)

    def undamped(z, _):
        value, about = residual(z)
        return _UNDAMPED * value, about

    return minimise(undamped, z, tolerance=_TOLERANCE, most_steps=_STEPS, linear_solver=GramCholesky(), has_aux=True)


_fit_parameters = kept(fit_parameters)


@dataclass(frozen=True)
class Newton:
    """The Gauss–Newton step, (P,), at given h, and its size √(gᵀH⁻¹g), in posterior standard deviations."""

    step: np.ndarray
    decrement: float


# Where a weak direction is curved, Gauss–Newton creeps along it with steps that shrink by a constant factor.
_LENGTHS = np.array([0.0, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0])


@np.errstate(all="ignore")
def gauss_newton(problem: Problem, about: Linearised, h: np.ndarray) -> Newton:
    """Return the step to the mode of the linearised model, and the decrement."""
    known, prior_precision = knowledge(problem, about, h), prior_widths(problem, h) ** -2
    gradient = known.gradient - prior_precision * about.z
    step = cho_solve(cholesky(known.precision + np.diag(prior_precision)), gradient)
    # NaN, and not 0, of a step that is none.
    return Newton(step, float(np.sqrt(np.maximum(gradient @ step, 0.0))))


@np.errstate(all="ignore")
def heights(problem: Problem, z: Sequence[np.ndarray] | np.ndarray, h: np.ndarray) -> np.ndarray:
    """Return the log density at several θ (n of shape P) and one h, −∞ where it is not finite; shape (n,)."""
    points, h = np.stack([np.asarray(point) for point in z]), np.asarray(h)
    misfits, known = problem.observations.value - predict_many(problem, points), log_normaliser(problem, h)
    widths = prior_widths(problem, h)
    if has_heavy_tails(problem):
        data = np.array([np.sum(whitened(problem, h, misfit) ** 2) for misfit in misfits])
    else:
        data = np.sum(whiten(problem, whitener(problem, h), misfits.T) ** 2, axis=0)
    found = -0.5 * (data + np.sum((points / widths) ** 2, axis=1)) + known
    return np.where(np.isfinite(found), found, -np.inf)


def find_mode(problem: Problem, z: np.ndarray, h: np.ndarray) -> Mode:
    """Return the joint fit, started from z (P,) and h (H,)."""
    steps, settled, about, at, h = 0, False, None, None, np.asarray(h)
    if has_heavy_tails(problem):
        # Far from the fit every sample would pass for an outlier and have no influence.
        z = fit_at(with_normal_noise(problem), z, h)
    for _ in range(_ROUNDS):
        fitted = _fit_parameters(problem, np.asarray(z), h)
        steps += int(fitted.steps)
        z, about = np.asarray(fitted.value), on_host(fitted.aux)
        before = h
        h, at = climb(problem, about, h, at.information if at is not None else None)
        settled = h.size == 0 or float(np.max(np.abs(h - before))) < _SETTLED
        if settled or not np.all(np.isfinite(h)):
            break
    assert about is not None
    assert at is not None
    about, decrement, more = _polished(problem, about, h)
    return _mode(about, h, at, decrement, steps + more, settled)


def mode_near(problem: Problem, about: Linearised, h: np.ndarray, information: np.ndarray | None = None) -> Mode:
    """Return the joint fit from a place close to it: h in the linearised model and Gauss–Newton steps in turns.

    For a fit of nearly the same data, whose linearisation `about` is at hand: a step or two lead there, where
    Levenberg–Marquardt would take several for each of its rounds.

    Parameters
    ----------
    problem : to be fitted.
    about, h : where to start: the linearised model, and the noise scales, shape (H,).
    information : shape (H, H), negative Hessian of the marginal of h at a fit of nearly the same data.  Where it is
        given, that of the mode is learnt from the steps alone: the mode is as good, widths of h are not.
    """
    steps, settled, at, decrement, h = 0, False, None, np.inf, np.asarray(h)
    judged = information is None
    for _ in range(_ROUNDS):
        before = h
        h, at = climb(problem, about, h, at.information if at is not None else information, judged=judged)
        settled = h.size == 0 or float(np.max(np.abs(h - before))) < _SETTLED
        about, decrement, more = _polished(problem, about, h)
        steps += more
        if (settled and not more) or not np.all(np.isfinite(h)):
            break
    assert at is not None
    return _mode(about, h, at, decrement, steps, settled)


def _polished(problem: Problem, about: Linearised, h: np.ndarray) -> tuple[Linearised, float, int]:
    """Return the model about the end of Gauss–Newton steps at given h, the decrement there, and how many they were."""
    decrement, steps, about = np.inf, 0, on_host(about)
    for _ in range(_POLISH_STEPS):
        newton = gauss_newton(problem, about, h)
        decrement = newton.decrement
        if not decrement >= _DECREMENT / 10:
            break
        ends = about.z + _LENGTHS[:, None] * newton.step
        best = int(np.argmax(heights(problem, ends, h)))
        if _LENGTHS[best] == 0:
            break
        steps += 1
        about = linearise(problem, ends[best])
    return about, decrement, steps


def _mode(about: Linearised, h: np.ndarray, at: Curvature, decrement: float, steps: int, settled: bool) -> Mode:
    parts = (decrement, h, at.value, at.gradient, at.information)
    finite = all(bool(np.all(np.isfinite(part))) for part in parts)
    return Mode(about.z, h, decrement, about, at, steps, settled, finite and settled and decrement < _DECREMENT)


def fit_at(problem: Problem, z: np.ndarray, h: np.ndarray) -> np.ndarray:
    """Return θ at given h, started from z: the compiled form of `fit_parameters`."""
    return np.asarray(_fit_parameters(problem, np.asarray(z), np.asarray(h)).value)


def log_evidence(mode: Mode) -> float:
    """Return the Laplace estimate of log p(y), h integrated out as well."""
    _, log_determinant = np.linalg.slogdet(np.asarray(mode.marginal.information))
    return float(mode.marginal.value + 0.5 * len(mode.h) * np.log(2 * np.pi) - 0.5 * log_determinant)


def message(mode: Mode) -> str:
    """Return the sentence that says how the fit ended; empty when it converged."""
    if mode.converged:
        return ""
    if not np.isfinite(mode.decrement):
        return "The fit did not converge: the model gave a value that is not finite."
    if not mode.settled:
        return f"The fit did not converge: the noise scales still changed after {_ROUNDS} rounds."
    return (
        f"The fit did not converge: the last step was {mode.decrement:.2g} posterior standard deviations, "
        f"more than {_DECREMENT:g}."
    )
