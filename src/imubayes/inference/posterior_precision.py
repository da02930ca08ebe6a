"""What the data know about θ, as a function of the hyperparameters: precision, gradient and quadratic form.

About a point the model is linear, y − f ≈ e − J δ.  With Σ(h) = D + Σ_g T_g 1 1ᵀ every product with Σ⁻¹ is a
weighted sum less one rank-one term per run and channel, so the precision JᵀΣ⁻¹J costs one matrix product at any h.
Where rows are correlated J and e pass the filter of their series first.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.scipy.linalg import cho_factor, cho_solve

from imubayes.array_shapes import Array, Float, Scalar
from imubayes.kept_programs import kept
from imubayes.model.likelihood import log_normaliser, whitened
from imubayes.model.noise_covariance import group_sum, whiten, whitener
from imubayes.model.problem import Problem, predict_with_jacobian, prior_widths
from imubayes.model.robust_likelihood import has_heavy_tails, pseudo_values


class Linearised(eqx.Module):
    """The model about z: misfit e = y − f(z), shape (E,), and Jacobian ∂f/∂z, shape (E, P)."""

    z: Float[Array, " P"]
    misfit: Float[Array, " E"]
    jacobian: Float[Array, "E P"]


class Knowledge(eqx.Module):
    """Data part of the log density about z at given h: precision (P, P), gradient (P,), quadratic form eᵀΣ⁻¹e."""

    precision: Float[Array, "P P"]
    gradient: Float[Array, " P"]
    square: Scalar


# Compiled once for all who ask; what calls it from a compiled function takes it in.
@kept
def linearise(problem: Problem, z: Float[Array, " P"]) -> Linearised:
    """Return the model linearised about z."""
    predicted, jacobian = predict_with_jacobian(problem, z)
    return Linearised(z, problem.observations.value - predicted, jacobian)


def knowledge(problem: Problem, about: Linearised, h: Float[Array, " H"]) -> Knowledge:
    """Return what the data say about θ at hyperparameters h."""
    by, pseudo, observations = whitener(problem, h), pseudo_values(problem, h, about.misfit), problem.observations
    # (I − κ û ûᵀ)² = I − (2κ − κ²|u|²/|u|²…) û ûᵀ; with shrink = κ/|u|² the rank-one weight is 2·shrink − shrink²·|u|².
    weight = by.direction**2
    direction = group_sum(weight, observations)
    rank_one = 2 * by.shrink - by.shrink**2 * direction
    if by.series is not None:
        jacobian, misfit = by.scale(about.jacobian), by.scale(pseudo)
        along = group_sum(by.direction[:, None] * jacobian, observations)
        misfit_along = group_sum(by.direction * misfit, observations)
        precision = jacobian.T @ jacobian - along.T @ (rank_one[:, None] * along)
        gradient = jacobian.T @ misfit - along.T @ (rank_one * misfit_along)
        return Knowledge(precision, gradient, jnp.sum(misfit**2) - jnp.sum(rank_one * misfit_along**2))
    weighted = weight[:, None] * about.jacobian
    along, misfit_along = group_sum(weighted, observations), group_sum(weight * pseudo, observations)
    precision = about.jacobian.T @ weighted - along.T @ (rank_one[:, None] * along)
    gradient = weighted.T @ pseudo - along.T @ (rank_one * misfit_along)
    if has_heavy_tails(problem):
        return Knowledge(precision, gradient, jnp.sum(whitened(problem, h, about.misfit) ** 2))
    square = jnp.sum(weight * pseudo**2) - jnp.sum(rank_one * misfit_along**2)
    return Knowledge(precision, gradient, square)


@kept
def _precision(problem: Problem, about: Linearised, h: Float[Array, " H"]) -> Float[Array, "P P"]:
    return knowledge(problem, about, h).precision


def precision_of(problem: Problem, about: Linearised, h: Float[Array, " H"], chosen: np.ndarray) -> np.ndarray:
    """Return what chosen entries, (E,) bool, say of θ in z, without the prior; shape (P, P)."""
    weight = problem.observations.weight * jnp.asarray(chosen.astype(float))
    return np.asarray(_precision(eqx.tree_at(lambda p: p.observations.weight, problem, weight), about, h))


@kept
def whitened_jacobian(problem: Problem, about: Linearised, h: Float[Array, " H"]) -> Float[Array, "E P"]:
    """Return Σ(h)^(−½) J: the products of its columns are the precision of θ in z, without the prior."""
    return whiten(problem, whitener(problem, h), about.jacobian)


def deviations(gradients: np.ndarray, precision: np.ndarray) -> np.ndarray:
    """Return the standard deviations, (n,), of quantities with gradients (n, P) under a precision (P, P)."""
    return np.sqrt(np.sum(gradients * np.linalg.solve(precision, gradients.T).T, axis=1))


def log_marginal(problem: Problem, about: Linearised, h: Float[Array, " H"]) -> Scalar:
    """Return log p(y, h) with θ integrated out of the linearised model (the Laplace marginal of h)."""
    known = knowledge(problem, about, h)
    prior_precision = prior_widths(problem, h) ** -2
    total = known.precision + jnp.diag(prior_precision)
    gradient = known.gradient - prior_precision * about.z
    factor = cho_factor(total, lower=True)
    step = cho_solve(factor, gradient)
    log_determinant = 2 * jnp.sum(jnp.log(jnp.diagonal(factor[0])))
    fit = -0.5 * known.square - 0.5 * jnp.sum(prior_precision * about.z**2) + 0.5 * gradient @ step
    size = about.z.shape[0]
    return fit - 0.5 * log_determinant + 0.5 * size * jnp.log(2 * jnp.pi) + log_normaliser(problem, h)


def inverse_of_precision(precision: np.ndarray) -> np.ndarray:
    """Return the inverse of a positive definite matrix, (P, P).

    Some parameters of a servo table are determined to 1e-8 of their prior, and the eigenvalues of their precision
    differ by more than the rounding of the largest.  Cholesky's factor does not depend on the scale of the parameters,
    and weak directions are those of the largest variance, which rounding does not touch.
    """
    scale = np.sqrt(np.diag(precision))
    correlated = precision / np.outer(scale, scale)
    try:
        lower = np.linalg.cholesky(correlated)
    except np.linalg.LinAlgError:
        lower = np.linalg.cholesky(correlated + len(scale) * np.finfo(float).eps * np.eye(len(scale)))
    half = np.linalg.solve(lower, np.diag(1 / scale))
    return half.T @ half


def inverse_within(precision: np.ndarray, basis: np.ndarray) -> np.ndarray:
    """Return the inverse of a precision (P, P) restricted to the span of an orthonormal basis (P, S); shape (P, P).

    Its small variances are not those of the eigenvalues of the whole covariance, which have the rounding of the largest
    variance: next to directions that the data leave to the prior, 1e-16 of the latter is 1e-2 of a variance of 1e-14.
    """
    return basis @ inverse_of_precision(basis.T @ precision @ basis) @ basis.T
