"""Parameters in, whitened residuals and log density out: pure functions of a `Problem`.

With θ in z (prior: standard normal) and hyperparameters h in z, the log density is
−½ |r|² − ½ log det Σ(h) + const with r = [L⁻¹(y − f(θ)), (z_θ)/s(h), z_h]; s(h) is 1 except for parameters whose prior
width is itself learnt.  Under heavy tails r is that of the equivalent least-squares problem
(`imubayes.model.robust_likelihood`).
"""

import equinox as eqx
import jax.numpy as jnp

from imubayes.array_shapes import Array, Float, Scalar
from imubayes.model.noise_covariance import group_sum, inverse_covariance, noise_distribution, whiten, whitener
from imubayes.model.problem import Problem, hyper_prior_square, predict, prior_widths
from imubayes.model.robust_likelihood import least_squares_form, pseudo_values
from imubayes.model.student_t import deviance, log_determinant_correction, normaliser


def whitened(problem: Problem, h: Float[Array, " H"], misfit: Float[Array, " E"]) -> Float[Array, " E"]:
    """Return L⁻¹(y − f): its squared norm is the data's part of −2 log density, up to the normaliser."""
    whitening, straight = least_squares_form(problem, h, misfit)
    return whiten(problem, whitening, straight)


def residuals(problem: Problem, z: Float[Array, " P"], h: Float[Array, " H"]) -> Float[Array, " EP"]:
    """Return [L⁻¹(y − f(θ)), z_θ/s(h)]: half its squared norm is what a fit at given h minimises."""
    return residuals_of(problem, problem.observations.value - predict(problem, z), z, h)


def residuals_of(
    problem: Problem, misfit: Float[Array, " E"], z: Float[Array, " P"], h: Float[Array, " H"]
) -> Float[Array, " EP"]:
    """Return `residuals` for a known misfit y − f(θ)."""
    return jnp.concatenate([whitened(problem, h, misfit), z / prior_widths(problem, h)])


def log_normaliser(problem: Problem, h: Float[Array, " H"]) -> Scalar:
    """Return the terms of the log density that depend on h alone, including its prior."""
    whitening = whitener(problem, h)
    widths = jnp.sum(jnp.log(prior_widths(problem, h)))
    entries = jnp.sum(problem.observations.weight)
    constant = 0.5 * jnp.log(2 * jnp.pi) * (entries + problem.size[0] + problem.size[1])
    return -0.5 * whitening.log_determinant - widths - 0.5 * hyper_prior_square(problem, h) - constant


def log_density(problem: Problem, z: Float[Array, " P"], h: Float[Array, " H"]) -> Scalar:
    """Return the joint log density of data, parameters and hyperparameters, in z."""
    r = residuals(problem, z, h)
    return -0.5 * jnp.sum(r**2) + log_normaliser(problem, h)


class EntryLikelihood(eqx.Module):
    """Log likelihood piece by piece.

    Attributes
    ----------
    entry : shape (E,), each entry given all others: log p(y_i | y_−i, θ, h).
    group : shape (G,), each run and channel as a whole.
    """

    entry: Float[Array, " E"]
    group: Float[Array, " G"]


def entry_log_likelihood(problem: Problem, residual: Float[Array, " E"], h: Float[Array, " H"]) -> EntryLikelihood:
    """Return the log likelihood of every entry and of every run and channel, for residuals y − f(θ).

    Entries of one run share an offset, so an entry's own density is conditional on the others: with Σ⁻¹ = Q its
    variance is 1/Q_ii and its residual (Q r)_i/Q_ii (Bürkner, Gabry, Vehtari, Computational Statistics 2021).  A
    heavy-tailed distribution keeps its shape about that mean; its scale grows by the uncertainty of the offset.
    """
    whitening, observations, noise = whitener(problem, h), problem.observations, noise_distribution(problem, h)
    pseudo = pseudo_values(problem, h, residual)
    pulled, precision = inverse_covariance(problem, whitening, pseudo)
    seen = observations.weight > 0
    safe = jnp.where(seen, precision, 1.0)
    two_pi = jnp.log(2 * jnp.pi)
    if noise.tail is None:
        entry = jnp.log(safe) - pulled**2 / safe
    else:
        own = jnp.where(seen, whitening.precision_root, 1.0) ** -2
        variance = noise.squared_scale + jnp.maximum(1 / safe - own, 0.0)
        left = (residual - pseudo + pulled / safe) / jnp.sqrt(variance)
        entry = -jnp.log(variance) - deviance(left, noise.tail) - normaliser(noise.tail)
    root = jnp.where(seen, whitening.precision_root, 1.0)
    shrunk = 1 - whitening.shrink * group_sum(whitening.direction**2, observations)
    log_determinant = -2 * group_sum(jnp.log(root), observations) - 2 * jnp.log(shrunk)
    if whitening.series is not None:
        log_determinant = log_determinant + group_sum(whitening.series.log_determinants(), observations)
    if noise.tail is not None:
        log_determinant = log_determinant + group_sum(
            observations.weight * log_determinant_correction(noise.tail), observations
        )
    count = group_sum(observations.weight, observations)
    gone = group_sum(whitened(problem, h, residual) ** 2, observations)
    group = -0.5 * (gone + log_determinant + count * two_pi)
    return EntryLikelihood(observations.weight * 0.5 * (entry - two_pi), group)
