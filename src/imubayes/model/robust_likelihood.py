"""Heavy-tailed noise in the algebra of least squares.

Given the offset b of a run and channel, its observations are independent, each Student's t about prediction plus
offset; b is normal with variance T and is integrated out by Laplace's method.  Two normal problems represent this.  The
*least-squares form* has the same −2 log density and gradient at a point, so that Gauss–Newton applies.  The form of
*pseudo-values* has the same gradient and the Fisher information of the distribution: it gives the posterior covariance,
and residuals of variance 1 for score tests.  Without heavy tails both are the problem itself.
"""

import equinox as eqx
import jax
import jax.numpy as jnp

from imubayes.array_shapes import Array, Float
from imubayes.model.noise_covariance import (
    NoiseDistribution,
    Whitener,
    group_sum,
    noise_distribution,
    whitener,
    whitener_of,
)
from imubayes.model.problem import Problem
from imubayes.model.student_t import (
    curvature,
    deviance_root_over_slope,
    deviance_root_slope,
    fisher_information,
    irls_weight,
)
from imubayes.noise.base import TailNoise

# Iterative reweighting gains a digit in two steps; the final Newton steps carry the derivatives.
_REWEIGHTED, _NEWTON = 60, 2
# Where the observations of a run are multimodal the curvature may vanish; the reweighting step replaces Newton's.
_LEAST_CURVATURE = 0.1


def has_heavy_tails(problem: Problem) -> bool:
    """Tell whether the noise model of the problem has heavy tails."""
    return any(issubclass(layer.noise, TailNoise) for layer in problem.noise)


def with_normal_noise(problem: Problem) -> Problem:
    """Return the problem with normal noise; shapes are unchanged, so nothing is recompiled."""
    layers = tuple(
        eqx.tree_at(lambda known: known.acts, layer, jnp.zeros_like(layer.acts))
        if issubclass(layer.noise, TailNoise)
        else layer
        for layer in problem.noise
    )
    return eqx.tree_at(lambda known: known.noise, problem, layers)


def pseudo_values(problem: Problem, h: Float[Array, " H"], misfit: Float[Array, " E"]) -> Float[Array, " E"]:
    """Return the misfit, (E,), whose whitened form has the gradient of the log density."""
    noise = noise_distribution(problem, h)
    if noise.tail is None:
        return misfit
    offset, x = _offset_and_misfit(problem, noise, misfit)
    return jnp.sqrt(noise.squared_scale) * x * irls_weight(x, noise.tail) / fisher_information(noise.tail) + offset


def least_squares_form(
    problem: Problem, h: Float[Array, " H"], misfit: Float[Array, " E"]
) -> tuple[Whitener, Float[Array, " E"]]:
    """Return a whitener and the misfit it applies to: the squared norm is the data part of −2 log density."""
    noise = noise_distribution(problem, h)
    if noise.tail is None:
        return whitener(problem, h), misfit
    offset, x = _offset_and_misfit(problem, noise, misfit)
    by = whitener_of(problem, h, noise.squared_scale / deviance_root_slope(x, noise.tail) ** 2, noise.shared_variance)
    return by, jnp.sqrt(noise.squared_scale) * deviance_root_over_slope(x, noise.tail) + offset


def _offset_and_misfit(
    problem: Problem, noise: NoiseDistribution, misfit: Float[Array, " E"]
) -> tuple[Float[Array, " E"], Float[Array, " E"]]:
    """Return the offset of each entry's run and channel, and the remaining misfit in units of its scale."""
    offset = run_offsets(problem, noise, misfit)[problem.observations.group]
    return offset, (misfit - offset) / jnp.sqrt(noise.squared_scale)


def run_offsets(problem: Problem, noise: NoiseDistribution, misfit: Float[Array, " E"]) -> Float[Array, " G"]:
    """Return the most likely offset of every run and channel, (G,), output units; 0 where the model has none.

    By iterative reweighting from the median, which is robust against outliers.
    """
    observations, tail = problem.observations, noise.tail
    assert tail is not None

    def moved(offset, noise, misfit, choose):
        x = (misfit - offset[observations.group]) / jnp.sqrt(noise.squared_scale)
        precision = observations.weight / noise.squared_scale
        pull = group_sum(precision * irls_weight(x, noise.tail) * (misfit - offset[observations.group]), observations)
        stiff = group_sum(precision * irls_weight(x, noise.tail), observations)
        known = choose(group_sum(precision * curvature(x, noise.tail), observations), stiff)
        return offset + (noise.shared_variance * pull - offset) / (1 + noise.shared_variance * known)

    def newton(true, reweighted):
        return jnp.where(true > _LEAST_CURVATURE * reweighted, true, reweighted)

    still = jax.lax.stop_gradient((noise, misfit))
    offset = jax.lax.stop_gradient(_from_median(problem, noise, misfit))
    offset = jax.lax.fori_loop(0, _REWEIGHTED, lambda _, last: moved(last, *still, lambda true, stiff: stiff), offset)
    offset = jax.lax.stop_gradient(offset)
    for _ in range(_NEWTON):
        offset = moved(offset, noise, misfit, newton)
    return offset


def _from_median(problem: Problem, noise: NoiseDistribution, misfit: Float[Array, " E"]) -> Float[Array, " G"]:
    observations = problem.observations
    seen = jnp.concatenate([observations.weight > 0, jnp.zeros(1, dtype=bool)])[observations.members]
    values = jnp.concatenate([misfit, jnp.zeros(1)])[observations.members]
    count = seen.sum(axis=1)
    ordered = jnp.sort(jnp.where(seen, values, jnp.inf), axis=1)
    middle = jnp.take_along_axis(ordered, jnp.maximum(count - 1, 0)[:, None] // 2, axis=1)[:, 0]
    known = noise.shared_variance * group_sum(observations.weight / noise.squared_scale, observations)
    return jnp.where(count > 0, middle, 0.0) * known / (1 + known)
