"""Precision of θ at any noise scales, from blocks stored once, and coordinates of the scales for correlated noise.

The offset that all rows of a run share moves their mean alone, so knowledge falls into two parts.  Differences within a
run do not feel the scatter between runs: with scales d_j = log s_j(h)/s_j(ĥ) their precision and gradient are Σ_j
exp(−2 d_j) of one block a scale, exact for independent noise.  A correlation φ of rows multiplies the blocks of its
rows as it does their information on the mean of a run.  The mean of run and channel g has variance T_g(h) + 1/n_g(h),
T_g the shared variance and n_g the information of its rows on the mean, whatever the ratio of the two; run means of the
same variance at every h are one block together.

Correlated noise makes a ridge in the posterior of its scales.  Of AR(1) noise r_k = φ r_(k−1) + √(1 − φ²) ε_k a series
tells the standard deviation of the innovations, σ √(1 − φ²), at once, and σ and φ only after many correlation times: as
φ nears 1 both grow together, along a curve (Box and Jenkins).  With the scale of the innovations in place of that of
the noise there is no ridge: in the logarithm of σ √(1 − φ²) the curve is straight.  The shear that leads there does not
change φ, so its determinant is 1.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from imubayes.compiled.kept_programs import kept
from imubayes.foundations.arrays import Array, Float, Int, take
from imubayes.inference.laplace_marginal import Linearised, knowledge
from imubayes.inference.posterior_mode import Mode
from imubayes.model.likelihood import pseudo_values
from imubayes.model.noise_covariance import (
    group_sum,
    noise_distribution,
    row_correlations,
    rows_correlate,
    whitener,
)
from imubayes.model.problem import Problem, prior_widths
from imubayes.noise.components import EntryNoise, SeriesNoise, SharedNoise, TailNoise

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
def run_means(problem: Problem, h: Float[Array, " H"]) -> tuple[Float[Array, " G"], Float[Array, " G"]]:
    """Return of the mean of each run and channel the precision within the run, and the variance its rows share."""
    precision = group_sum(whitener(problem, h).direction ** 2, problem.observations)
    return precision, noise_distribution(problem, h).shared_variance


@kept
def mean_variances(problem: Problem, h: Float[Array, " H"]) -> Float[Array, " G"]:
    """Return the variance of the mean of each run and channel, shared variance included; ∞ where all is masked."""
    precision, shared = run_means(problem, h)
    return shared + 1 / precision


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


# Least singular value, relative to the largest, that counts for how scales move the variance of a run.
_LEAST = 1e-6


class InnovationScale(eqx.Module):
    """The shear h = u + S (λ(u) − λ(ĥ)) with λ = ½ log(1 − φ²) of each run and channel.

    Attributes
    ----------
    slope : S, shape (H, G); its rows are 0 for the correlations themselves.
    at_mode : λ(ĥ), shape (G,).
    """

    slope: Float[Array, "H G"]
    at_mode: Float[Array, " G"]

    def straightened(self, problem: Problem, h: Float[Array, " H"]) -> Float[Array, " H"]:
        """Return u of noise scales h."""
        return h - self._along_ridge(problem, h)

    def scales(self, problem: Problem, straight: Float[Array, " H"]) -> Float[Array, " H"]:
        """Return the noise scales h of u."""
        return straight + self._along_ridge(problem, straight)

    def straightened_information(
        self, problem: Problem, h: Float[Array, " H"], information: Float[Array, "H H"]
    ) -> Float[Array, "H H"]:
        """Return the negative Hessian in u of a density of h at its mode, from that in h."""
        slope = jax.jacfwd(lambda straight: self.scales(problem, straight))(h)
        return slope.T @ information @ slope

    def _along_ridge(self, problem: Problem, h: Float[Array, " H"]) -> Float[Array, " H"]:
        return self.slope @ (_log_innovation(problem, h) - self.at_mode)


def innovation_scale(problem: Problem, h: Float[Array, " H"]) -> InnovationScale | None:
    """Return the shear about the mode h; None where no rows are correlated."""
    if problem.timeline is not None or not rows_correlate(problem):
        return None
    sensitivity, at_mode = _at(problem, h)
    return InnovationScale(-jnp.asarray(np.linalg.pinv(np.asarray(sensitivity), rcond=_LEAST)), at_mode)


@kept
def _at(problem: Problem, h: Float[Array, " H"]) -> tuple[Float[Array, "G H"], Float[Array, " G"]]:
    """Return how scales move the mean logarithm of the noise of each run and channel, and λ there."""

    def mean_log(h: Float[Array, " H"]) -> Float[Array, " G"]:
        own, observations = noise_distribution(problem, h).squared_scale, problem.observations
        there = jnp.where(observations.weight > 0, 1.0, 0.0)
        logarithm = jnp.where(there > 0, jnp.log(jnp.where(there > 0, own, 1.0)), 0.0)
        return 0.5 * group_sum(logarithm, observations) / jnp.maximum(group_sum(there, observations), 1.0)

    return jax.jacfwd(mean_log)(h), _log_innovation(problem, h)


def _log_innovation(problem: Problem, h: Float[Array, " H"]) -> Float[Array, " G"]:
    return 0.5 * jnp.log1p(-(row_correlations(problem, problem.hyper_priors.values(h)) ** 2))
