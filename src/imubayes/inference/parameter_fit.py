"""The parameters θ at given noise scales, and the model linearised about them and whitened: one program of a model.

Levenberg–Marquardt evaluates the model with its Jacobian once for each step, and returns the linearisation of the last
one.  A first step that ends it gives the linearisation about the start, so that no other program differentiates the
model.
"""

from collections.abc import Callable
from typing import TYPE_CHECKING

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from imubayes.compiled.in_numpy import in_numpy
from imubayes.compiled.kept_programs import kept
from imubayes.foundations.arrays import Array, Float, on_host
from imubayes.foundations.deferred_modules import DeferredModule
from imubayes.inference.least_squares import LeastSquares
from imubayes.model.likelihood import least_squares_form, pseudo_values
from imubayes.model.noise_covariance import whiten, whitener
from imubayes.model.problem import Problem, predict_with_jacobian, prior_widths

if TYPE_CHECKING:
    from imubayes.inference import levenberg_marquardt
else:
    # Takes long to import, and a fit whose program is kept does not trace it.
    levenberg_marquardt = DeferredModule("imubayes.inference.levenberg_marquardt")

_STEPS = 30
_TOLERANCE = 1e-3
# A tolerance that every first step is within.
_ANY = 1e100
# Levenberg–Marquardt begins with a damping of 1 on the scale of the squared residual.  The prior damps already, so the
# residual is scaled up until the first step is Gauss–Newton's; a step that fails raises the damping as usual.
_UNDAMPED = 1e3


class Linearised(eqx.Module):
    """The model about z: misfit e = y − f(z), shape (E,), and Jacobian ∂f/∂z, shape (E, P)."""

    z: Float[Array, " P"]
    misfit: Float[Array, " E"]
    jacobian: Float[Array, "E P"]


def linearised(problem: Problem, z: Float[Array, " P"]) -> Linearised:
    """Return the model linearised about z, as a part of a compiled function."""
    predicted, jacobian = predict_with_jacobian(problem, z)
    return Linearised(z, problem.observations.value - predicted, jacobian)


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


def fit_parameters(
    problem: Problem, z: Float[Array, " P"], h: Float[Array, " H"], tolerance: Float[Array, ""] | float = _TOLERANCE
) -> LeastSquares:
    """Return θ at given h, as a `LeastSquares` outcome with the model linearised there: Levenberg–Marquardt from z."""
    residual = linear_residual(problem, h)

    def undamped(z, _):
        value, about = residual(z)
        return _UNDAMPED * value, about

    solver = levenberg_marquardt.GramCholesky()
    return levenberg_marquardt.minimise(
        undamped, z, tolerance=tolerance, most_steps=_STEPS, linear_solver=solver, has_aux=True
    )


_fit_parameters = kept(fit_parameters)


def fitted_parameters(problem: Problem, z: Float[Array, " P"], h: Float[Array, " H"]) -> LeastSquares:
    """Return θ at given h, started from z: `fit_parameters` compiled, with arrays of NumPy."""
    return on_host(_fit_parameters(problem, *map(np.asarray, (z, h, _TOLERANCE))))


def fit_at(problem: Problem, z: Float[Array, " P"], h: Float[Array, " H"]) -> np.ndarray:
    """Return θ at given h, (P,), started from z."""
    return fitted_parameters(problem, z, h).value


def linearise(problem: Problem, z: Float[Array, " P"]) -> Linearised:
    """Return the model linearised about z, as arrays of NumPy."""
    found = _fit_parameters(problem, *map(np.asarray, (z, np.zeros(problem.size[1]), _ANY)))
    return on_host(found.aux)


# At most some 7 s of NumPy (1e9 values take 1.4 s): to compile the program of a fit takes 10 s and more.
_linearised_in_numpy = in_numpy(linearised, most_values=5_000_000_000)


def linearise_once(problem: Problem, z: Float[Array, " P"]) -> Linearised:
    """Return the same as `linearise`, for a model that is not fitted: compiling it would take longer."""
    return on_host(_linearised_in_numpy(problem, np.asarray(z)))


def whitened_columns(problem: Problem, h: Float[Array, " H"], columns: np.ndarray) -> np.ndarray:
    """Return columns (E, …), in output units, whitened by the noise at scales h."""
    return whiten(problem, whitener(problem, np.asarray(h)), np.asarray(columns))


def whitened_about(
    problem: Problem, about: Linearised, h: Float[Array, " H"]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return whitened residual (E,), whitened Jacobian (E, P) and prior widths (P,) at noise scales h."""
    h, about = np.asarray(h), on_host(about)
    by = whitener(problem, h)
    residual = whiten(problem, by, pseudo_values(problem, h, about.misfit))
    return residual, whiten(problem, by, about.jacobian), prior_widths(problem, h)
