"""The joint fit: θ by Levenberg–Marquardt at given noise scales, the noise scales by their Laplace marginal.

The joint mode of θ and σ is biased low by about p/2n; the mode of the marginal, with θ integrated out, is not.  The two
are found in turns, a few rounds of each, because θ hardly depends on the noise scales.  The outcome is a value: a
fit that did not converge says so in a sentence.
"""

from collections.abc import Callable, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from imubayes.array_shapes import Array, Bool, Float, Int, Scalar
from imubayes.inference.least_squares import GramCholesky, LeastSquares, minimise
from imubayes.inference.noise_marginal import Curvature, climb
from imubayes.inference.posterior_precision import Linearised, knowledge, linearise
from imubayes.kept_programs import kept
from imubayes.model.likelihood import log_normaliser, residuals_of
from imubayes.model.noise_covariance import whiten
from imubayes.model.problem import Problem, predict_many, prior_widths
from imubayes.model.robust_likelihood import has_heavy_tails, least_squares_form, with_normal_noise

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
    decrement: Scalar
    about: Linearised
    marginal: Curvature
    steps: Int[Array, ""]
    settled: Bool[Array, ""]
    converged: Bool[Array, ""]


def linear_residual(problem: Problem, h: Float[Array, " H"]) -> Callable:
    """Return the residual as a function of z, with the model linearised there as its second value.

    To whoever takes its derivative the residual is the linear function about the point, whose Jacobian uses the
    sparsity of the problem: one forward derivative per colour instead of one per parameter.
    """
    widths = prior_widths(problem, h)

    def residual(z):
        here = jax.lax.stop_gradient(z)
        about = linearise(problem, here)
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


class Newton(eqx.Module):
    """The Gauss–Newton step at given h, and its size, in posterior standard deviations."""

    step: Float[Array, " P"]
    decrement: Scalar


# Where a weak direction is curved, Gauss–Newton creeps along it with steps that shrink by a constant factor.
_LENGTHS = np.array([0.0, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0])


def gauss_newton(problem: Problem, about: Linearised, h: Float[Array, " H"]) -> Newton:
    """Return the step to the mode of the linearised model, and the decrement √(gᵀH⁻¹g)."""
    known, prior_precision = knowledge(problem, about, h), prior_widths(problem, h) ** -2
    total = known.precision + jnp.diag(prior_precision)
    gradient = known.gradient - prior_precision * about.z
    step = jax.scipy.linalg.cho_solve((jnp.linalg.cholesky(total), True), gradient)
    return Newton(step, jnp.sqrt(jnp.maximum(gradient @ step, 0.0)))


_gauss_newton = kept(gauss_newton)


@kept
def _heights(problem: Problem, predicted: Float[Array, "n E"], z: Float[Array, "n P"], h: Float[Array, " H"]):
    def height(predicted, z):
        misfit = problem.observations.value - predicted
        return -0.5 * jnp.sum(residuals_of(problem, misfit, z, h) ** 2) + log_normaliser(problem, h)

    return jax.vmap(height)(predicted, z)


def heights(problem: Problem, z: Sequence[Float[Array, " P"]] | np.ndarray, h: Float[Array, " H"]) -> np.ndarray:
    """Return the log density at several θ (n of shape P) and one h, −∞ where it is not finite; shape (n,)."""
    points = np.stack([np.asarray(point) for point in z])
    found = np.asarray(_heights(problem, predict_many(problem, points), points, h))
    return np.where(np.isfinite(found), found, -np.inf)


def find_mode(problem: Problem, z: Float[Array, " P"], h: Float[Array, " H"]) -> Mode:
    """Return the joint fit, started from z (P,) and h (H,).

    The parts are pure functions of arrays and vmap over a stack of problems; this loop only decides how often they are
    called.
    """
    steps, settled, about, at = 0, False, None, None
    if has_heavy_tails(problem):
        # Far from the fit every sample would pass for an outlier and have no influence.
        z = _fit_parameters(with_normal_noise(problem), z, h).value
    for _ in range(_ROUNDS):
        fitted = _fit_parameters(problem, z, h)
        steps += int(fitted.steps)
        z, about = fitted.value, fitted.aux
        before = h
        h, at = climb(problem, about, h, at.information if at is not None else None)
        settled = h.size == 0 or float(jnp.max(jnp.abs(h - before))) < _SETTLED
        if settled or not bool(jnp.all(jnp.isfinite(h))):
            break
    assert about is not None
    assert at is not None
    about, decrement, more = _polished(problem, about, h)
    return _mode(about, h, at, decrement, steps + more, settled)


def mode_near(
    problem: Problem, about: Linearised, h: Float[Array, " H"], information: Float[Array, "H H"] | None = None
) -> Mode:
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
    steps, settled, at, decrement = 0, False, None, jnp.asarray(jnp.inf)
    judged = information is None
    for _ in range(_ROUNDS):
        before = h
        h, at = climb(problem, about, h, at.information if at is not None else information, judged=judged)
        settled = h.size == 0 or float(jnp.max(jnp.abs(h - before))) < _SETTLED
        about, decrement, more = _polished(problem, about, h)
        steps += more
        if (settled and not more) or not bool(jnp.all(jnp.isfinite(h))):
            break
    assert at is not None
    return _mode(about, h, at, decrement, steps, settled)


def _polished(problem: Problem, about: Linearised, h: Float[Array, " H"]) -> tuple[Linearised, Scalar, int]:
    """Return the model about the end of Gauss–Newton steps at given h, the decrement there, and how many they were."""
    decrement, steps = jnp.asarray(jnp.inf), 0
    for _ in range(_POLISH_STEPS):
        newton = _gauss_newton(problem, about, h)
        decrement = newton.decrement
        if not float(decrement) >= _DECREMENT / 10:
            break
        ends = np.asarray(about.z) + _LENGTHS[:, None] * np.asarray(newton.step)
        best = int(np.argmax(heights(problem, ends, h)))
        if _LENGTHS[best] == 0:
            break
        steps += 1
        about = linearise(problem, jnp.asarray(ends[best]))
    return about, decrement, steps


def _mode(
    about: Linearised, h: Float[Array, " H"], at: Curvature, decrement: Scalar, steps: int, settled: bool
) -> Mode:
    parts = (decrement, h, at.value, at.gradient, at.information)
    finite = all(bool(jnp.all(jnp.isfinite(part))) for part in parts)
    converged = finite and settled and float(decrement) < _DECREMENT
    return Mode(about.z, h, decrement, about, at, jnp.asarray(steps), jnp.asarray(settled), jnp.asarray(converged))


def fit_at(problem: Problem, z: Float[Array, " P"], h: Float[Array, " H"]) -> Float[Array, " P"]:
    """Return θ at given h, started from z: the compiled form of `fit_parameters`."""
    return _fit_parameters(problem, z, h).value


def log_evidence(mode: Mode) -> float:
    """Return the Laplace estimate of log p(y), h integrated out as well."""
    _, log_determinant = np.linalg.slogdet(np.asarray(mode.marginal.information))
    return float(mode.marginal.value + 0.5 * len(mode.h) * np.log(2 * np.pi) - 0.5 * log_determinant)


def message(mode: Mode) -> str:
    """Return the sentence that says how the fit ended; empty when it converged."""
    if bool(mode.converged):
        return ""
    if not bool(jnp.isfinite(mode.decrement)):
        return "The fit did not converge: the model gave a value that is not finite."
    if not bool(mode.settled):
        return f"The fit did not converge: the noise scales still changed after {_ROUNDS} rounds."
    return (
        f"The fit did not converge: the last step was {float(mode.decrement):.2g} posterior standard deviations, "
        f"more than {_DECREMENT:g}."
    )
