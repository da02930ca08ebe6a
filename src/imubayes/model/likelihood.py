"""Likelihood: whitened residuals and log density from the parameters, with normal or heavy-tailed noise.

The functions are pure functions of a `Problem`.  With θ in z (prior: standard normal) and hyperparameters h in z, the
log density is −½ |r|² − ½ log det Σ(h) + const with r = [L⁻¹(y − f(θ)), (z_θ)/s(h), z_h]; s(h) is 1 except for
parameters whose prior width is itself learnt.

Heavy-tailed noise enters the algebra of least squares through two normal problems.  Given the offset b of a run and
channel, its observations are independent, each Student's t about prediction plus offset; b is normal with variance T
and is integrated out by Laplace's method.  The *least-squares form* has the same −2 log density and gradient at a
point, so that Gauss–Newton applies; under heavy tails r is its residual.  The form of *pseudo-values* has the same
gradient and the Fisher information of the distribution: it gives the posterior covariance, and residuals of variance 1
for score tests.  Without heavy tails both are the problem itself.
"""

import equinox as eqx
import numpy as np

from imubayes.foundations.arrays import Array, Float, Scalar, fixed, namespace, repeat
from imubayes.model.noise_covariance import (
    NoiseDistribution,
    Whitener,
    curvature,
    deviance,
    deviance_root_over_slope,
    deviance_root_slope,
    fisher_information,
    group_sum,
    inverse_covariance,
    irls_weight,
    log_determinant_correction,
    noise_distribution,
    normaliser,
    whiten,
    whitener,
    whitener_of,
)
from imubayes.model.problem import Problem, hyper_prior_square, predict, prior_widths
from imubayes.noise.components import TailNoise

# Iterative reweighting gains a digit in two steps; the final Newton steps carry the derivatives.
_REWEIGHTED, _NEWTON = 60, 2
# If the observations of a run are multimodal the curvature may vanish; the reweighting step replaces Newton's.
_LEAST_CURVATURE = 0.1


def has_heavy_tails(problem: Problem) -> bool:
    """Return whether the noise model of the problem has heavy tails."""
    return any(issubclass(layer.noise, TailNoise) for layer in problem.noise)


def with_normal_noise(problem: Problem) -> Problem:
    """Return the problem with normal noise; shapes are unchanged, so nothing is recompiled."""
    layers = tuple(
        eqx.tree_at(lambda known: known.acts, layer, 0.0 * layer.acts) if issubclass(layer.noise, TailNoise) else layer
        for layer in problem.noise
    )
    return eqx.tree_at(lambda known: known.noise, problem, layers)


def pseudo_values(problem: Problem, h: Float[Array, " H"], misfit: Float[Array, " E"]) -> Float[Array, " E"]:
    """Return the misfit, (E,), whose whitened form has the gradient of the log density."""
    noise = noise_distribution(problem, h)
    if noise.tail is None:
        return misfit
    offset, x = _offset_and_misfit(problem, noise, misfit)
    return noise.scale * x * irls_weight(x, noise.tail) / fisher_information(noise.tail) + offset


def least_squares_form(
    problem: Problem, h: Float[Array, " H"], misfit: Float[Array, " E"]
) -> tuple[Whitener, Float[Array, " E"]]:
    """Return a whitener and the misfit it applies to: the squared norm is the data part of −2 log density."""
    noise = noise_distribution(problem, h)
    if noise.tail is None:
        return whitener(problem, h), misfit
    offset, x = _offset_and_misfit(problem, noise, misfit)
    by = whitener_of(problem, h, noise.squared_scale / deviance_root_slope(x, noise.tail) ** 2, noise.shared_variance)
    return by, noise.scale * deviance_root_over_slope(x, noise.tail) + offset


def _offset_and_misfit(
    problem: Problem, noise: NoiseDistribution, misfit: Float[Array, " E"]
) -> tuple[Float[Array, " E"], Float[Array, " E"]]:
    """Return the offset of each entry's run and channel, and the remaining misfit in units of its scale."""
    offset = run_offsets(problem, noise, misfit)[problem.observations.group]
    return offset, (misfit - offset) / noise.scale


def run_offsets(problem: Problem, noise: NoiseDistribution, misfit: Float[Array, " E"]) -> Float[Array, " G"]:
    """Return the most likely offset of every run and channel, (G,), output units; 0 where the model has none.

    By iterative reweighting from the median, which is robust against outliers.
    """
    observations, tail = problem.observations, noise.tail
    assert tail is not None

    def moved(offset, noise, misfit, choose):
        x = (misfit - offset[observations.group]) / noise.scale
        precision = observations.weight / noise.squared_scale
        pull = group_sum(precision * irls_weight(x, noise.tail) * (misfit - offset[observations.group]), observations)
        stiff = group_sum(precision * irls_weight(x, noise.tail), observations)
        known = choose(group_sum(precision * curvature(x, noise.tail), observations), stiff)
        return offset + (noise.shared_variance * pull - offset) / (1 + noise.shared_variance * known)

    def newton(true, reweighted):
        return namespace(true).where(true > _LEAST_CURVATURE * reweighted, true, reweighted)

    still_noise, still = fixed(noise), fixed(misfit)
    offset = fixed(_from_median(problem, noise, misfit))
    offset = fixed(repeat(_REWEIGHTED, lambda last: moved(last, still_noise, still, lambda true, stiff: stiff), offset))
    for _ in range(_NEWTON):
        offset = moved(offset, noise, misfit, newton)
    return offset


def _from_median(problem: Problem, noise: NoiseDistribution, misfit: Float[Array, " E"]) -> Float[Array, " G"]:
    observations = problem.observations
    xp = namespace(misfit, observations.weight, noise.squared_scale)
    seen = xp.concatenate([observations.weight > 0, xp.zeros(1, dtype=bool)])[observations.members]
    values = xp.concatenate([misfit, xp.zeros(1)])[observations.members]
    count = seen.sum(axis=1)
    ordered = xp.sort(xp.where(seen, values, xp.inf), axis=1)
    middle = xp.take_along_axis(ordered, xp.maximum(count - 1, 0)[:, None] // 2, axis=1)[:, 0]
    known = noise.shared_variance * group_sum(observations.weight / noise.squared_scale, observations)
    return xp.where(count > 0, middle, 0.0) * known / (1 + known)


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
    parts = whitened(problem, h, misfit), z / prior_widths(problem, h)
    return namespace(*parts).concatenate(parts)


def log_normaliser(problem: Problem, h: Float[Array, " H"]) -> Scalar:
    """Return the terms of the log density that depend on h alone, including its prior."""
    whitening = whitener(problem, h)
    widths = prior_widths(problem, h)
    widths, entries = namespace(widths).log(widths).sum(), problem.observations.weight.sum()
    constant = 0.5 * np.log(2 * np.pi) * (entries + problem.size[0] + problem.size[1])
    return -0.5 * whitening.log_determinant - widths - 0.5 * hyper_prior_square(problem, h) - constant


def log_density(problem: Problem, z: Float[Array, " P"], h: Float[Array, " H"]) -> Scalar:
    """Return the joint log density of data, parameters and hyperparameters, in z."""
    r = residuals(problem, z, h)
    return -0.5 * (r**2).sum() + log_normaliser(problem, h)


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
    pseudo, xp = pseudo_values(problem, h, residual), namespace(residual, h, observations.weight)
    pulled, precision = inverse_covariance(problem, whitening, pseudo)
    seen = observations.weight > 0
    safe = xp.where(seen, precision, 1.0)
    two_pi = np.log(2 * np.pi)
    if noise.tail is None:
        entry = xp.log(safe) - pulled**2 / safe
    else:
        own = xp.where(seen, whitening.precision_root, 1.0) ** -2
        variance = noise.squared_scale + xp.maximum(1 / safe - own, 0.0)
        left = (residual - pseudo + pulled / safe) / xp.sqrt(variance)
        entry = -xp.log(variance) - deviance(left, noise.tail) - normaliser(noise.tail)
    root = xp.where(seen, whitening.precision_root, 1.0)
    shrunk = 1 - whitening.shrink * group_sum(whitening.direction**2, observations)
    log_determinant = -2 * group_sum(xp.log(root), observations) - 2 * xp.log(shrunk)
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
