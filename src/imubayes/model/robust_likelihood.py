"""Heavy tails in the algebra of a normal law.

Given the offset b of a run and channel its readings are independent, each of Student's t about prediction and offset;
b is normal with variance T and is integrated out about its most likely value (Laplace).  Two normal problems stand for
that.  The *straightened* one has the same −2 log density at a point and the same slope, so that Gauss–Newton descends.
The one of *pseudo-values* has the same slope and the Fisher information of the law: its posterior is that of the
readings, its residuals have the variance 1 that a score test needs.  Without heavy tails both are the problem itself.
"""

import equinox as eqx
import jax
import jax.numpy as jnp

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
from imubayes.types import Array, Float

# Reweighting gains a digit in two steps; Newton's steps after it carry the derivatives.
_REWEIGHTED, _NEWTON = 60, 2
# Where the readings of a run contradict each other its curvature may vanish; Newton's step is then the reweighted one.
_LEAST_CURVATURE = 0.1


def has_heavy_tails(problem: Problem) -> bool:
    """Tell whether any reading of the problem has a heavy tail."""
    return any(issubclass(layer.noise, TailNoise) for layer in problem.noise)


def with_normal_noise(problem: Problem) -> Problem:
    """Return the problem with normal laws; its shapes stay, so that nothing is compiled again."""
    layers = tuple(
        eqx.tree_at(lambda one: one.acts, layer, jnp.zeros_like(layer.acts))
        if issubclass(layer.noise, TailNoise)
        else layer
        for layer in problem.noise
    )
    return eqx.tree_at(lambda one: one.noise, problem, layers)


def pseudo_values(problem: Problem, h: Float[Array, " H"], misfit: Float[Array, " E"]) -> Float[Array, " E"]:
    """Return the misfit, (E,), that under the whitener of the problem has the slope of the log density."""
    law = noise_distribution(problem, h)
    if law.tail is None:
        return misfit
    offset, x = _standing(problem, law, misfit)
    return jnp.sqrt(law.squared_scale) * x * irls_weight(x, law.tail) / fisher_information(law.tail) + offset


def least_squares_form(
    problem: Problem, h: Float[Array, " H"], misfit: Float[Array, " E"]
) -> tuple[Whitener, Float[Array, " E"]]:
    """Return a whitener and the misfit to be whitened by it: the squared norm is twice the fall of the log density."""
    law = noise_distribution(problem, h)
    if law.tail is None:
        return whitener(problem, h), misfit
    offset, x = _standing(problem, law, misfit)
    by = whitener_of(problem, h, law.squared_scale / deviance_root_slope(x, law.tail) ** 2, law.shared_variance)
    return by, jnp.sqrt(law.squared_scale) * deviance_root_over_slope(x, law.tail) + offset


def _standing(
    problem: Problem, law: NoiseDistribution, misfit: Float[Array, " E"]
) -> tuple[Float[Array, " E"], Float[Array, " E"]]:
    """Return the offset of each entry's run and channel, and what is left of its misfit in units of its scale."""
    offset = run_offsets(problem, law, misfit)[problem.observations.group]
    return offset, (misfit - offset) / jnp.sqrt(law.squared_scale)


def run_offsets(problem: Problem, law: NoiseDistribution, misfit: Float[Array, " E"]) -> Float[Array, " G"]:
    """Return the most likely offset of every run and channel, (G,), output units; 0 where the model has none.

    Found by reweighting from the median, which a few readings that are far off do not move.
    """
    observations, tail = problem.observations, law.tail
    assert tail is not None

    def moved(offset, law, misfit, choose):
        x = (misfit - offset[observations.group]) / jnp.sqrt(law.squared_scale)
        precision = observations.weight / law.squared_scale
        pull = group_sum(precision * irls_weight(x, law.tail) * (misfit - offset[observations.group]), observations)
        stiff = group_sum(precision * irls_weight(x, law.tail), observations)
        known = choose(group_sum(precision * curvature(x, law.tail), observations), stiff)
        return offset + (law.shared_variance * pull - offset) / (1 + law.shared_variance * known)

    def newton(true, reweighted):
        return jnp.where(true > _LEAST_CURVATURE * reweighted, true, reweighted)

    still = jax.lax.stop_gradient((law, misfit))
    offset = jax.lax.stop_gradient(_from_median(problem, law, misfit))
    offset = jax.lax.fori_loop(0, _REWEIGHTED, lambda _, one: moved(one, *still, lambda true, stiff: stiff), offset)
    offset = jax.lax.stop_gradient(offset)
    for _ in range(_NEWTON):
        offset = moved(offset, law, misfit, newton)
    return offset


def _from_median(problem: Problem, law: NoiseDistribution, misfit: Float[Array, " E"]) -> Float[Array, " G"]:
    observations = problem.observations
    seen = jnp.concatenate([observations.weight > 0, jnp.zeros(1, dtype=bool)])[observations.members]
    values = jnp.concatenate([misfit, jnp.zeros(1)])[observations.members]
    count = seen.sum(axis=1)
    ordered = jnp.sort(jnp.where(seen, values, jnp.inf), axis=1)
    middle = jnp.take_along_axis(ordered, jnp.maximum(count - 1, 0)[:, None] // 2, axis=1)[:, 0]
    known = law.shared_variance * group_sum(observations.weight / law.squared_scale, observations)
    return jnp.where(count > 0, middle, 0.0) * known / (1 + known)
