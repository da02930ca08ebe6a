"""The curved nested Laplace approximation: a proposal close to the posterior.

A normal distribution about the mode is a poor proposal in fifty dimensions for three reasons, each with its remedy.
The width of all θ depends on the noise scales: h is drawn first, from its Laplace marginal, then θ given h.  The
marginal of a noise scale is skewed: each of its axes has one width on the left and one on the right (Rue, Martino &
Chopin 2009, § 6.5).  The few directions that the data leave to the prior are curved ridges: along them the strong
directions are bent by half the second derivative, δ → δ + ½ Σ_ij w_i w_j A_ij with w the weak coordinates (geodesic
acceleration, Transtrum & Sethna 2011).  The bend does not change w, so its determinant is 1 and it is inverted by
subtraction: the density of the proposal is exact, whatever its quality.

With d_j = log s_j(h)/s_j(ĥ), precision and gradient are sums of stored blocks with weights exp(−2 d_j), exact for
independent noise and correct to first order otherwise; each block is positive semidefinite.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.linalg import solve_triangular
from jax.scipy.special import ndtr, ndtri

from imubayes.array_shapes import Array, Float, Scalar
from imubayes.inference.noise_marginal import slope
from imubayes.inference.posterior_mode import Mode
from imubayes.inference.posterior_precision import knowledge
from imubayes.model.noise_covariance import inverse_covariance, whitener
from imubayes.model.problem import Problem, predict_many, prior_widths
from imubayes.noise.base import TailNoise

# A direction is weak where its posterior standard deviation exceeds this share of the prior's; below, a ridge is
# straight.
_WEAK_SD = 0.03
# Second derivatives are taken over pairs of directions: 60 directions have 1830 pairs.
_MOST_WEAK = 60
# Distance from the mode at which the width of the marginal of h is measured, in standard deviations: a normal drops
# by about 1 there.
_PROBE = 1.4


class NestedLaplace(eqx.Module):
    """The proposal.

    Attributes
    ----------
    z, h : the mode.
    hyper_axes : shape (H, H), columns are the axes of the marginal of h.
    left, right : shape (H,), standard deviations along each axis below and above the mode.
    blocks : shape (H, P, P), the parts of the precision that scale with each noise scale.
    gradients : shape (H, P), the same of the gradient.
    fixed, fixed_gradient : the parts of precision and gradient that no noise scale changes, shapes (P, P) and (P,).
    weak : shape (P, K), orthonormal weak directions.
    bend : shape (K, K, P), acceleration along pairs of weak directions.
    """

    z: Float[Array, " P"]
    h: Float[Array, " H"]
    hyper_axes: Float[Array, "H H"]
    left: Float[Array, " H"]
    right: Float[Array, " H"]
    blocks: Float[Array, "H P P"]
    gradients: Float[Array, "H P"]
    fixed: Float[Array, "P P"]
    fixed_gradient: Float[Array, " P"]
    weak: Float[Array, "P K"]
    bend: Float[Array, "K K P"]


@eqx.filter_jit
def posterior_precision(problem: Problem, mode: Mode) -> Float[Array, "P P"]:
    """Return the Gauss–Newton precision of θ at the mode, in z."""
    known = knowledge(problem, mode.about, mode.h)
    return known.precision + jnp.diag(prior_widths(problem, mode.h) ** -2)


class PrecisionBlocks(eqx.Module):
    """Precision and gradient at the mode, split by noise scale, with the eigenvectors of the whole precision."""

    blocks: Float[Array, "H P P"]
    gradients: Float[Array, "H P"]
    fixed: Float[Array, "P P"]
    fixed_gradient: Float[Array, " P"]
    eigenvalues: Float[Array, " P"]
    eigenvectors: Float[Array, "P P"]


def split_by_scale(problem: Problem, mode: Mode) -> PrecisionBlocks:
    """Return the blocks of precision and gradient that belong to each noise scale."""

    def data_part(h):
        known = knowledge(problem, mode.about, h)
        return known.precision, known.gradient

    def per_scale(direction):
        _, (precision, gradient) = jax.jvp(data_part, (mode.h,), (direction,))
        return -0.5 * precision, -0.5 * gradient

    slopes = jax.vmap(lambda seed: jax.jvp(problem.hyper_priors.values, (mode.h,), (seed,))[1])(
        jnp.eye(mode.h.shape[0])
    )
    log_slope = jnp.diagonal(slopes) / problem.hyper_priors.values(mode.h)
    blocks, gradients = jax.vmap(per_scale)(jnp.diag(1 / log_slope))
    # A tail parameter shapes the distribution and does not scale the precision of θ.
    scales = _is_scale(problem)
    blocks, gradients = scales[:, None, None] * blocks, scales[:, None] * gradients
    whole, gradient = data_part(mode.h)
    prior_precision = prior_widths(problem, mode.h) ** -2
    values, vectors = jnp.linalg.eigh(whole + jnp.diag(prior_precision))
    return PrecisionBlocks(blocks, gradients, whole - blocks.sum(0), gradient - gradients.sum(0), values, vectors)


def _is_scale(problem: Problem) -> Float[Array, " H"]:
    """Return 1 for a hyperparameter that scales the noise, 0 for one that shapes its distribution."""
    found = jnp.ones(len(problem.hyper_priors.order))
    for layer in problem.noise:
        if issubclass(layer.noise, TailNoise):
            for place in layer.places.values():
                found = found.at[place].min(1 - layer.acts)
    return found


def bends(
    problem: Problem, mode: Mode, weak: Float[Array, "P K"], reach: Float[Array, " K"], inverse: Float[Array, "P P"]
) -> Float[Array, "K K P"]:
    """Return the acceleration along every pair of weak directions.

    The second derivatives are central differences over one posterior standard deviation to each side, the range of the
    proposal, rather than the derivatives at the mode.

    Parameters
    ----------
    weak : shape (P, K), orthonormal weak directions, at least one.
    reach : shape (K,), posterior standard deviation along each.
    inverse : shape (P, P), inverse of the precision restricted to the strong directions.
    """
    count = weak.shape[1]
    steps = np.asarray(weak.T * reach[:, None])
    rows, columns = np.triu_indices(count)
    pairs, middle = steps[rows] + steps[columns], np.asarray(mode.z)
    centre = np.asarray(problem.observations.value - mode.about.misfit)
    whole = predict_many(problem, middle + pairs) + predict_many(problem, middle - pairs) - 2 * centre
    # ∂²f[a, b] = ½ (∂²f[a + b, a + b] − ∂²f[a, a] − ∂²f[b, b]); the difference for (a, a) is along 2a: 4 ∂²f[a, a].
    own, far = whole[rows == columns] / 4, np.asarray(reach)
    mixed = 0.5 * (whole - own[rows] - own[columns]) / (far[rows] * far[columns])[:, None]
    acceleration = -np.asarray(_pulled(problem, mode, mixed)) @ np.asarray(inverse)
    result = np.zeros((count, count, weak.shape[0]))
    result[rows, columns] = result[columns, rows] = acceleration
    return jnp.asarray(result)


@eqx.filter_jit
def _pulled(problem: Problem, mode: Mode, changes: Float[Array, "n E"]) -> Float[Array, "n P"]:
    """Return JᵀΣ⁻¹ · change for each change of the prediction."""
    by = whitener(problem, mode.h)
    return jax.vmap(lambda change: mode.about.jacobian.T @ inverse_covariance(problem, by, change)[0])(changes)


_split_by_scale = eqx.filter_jit(split_by_scale)


def nested_laplace(problem: Problem, mode: Mode) -> NestedLaplace:
    """Return the proposal about a mode."""
    split = _split_by_scale(problem, mode)
    count = min(int(jnp.sum(split.eigenvalues < _WEAK_SD**-2)), _MOST_WEAK)
    weak, strong = split.eigenvectors[:, :count], split.eigenvectors[:, count:]
    inverse = (strong / split.eigenvalues[None, count:]) @ strong.T
    size = mode.z.shape[0]
    reach = split.eigenvalues[:count] ** -0.5
    bend = bends(problem, mode, weak, reach, inverse) if count else jnp.zeros((0, 0, size))
    axes, left, right = _split_normal(problem, mode)
    return NestedLaplace(
        mode.z, mode.h, axes, left, right, split.blocks, split.gradients, split.fixed, split.fixed_gradient, weak, bend
    )


def _split_normal(problem: Problem, mode: Mode):
    """Return axes of the marginal of h with a standard deviation for each side."""
    at, h = mode.marginal, np.asarray(mode.h)
    eigenvalues, axes = np.linalg.eigh(np.asarray(at.information))
    # Where the marginal is flatter than the prior, the Laplace width is unbounded; the prior has width 1.
    deviation = 1 / np.sqrt(np.maximum(eigenvalues, 1.0))

    def side(axis: int, sign: float) -> float:
        step = sign * _PROBE * deviation[axis]
        drop = float(at.value - slope(problem, mode.about, h + step * axes[:, axis]).value)
        # A normal drops by ½·_PROBE²: the width that gives the measured drop, limited to a factor of 2.
        ratio = np.clip(_PROBE / np.sqrt(2 * max(drop, 1e-3)), 0.5, 2.0)
        return float(deviation[axis] * ratio)

    left, right = (np.array([side(axis, sign) for axis in range(len(h))]) for sign in (-1.0, 1.0))
    return jnp.asarray(axes), jnp.asarray(left), jnp.asarray(right)


def _conditional(approximation: NestedLaplace, problem: Problem, h: Float[Array, " H"]):
    """Return Cholesky factor of the precision of θ given h, and its mean less ẑ."""
    values = problem.hyper_priors.values
    shrink = (values(approximation.h) / values(h)) ** 2
    prior_precision = prior_widths(problem, h) ** -2
    precision = jnp.tensordot(shrink, approximation.blocks, 1) + approximation.fixed + jnp.diag(prior_precision)
    gradient = shrink @ approximation.gradients + approximation.fixed_gradient - prior_precision * approximation.z
    factor = jnp.linalg.cholesky(precision)
    step = solve_triangular(factor, gradient, lower=True)
    return factor, solve_triangular(factor.T, step, lower=False)


def _bent(approximation: NestedLaplace, delta: Float[Array, " P"]) -> Float[Array, " P"]:
    weak = delta @ approximation.weak
    return 0.5 * jnp.einsum("i,j,ijp->p", weak, weak, approximation.bend)


def _two_piece(normal: Float[Array, " H"], left: Float[Array, " H"], right: Float[Array, " H"]) -> Float[Array, " H"]:
    """Return two-piece normal variables from standard normal ones, by their distribution functions."""
    share = left / (left + right)
    below = ndtr(normal) < share
    # Each side is computed from its own tail probability, which keeps all digits far out.
    low = left * ndtri(jnp.where(below, ndtr(normal) / share, 1.0) / 2)
    high = -right * ndtri(jnp.where(below, 1.0, ndtr(-normal) / (1 - share)) / 2)
    return jnp.where(below, low, high)


def _two_piece_inverse(value: Float[Array, " H"], left: Float[Array, " H"], right: Float[Array, " H"]):
    """Return the standard normal variables of two-piece normal ones."""
    share = left / (left + right)
    low = ndtri(2 * share * ndtr(jnp.minimum(value, 0.0) / left))
    high = -ndtri(2 * (1 - share) * ndtr(-jnp.maximum(value, 0.0) / right))
    return jnp.where(value < 0, low, high)


def to_point(
    approximation: NestedLaplace, problem: Problem, normal: Float[Array, " PH"]
) -> tuple[Float[Array, " PH"], Scalar]:
    """Return the point (θ, h), in z, of a standard normal vector, and the log density of the proposal there.

    The points of random vectors are proposals.
    """
    size = approximation.z.shape[0]
    along = _two_piece(normal[size:], approximation.left, approximation.right)
    h = approximation.h + approximation.hyper_axes @ along
    factor, mean = _conditional(approximation, problem, h)
    delta = mean + solve_triangular(factor.T, normal[:size], lower=False)
    point = jnp.concatenate([approximation.z + delta + _bent(approximation, delta), h])
    return point, _log_density(approximation, factor, normal[:size], along)


def to_normal(
    approximation: NestedLaplace, problem: Problem, point: Float[Array, " PH"]
) -> tuple[Float[Array, " PH"], Scalar]:
    """Return the standard normal vector of a point, and the log density of the proposal there."""
    size = approximation.z.shape[0]
    z, h = point[:size], point[size:]
    along = approximation.hyper_axes.T @ (h - approximation.h)
    left, right = approximation.left, approximation.right
    factor, mean = _conditional(approximation, problem, h)
    bent = z - approximation.z
    # The bend does not change the weak coordinates, so it is computed from the bent step and subtracted.
    whitened = factor.T @ (bent - _bent(approximation, bent) - mean)
    density = _log_density(approximation, factor, whitened, along)
    return jnp.concatenate([whitened, _two_piece_inverse(along, left, right)]), density


def _log_density(approximation: NestedLaplace, factor, whitened: Float[Array, " P"], along: Float[Array, " H"]):
    left, right = approximation.left, approximation.right
    width = jnp.where(along < 0, left, right)
    # A two-piece normal has density √(2/π)/(left + right) at its mode.
    hyper = -0.5 * jnp.sum((along / width) ** 2) - jnp.sum(jnp.log(0.5 * (left + right)))
    log_determinant = jnp.sum(jnp.log(jnp.diagonal(factor)))
    constant = 0.5 * jnp.log(2 * jnp.pi) * (whitened.shape[0] + along.shape[0])
    return hyper - 0.5 * jnp.sum(whitened**2) + log_determinant - constant
