"""What the data know about θ at any noise scales, from blocks that are stored once.

The offset that all rows of a run share moves their mean alone, so knowledge falls into two parts.  Differences within a
run do not feel the scatter between runs: with scales d_j = log s_j(h)/s_j(ĥ) their precision and gradient are
Σ_j exp(−2 d_j) of one block a scale, exact for independent noise.  A correlation φ of rows multiplies the blocks of its
rows as it does their information on the mean of a run.  The mean of run
and channel g has variance T_g(h) + 1/n_g(h), T_g the shared variance and n_g the information of its rows on the mean,
whatever the ratio of the two; run means of the same variance at every h are one block together.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from imubayes.array_shapes import Array, Float, Int
from imubayes.gather import take
from imubayes.inference.posterior_mode import Mode
from imubayes.inference.posterior_precision import Linearised, knowledge
from imubayes.kept_programs import kept
from imubayes.model.noise_covariance import group_sum, noise_distribution, row_correlations, rows_correlate, whitener
from imubayes.model.problem import Problem, prior_widths
from imubayes.model.robust_likelihood import pseudo_values
from imubayes.noise.base import EntryNoise, SeriesNoise, SharedNoise, TailNoise

# Run means are of one class where their variances agree to this, relative, at the mode and at a few points besides.
_DIGITS, _PROBES = 9, 3
# Products up to which the precision of correlated rows is computed anew for each draw: half a millisecond.
_MOST_WORK = 5e6


class PrecisionBlocks(eqx.Module):
    """Precision and gradient of θ about the mode, in parts that scale each by its own number.

    Attributes
    ----------
    h : shape (H,), hyperparameters of the mode.
    z : shape (P,), parameters of the mode.
    within, within_gradient : shapes (H, P, P) and (H, P), what shrinks with each scale.
    fixed, fixed_gradient : shapes (P, P) and (P,), what no scale changes.
    between, between_gradient : shapes (K, P, P) and (K, P), what run means of each class know at variance 1.
    member : shape (K,), a run and channel of each class.
    rows : shape (H, G), share of the rows on which each scale acts in every run and channel; 0 for what is no scale.
    """

    h: Float[Array, " H"]
    z: Float[Array, " P"]
    within: Float[Array, "H P P"]
    within_gradient: Float[Array, "H P"]
    fixed: Float[Array, "P P"]
    fixed_gradient: Float[Array, " P"]
    between: Float[Array, "K P P"]
    between_gradient: Float[Array, "K P"]
    member: Int[Array, " K"]
    rows: Float[Array, "H G"]


class Parts(eqx.Module):
    """Knowledge within runs, (P, P) and (P,), and the mean of each: Jacobian (G, P) and misfit (G,)."""

    precision: Float[Array, "P P"]
    gradient: Float[Array, " P"]
    mean: Float[Array, "G P"]
    mean_misfit: Float[Array, " G"]


class ExactPrecision(eqx.Module):
    """Precision of θ computed anew at every h, for noise whose parameters are no scales of independent parts.

    Attributes
    ----------
    about : the model linearised about the mode.
    """

    about: Linearised


def conditional(
    blocks: PrecisionBlocks | ExactPrecision, problem: Problem, h: Float[Array, " H"]
) -> tuple[Float[Array, "P P"], Float[Array, " P"]]:
    """Return precision (P, P) and gradient (P,) of the log density of θ given h, about the mode."""
    if isinstance(blocks, ExactPrecision):
        known, prior = knowledge(problem, blocks.about, h), prior_widths(problem, h) ** -2
        return known.precision + jnp.diag(prior), known.gradient - prior * blocks.about.z
    values = problem.hyper_priors.values
    shrink = (values(blocks.h) / values(h)) ** 2
    if rows_correlate(problem):
        shrink = shrink * (1 + blocks.rows @ (_of_means(problem, h) / _of_means(problem, blocks.h) - 1))
    weight = 1 / take(mean_variances(problem, h), blocks.member)
    prior_precision = prior_widths(problem, h) ** -2
    precision = jnp.tensordot(shrink, blocks.within, 1) + jnp.tensordot(weight, blocks.between, 1)
    gradient = shrink @ blocks.within_gradient + weight @ blocks.between_gradient + blocks.fixed_gradient
    return precision + blocks.fixed + jnp.diag(prior_precision), gradient - prior_precision * blocks.z


def _of_means(problem: Problem, h: Float[Array, " H"]) -> Float[Array, " G"]:
    """Return what correlation leaves of the information of a run on its mean, 1ᵀR⁻¹1/n of AR(1), rows not masked."""
    correlation = row_correlations(problem, problem.hyper_priors.values(h))
    count = jnp.maximum(group_sum(jnp.where(problem.observations.weight > 0, 1.0, 0.0), problem.observations), 1.0)
    return (1 - (1 - 2 / jnp.maximum(count, 2.0)) * correlation) / (1 + correlation)


def precision_blocks(problem: Problem, mode: Mode) -> PrecisionBlocks | ExactPrecision:
    """Return the blocks about a mode."""
    if problem.timeline is not None or _small_and_correlated(problem):
        return ExactPrecision(mode.about)
    member, class_of, shared = _classes(problem, mode.h)
    return _precision_blocks(problem, mode, jnp.asarray(shared), jnp.asarray(class_of), jnp.asarray(member))


def _small_and_correlated(problem: Problem) -> bool:
    """Whether rows are correlated and the exact precision is cheap.

    In the blocks the rows of a run weigh alike; as φ nears 1 its ends weigh more than all between.
    """
    work = len(problem.observations.value) * problem.size[0] ** 2
    return work <= _MOST_WORK and rows_correlate(problem)


@kept
def mean_variances(problem: Problem, h: Float[Array, " H"]) -> Float[Array, " G"]:
    """Return the variance of the mean of each run and channel, shared variance included; ∞ where all is masked."""
    information = group_sum(whitener(problem, h).direction ** 2, problem.observations)
    return noise_distribution(problem, h).shared_variance + 1 / information


def _classes(problem: Problem, h: Float[Array, " H"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return a member of each class of run means, (K,), the class of each, (G,), and whether it shares noise, (G,)."""
    acts = [np.asarray(layer.acts) for layer in problem.noise if issubclass(layer.noise, SharedNoise)]
    shared = np.sum(acts, axis=0) > 0 if acts else np.zeros(problem.observations.members.shape[0], bool)
    away = np.random.default_rng(0).normal(size=(_PROBES, len(h)))
    variances = np.stack([np.asarray(mean_variances(problem, h + step)) for step in (np.zeros(len(h)), *away)], axis=-1)
    shared &= np.isfinite(variances).all(axis=-1)
    class_of = np.full(len(shared), -1)
    if not shared.any():
        return np.zeros(0, int), class_of, shared
    signature = np.round(np.log(variances[shared]), _DIGITS)
    _, first, class_of[shared] = np.unique(signature, axis=0, return_index=True, return_inverse=True)
    return np.flatnonzero(shared)[first], class_of, shared


def _parts(problem: Problem, about: Linearised, shared, h: Float[Array, " H"]) -> Parts:
    """Return knowledge within runs, and run means; a run without shared noise has all its knowledge within."""
    by, observations = whitener(problem, h), problem.observations
    jacobian, misfit = by.scale(about.jacobian), by.scale(pseudo_values(problem, h, about.misfit))
    direction = by.direction
    information = group_sum(direction**2, observations)
    safe = jnp.where(information > 0, information, 1.0)
    mean = group_sum(direction[:, None] * jacobian, observations) / safe[:, None]
    mean_misfit = group_sum(direction * misfit, observations) / safe
    taken = jnp.where(shared, information, 0.0)
    precision = jacobian.T @ jacobian - mean.T @ (taken[:, None] * mean)
    return Parts(precision, jacobian.T @ misfit - mean.T @ (taken * mean_misfit), mean, mean_misfit)


@kept
def _precision_blocks(problem: Problem, mode: Mode, shared, class_of, member) -> PrecisionBlocks:
    def within(h):
        parts = _parts(problem, mode.about, shared, h)
        return parts.precision, parts.gradient

    def per_scale(direction):
        _, (precision, gradient) = jax.jvp(within, (mode.h,), (direction,))
        return -0.5 * precision, -0.5 * gradient

    values = problem.hyper_priors.values
    slopes = jax.vmap(lambda seed: jax.jvp(values, (mode.h,), (seed,))[1])(jnp.eye(mode.h.shape[0]))
    # One after the other: all at once they are scales × readings × parameters.
    blocks, gradients = jax.lax.map(per_scale, jnp.diag(values(mode.h) / jnp.diagonal(slopes)))
    # Tails and correlations shape the distribution of the noise and are no scales.
    scales = _is_scale(problem)
    blocks, gradients = scales[:, None, None] * blocks, scales[:, None] * gradients
    parts = _parts(problem, mode.about, shared, mode.h)

    def of_class(number):
        chosen = jnp.where(class_of == number, 1.0, 0.0)
        return parts.mean.T @ (chosen[:, None] * parts.mean), parts.mean.T @ (chosen * parts.mean_misfit)

    between, between_gradients = jax.vmap(of_class)(jnp.arange(member.shape[0]))
    fixed, fixed_gradient = parts.precision - blocks.sum(0), parts.gradient - gradients.sum(0)
    return PrecisionBlocks(
        mode.h, mode.z, blocks, gradients, fixed, fixed_gradient, between, between_gradients, member, _rows(problem)
    )


def _rows(problem: Problem) -> Float[Array, "H G"]:
    """Return the share of the rows on which each scale acts in every run and channel."""
    observations = problem.observations
    found = jnp.zeros((len(problem.hyper_priors.order), observations.members.shape[0]))
    for layer in problem.noise:
        if issubclass(layer.noise, EntryNoise):
            for place in layer.places.values():
                found = found.at[place, observations.group].add(layer.acts)
    total = found.sum(axis=1, keepdims=True)
    return jnp.where(total > 0, found / jnp.where(total > 0, total, 1.0), 0.0)


def _is_scale(problem: Problem) -> Float[Array, " H"]:
    """Return 1 for a hyperparameter that scales the noise, 0 for one that shapes its distribution."""
    found = jnp.ones(len(problem.hyper_priors.order))
    for layer in problem.noise:
        if issubclass(layer.noise, TailNoise | SeriesNoise):
            for place in layer.places.values():
                found = found.at[place].min(1 - layer.acts)
    return found
