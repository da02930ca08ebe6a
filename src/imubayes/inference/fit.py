"""The joint fit: θ by Levenberg–Marquardt at given noise scales, the noise scales by their Laplace marginal.

The joint mode of θ and σ is biased low by about p/2n; the mode of the marginal, with θ integrated out, is not.  The two
are found in turns, a few rounds of each, because θ hardly depends on the noise scales.  The outcome is a value: a fit that
did not converge says so in a sentence.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx

from imubayes.inference.least_squares import GramCholesky, minimise
from imubayes.inference.precision import Linearised, knowledge, linearise, log_marginal
from imubayes.model.likelihood import (
    Problem,
    predict,
    prediction_jacobian,
    prior_widths,
    whiten,
    whitener,
)
from imubayes.types import Array, Bool, Float, Int, Scalar

# A Newton decrement of 0.01 moves no estimate by more than a hundredth of its standard deviation.
_DECREMENT = 1e-2
# Rounds of θ and h in turns; the change of h per round, in units of its prior, that ends them.
_ROUNDS, _SETTLED = 8, 1e-3
_STEPS, _HYPER_STEPS = 60, 200


class Mode(eqx.Module):
    """Where the joint fit ended.

    Attributes
    ----------
    z, h : shapes (P,) and (H,).
    decrement : √(gᵀH⁻¹g), the size of the step still to go, in posterior standard deviations.
    log_evidence : Laplace estimate of log p(y) given ĥ, less the width of h.
    steps : Levenberg–Marquardt steps in all.
    settled : whether h no longer changed.
    converged : whether all of it converged.
    """

    z: Float[Array, " P"]
    h: Float[Array, " H"]
    decrement: Scalar
    log_evidence: Scalar
    steps: Int[Array, ""]
    settled: Bool[Array, ""]
    converged: Bool[Array, ""]


def sparse_residual(problem: Problem, h: Float[Array, " H"]):
    """Return the residual as a function of z whose derivative uses the sparsity of the problem.

    The Jacobian is formed once, from one forward derivative per colour, instead of one per parameter.
    """
    by, widths = whitener(problem, h), prior_widths(problem, h)

    @jax.custom_jvp
    def residual(z):
        data = whiten(problem, by, problem.observations.value - predict(problem, z))
        return jnp.concatenate([data, z / widths])

    @residual.defjvp
    def push(primals, tangents):
        (z,), (tangent,) = primals, tangents
        jacobian = prediction_jacobian(problem, z)
        whitened = jax.vmap(lambda column: whiten(problem, by, column), 1, 1)(jacobian)
        return residual(z), jnp.concatenate([-whitened @ tangent, tangent / widths])

    return residual


def fit_parameters(problem: Problem, z: Float[Array, " P"], h: Float[Array, " H"]):
    """Return θ at given h, as a `LeastSquares` outcome: Levenberg–Marquardt from z."""
    residual = sparse_residual(problem, h)
    return minimise(
        lambda one, _: residual(one), z, tolerance=1e-7, most_steps=_STEPS, linear_solver=GramCholesky()
    )


def fit_hyperparameters(problem: Problem, about: Linearised, h: Float[Array, " H"]) -> Float[Array, " H"]:
    """Return the h that maximises the Laplace marginal of the linearised model."""
    solver = optx.BFGS(rtol=1e-4, atol=1e-4)
    return optx.minimise(
        lambda one, _: -log_marginal(problem, about, one), solver, h, max_steps=_HYPER_STEPS, throw=False
    ).value


def find_mode(problem: Problem, z: Float[Array, " P"], h: Float[Array, " H"]) -> Mode:
    """Return the joint fit, started from z and h."""

    def one_round(state):
        z, h, _, steps, rounds, _ = state
        fitted = fit_parameters(problem, z, h)
        found = fit_hyperparameters(problem, linearise(problem, fitted.value), h)
        change = jnp.max(jnp.abs(found - h), initial=0.0)
        return fitted.value, found, change, steps + fitted.steps, rounds + 1, fitted.successful

    def unsettled(state):
        _, _, change, _, rounds, _ = state
        return (rounds < _ROUNDS) & (change > _SETTLED)

    begin = (z, h, jnp.asarray(jnp.inf), jnp.asarray(0), jnp.asarray(0), jnp.asarray(False))
    z, h, change, steps, _, _ = jax.lax.while_loop(unsettled, one_round, begin)
    about = linearise(problem, z)
    known, prior_precision = knowledge(problem, about, h), prior_widths(problem, h) ** -2
    total = known.precision + jnp.diag(prior_precision)
    gradient = known.gradient - prior_precision * z
    step = jax.scipy.linalg.cho_solve((jnp.linalg.cholesky(total), True), gradient)
    decrement = jnp.sqrt(jnp.maximum(gradient @ step, 0.0))
    settled = change <= _SETTLED
    finite = jnp.all(jnp.isfinite(z)) & jnp.all(jnp.isfinite(h)) & jnp.isfinite(decrement)
    # The last Newton step is taken: it is the cheapest digit there is.
    better = jnp.where(finite & (decrement < 1.0), z + step, z)
    evidence = log_marginal(problem, about, h)
    return Mode(better, h, decrement, evidence, steps, settled, finite & settled & (decrement < _DECREMENT))


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
