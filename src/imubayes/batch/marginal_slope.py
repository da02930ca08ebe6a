"""Value and gradient of the Laplace marginal of the noise scales, from sums over groups.

The marginal depends on the noise scales through two numbers of each group of readings, their variance v and the
variance T that they share, and through the precisions W of priors whose width is learnt.  With Q the precision of the
parameters and μ the step to their mode, r = y − J μ the residuals of a group, D their relative variances, n = 1ᵀD⁻¹1,
ρ = 1ᵀD⁻¹r and κ = T / (v (v + n T)), the derivatives are those of restricted maximum likelihood (Patterson & Thompson
1971), ½ rᵀΣ⁻¹ ∂Σ Σ⁻¹r − ½ tr(P ∂Σ).  All they need of Q⁻¹ are the blocks of the groups.
"""

import jax
import jax.numpy as jnp

from imubayes.array_shapes import Array, Float, Scalar
from imubayes.batch.group_moments import (
    GroupedModel,
    GroupIndex,
    group_variances,
    log_marginal_of,
    scattered,
    scattered_vector,
)
from imubayes.gather import take
from imubayes.model.problem import Problem, prior_widths


def marginal_slope(
    problem: Problem, index: GroupIndex, model: GroupedModel, h: Float[Array, " H"]
) -> tuple[Scalar, Float[Array, " H"]]:
    """Return log p(y, h) with the parameters integrated out of the linearised model, and its gradient by h."""
    if not index.proportional:
        return jax.value_and_grad(lambda point: log_marginal_of(problem, index, model, point))(h)
    (variance, shared), of_variances = jax.vjp(lambda point: group_variances(problem, index, point), h)
    widths, of_widths = jax.vjp(lambda point: prior_widths(problem, point) ** -2, h)
    known, size = model.moments, model.z.shape[0]
    count, n, along = model.weight.sum(axis=1), known.information, known.along
    total = variance + shared * n
    kappa = shared / (variance * total)
    gram = known.gram / variance[:, None, None] - kappa[:, None, None] * along[:, :, None] * along[:, None, :]
    pulled = known.pulled / variance[:, None] - (kappa * known.mean)[:, None] * along
    precision = scattered(index, gram, size) + jnp.diag(widths)
    gradient = scattered_vector(index, pulled, size) - widths * model.z
    factor = jnp.linalg.cholesky(precision)
    root = jax.scipy.linalg.solve_triangular(factor, jnp.eye(size), lower=True)
    half = root @ gradient
    step, inverse = root.T @ half, root.T @ root

    square = jnp.sum(known.square / variance - kappa * known.mean**2) + jnp.sum(widths * model.z**2)
    log_determinant = jnp.sum(known.log_variance + count * jnp.log(variance) + jnp.log(total / variance))
    constant = 0.5 * jnp.log(2 * jnp.pi) * (jnp.sum(problem.observations.weight) + h.shape[0])
    value = (
        -0.5 * square + 0.5 * half @ half - 0.5 * h @ h - jnp.sum(jnp.log(jnp.diagonal(factor)))
        - 0.5 * (log_determinant - jnp.sum(jnp.log(widths))) - constant
    )  # fmt: skip

    ahead = take(jnp.concatenate([step, jnp.zeros(1)]), index.columns)
    misfit = known.mean - jnp.sum(along * ahead, axis=1)
    # Sums of products and no `einsum`, which XLA computes for small blocks at four times the cost.
    blocks = _blocks(index, inverse)
    moment = blocks + ahead[:, :, None] * ahead[:, None, :]
    square_mean = known.square - 2 * jnp.sum(ahead * known.pulled, axis=1) + jnp.sum(known.gram * moment, axis=(1, 2))
    mean_square = misfit**2 + jnp.sum(blocks * along[:, :, None] * along[:, None, :], axis=(1, 2))
    twice = 2 * kappa / variance - kappa**2 * n
    by_variance = square_mean / variance**2 - twice * mean_square
    by_variance = 0.5 * (by_variance - count / variance + kappa * n)
    by_shared = 0.5 * (mean_square / total**2 - n / total)
    by_widths = 0.5 * (1 / widths - (model.z + step) ** 2 - jnp.diagonal(inverse))
    return value, of_variances((by_variance, by_shared))[0] + of_widths(by_widths)[0] - h


def _blocks(index: GroupIndex, inverse: Float[Array, "P P"]) -> Float[Array, "G K K"]:
    """Return the block of each group of a matrix, 0 where a group has no parameter."""
    padded = jnp.pad(inverse, (0, 1))
    flat = index.patterns[:, :, None] * padded.shape[0] + index.patterns[:, None, :]
    return take(take(padded.reshape(-1), flat), index.pattern)
