"""The curved nested Laplace approximation: a proposal close to the posterior.

A normal distribution about the mode is a poor proposal in fifty dimensions for three reasons, each with its remedy.
The width of all θ depends on the noise scales: h is drawn first, from its Laplace marginal, then θ given h, with the
precision that θ has at that h (`imubayes.inference.conditional_precision`).  The marginal of a noise scale is skewed;
that of a scatter between few runs is as wide as its prior and may have a second mode: it is evaluated along each of its
axes and drawn from as tabulated (Rue, Martino & Chopin 2009, § 3.1).  Correlated noise has a curved ridge, which the
scale of its innovations makes straight (`imubayes.inference.conditional_precision`).  The few directions that the data
leave to the prior are curved ridges: along them the strong directions are bent by half the second derivative,
δ → δ + ½ Σ_ij w_i w_j A_ij with w the weak coordinates (geodesic acceleration, Transtrum & Sethna 2011).  The bend does
not change w, so its determinant is 1 and it is inverted by subtraction: the density of the proposal is exact, whatever
its quality.  A wide angle beside a sensor that is accurate to its third power leaves that parabola: there the strong
directions are solved for along the ridge.  Where the marginal of a weak direction is not normal it is tabulated, too
(`imubayes.inference.tabulated_directions`).
"""

from dataclasses import dataclass, replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy  # loads its parts when they are first used
from jax.scipy.linalg import solve_triangular

from imubayes.compiled.kept_programs import kept
from imubayes.foundations.arrays import Array, Float, Scalar
from imubayes.inference.conditional_precision import (
    ExactPrecision,
    InnovationScale,
    PrecisionBlocks,
    conditional,
    innovation_scale,
    precision_blocks,
)
from imubayes.inference.laplace_marginal import inverse_of_precision, inverse_within, knowledge, log_marginal
from imubayes.inference.posterior_mode import Mode
from imubayes.inference.tabulated_directions import (
    TabulatedDensity,
    TabulatedDirections,
    from_normal,
    log_density,
    tabulate,
    tabulated_directions,
)
from imubayes.inference.tabulated_directions import to_normal as to_standard
from imubayes.model.likelihood import log_normaliser, residuals_of
from imubayes.model.noise_covariance import inverse_covariance, whitener
from imubayes.model.problem import Problem, predict, predict_many, prior_widths

# A direction is weak where its posterior standard deviation exceeds this share of the prior's; below, a ridge is
# straight.
_WEAK_SD = 0.03
# Second derivatives are taken over pairs of directions: 60 directions have 1830 pairs.
_MOST_WEAK = 60
# Points over which the distance from the ridge is judged, the largest that is left, in standard deviations, and the
# most steps of the chord method that bring it there.
_RIDGE_POINTS, _ON_RIDGE, _MOST_CHORDS = 32, 0.3, 4
# Where the marginal of h is evaluated along each axis, in units of its width at the mode,
_PROBES = np.array([-8.0, -6.0, -4.5, -3.5, -2.7, -2.0, -1.3, -0.6, 0.0, 0.6, 1.3, 2.0, 2.7, 3.5, 4.5, 6.0, 8.0, 11.0])
# and, for other maxima, over the whole prior, in z: a scatter at the lower end is zero for all that data can tell.
_SURVEY = np.linspace(-3.5, 3.5, 15)
# Another maximum counts where it is less than this below the highest, and this above what lies between.
_HOPELESS, _APART = 15.0, 0.1
# Log density, relative to the mode, where the marginal is not finite.
_NOWHERE = -200.0


class NestedLaplace(eqx.Module):
    """The proposal.

    Attributes
    ----------
    z, h : the mode.
    hyper_axes : shape (H, H), columns are the axes of the marginal of h, or of u where there is a ridge: unit lower
        triangular, the identity where the scales are independent.
    along : the marginal along each axis, from the mode.
    blocks : precision of θ given h.
    weak : shape (P, K), orthonormal weak directions.
    bend : shape (K, K, P), acceleration along pairs of weak directions.
    shape : marginals of weak directions that are not normal; None where all are.
    ridge : coordinates u in which the scales of correlated noise have no ridge; None where no rows are correlated.
    along_ridge : what is left of the ridge beside the bend; None where that is far below the noise.
    """

    z: Float[Array, " P"]
    h: Float[Array, " H"]
    hyper_axes: Float[Array, "H H"]
    along: TabulatedDensity
    blocks: PrecisionBlocks | ExactPrecision
    weak: Float[Array, "P K"]
    bend: Float[Array, "K K P"]
    shape: TabulatedDirections | None = None
    ridge: InnovationScale | None = None
    along_ridge: "ChordSteps | None" = None

    def scales(self, problem: Problem, straight: Float[Array, " H"]) -> Float[Array, " H"]:
        """Return the noise scales h of u."""
        return straight if self.ridge is None else self.ridge.scales(problem, straight)


class ChordSteps(eqx.Module):
    """Steps of the chord method from a bent point to the ridge: the highest point for its weak coordinates.

    The Jacobian is that at the mode, so that a step costs one prediction and its error falls by the relative change of
    the Jacobian.

    Attributes
    ----------
    gain : shape (P, E), step in the strong directions for a change of the misfit.
    restoring : shape (P, P), the same for a change of z, by the prior.
    steps : their number.
    """

    gain: Float[Array, "P E"]
    restoring: Float[Array, "P P"]
    steps: int = eqx.field(static=True)

    def solved(self, problem: Problem, z: Float[Array, " P"], bent: Float[Array, " P"]) -> Float[Array, " P"]:
        """Return the strong part of the step from z to the ridge, from its first estimate `bent`."""
        for _ in range(self.steps):
            bent = bent + self.step(problem, z + bent)
        return bent

    def step(self, problem: Problem, z: Float[Array, " P"]) -> Float[Array, " P"]:
        """Return one step from z."""
        return self.gain @ (problem.observations.value - predict(problem, z)) - self.restoring @ z


@kept
def posterior_precision(problem: Problem, mode: Mode) -> Float[Array, "P P"]:
    """Return the Gauss–Newton precision of θ at the mode, in z."""
    known = knowledge(problem, mode.about, mode.h)
    return known.precision + jnp.diag(prior_widths(problem, mode.h) ** -2)


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


@kept
def _pulled(problem: Problem, mode: Mode, changes: Float[Array, "n E"]) -> Float[Array, "n P"]:
    """Return JᵀΣ⁻¹ · change for each change of the prediction."""
    by = whitener(problem, mode.h)
    return jax.vmap(lambda change: mode.about.jacobian.T @ inverse_covariance(problem, by, change)[0])(changes)


def nested_laplace(problem: Problem, mode: Mode, marginal: "HyperMarginal | None" = None) -> NestedLaplace:
    """Return the proposal about a mode; `marginal` is that of its noise scales, where it is at hand."""
    weak, reach, bend = curved_directions(problem, mode)
    shape, chords = (
        tabulated_directions(problem, mode, weak, reach, bend),
        chord_steps(problem, mode, weak, reach, bend),
    )
    own = marginal or hyper_marginal(problem, mode)
    blocks = precision_blocks(problem, mode)
    return NestedLaplace(mode.z, mode.h, own.axes, own.along, blocks, weak, bend, shape, own.ridge, chords)


def weak_directions(
    problem: Problem, mode: Mode
) -> tuple[Float[Array, "P K"], Float[Array, "K K P"], TabulatedDirections | None]:
    """Return the weak directions about a mode, as of `curved_directions`, and the marginals that are not normal."""
    weak, reach, bend = curved_directions(problem, mode)
    return weak, bend, tabulated_directions(problem, mode, weak, reach, bend)


def curved_directions(problem: Problem, mode: Mode) -> tuple[Float[Array, "P K"], np.ndarray, Float[Array, "K K P"]]:
    """Return the weak directions about a mode.

    Returns
    -------
    Orthonormal directions, the posterior standard deviation along each, (K,), and the acceleration along every pair.
    """
    precision = np.asarray(posterior_precision(problem, mode))
    variances, vectors = np.linalg.eigh(inverse_of_precision(precision))
    count = min(int(np.sum(variances > _WEAK_SD**2)), _MOST_WEAK)
    # The largest variance comes first, as the least precision.
    weak, strong = vectors[:, ::-1][:, :count], vectors[:, ::-1][:, count:]
    inverse = jnp.asarray(inverse_within(precision, strong))
    reach, weak = variances[::-1][:count] ** 0.5, jnp.asarray(weak)
    none = jnp.zeros((0, 0, mode.z.shape[0]))
    return weak, reach, bends(problem, mode, weak, jnp.asarray(reach), inverse) if count else none


def chord_steps(
    problem: Problem, mode: Mode, weak: Float[Array, "P K"], reach: np.ndarray, bend: Float[Array, "K K P"]
) -> ChordSteps | None:
    """Return the steps that lead from bent points to the ridge; None where the bend does, or where they would not.

    Parameters
    ----------
    weak, reach, bend : as of `curved_directions`.
    """
    if not reach.size:
        return None
    precision = np.asarray(posterior_precision(problem, mode))
    chords = ChordSteps(
        *_gains(problem, mode, jnp.asarray(inverse_within(precision, scipy.linalg.null_space(weak.T)))), 0
    )
    w = reach * np.random.default_rng(0).normal(size=(_RIDGE_POINTS, reach.size))
    z = np.asarray(mode.z) + w @ np.asarray(weak).T + 0.5 * np.einsum("ni,nj,ijp->np", w, w, np.asarray(bend))
    before = np.inf
    for count in range(_MOST_CHORDS + 1):
        misfit = np.asarray(problem.observations.value) - predict_many(problem, z)
        step = misfit @ np.asarray(chords.gain).T - z @ np.asarray(chords.restoring).T
        size = np.sqrt(np.einsum("np,pq,nq->n", step, precision, step).max())
        if size < _ON_RIDGE:
            return replace(chords, steps=count) if count else None
        if not size < before:
            return None
        z, before = z + step, size
    return replace(chords, steps=_MOST_CHORDS)


@kept
def _gains(
    problem: Problem, mode: Mode, inverse: Float[Array, "P P"]
) -> tuple[Float[Array, "P E"], Float[Array, "P P"]]:
    by = whitener(problem, mode.h)
    pulled = jax.vmap(lambda column: inverse_covariance(problem, by, column)[0])(mode.about.jacobian.T)
    return inverse @ pulled, inverse * prior_widths(problem, mode.h)[None, :] ** -2


@kept
def _log_marginals(problem: Problem, mode: Mode, h: Float[Array, "n H"]) -> Float[Array, " n"]:
    return jax.lax.map(lambda point: log_marginal(problem, mode.about, point), h)


@dataclass(frozen=True)
class HyperMarginal:
    """The marginal of h about a mode: see `NestedLaplace`.

    Attributes
    ----------
    deviation : shape (H,), its width along each axis.
    others : h (H,) near other maxima along the axes.
    """

    axes: Float[Array, "H H"]
    along: TabulatedDensity
    ridge: InnovationScale | None
    deviation: np.ndarray
    others: tuple[np.ndarray, ...]


def hyper_marginal(problem: Problem, mode: Mode) -> HyperMarginal:
    """Return the marginal of h, or of u where there is a ridge, along each of its axes."""
    information, ridge = np.asarray(mode.marginal.information), innovation_scale(problem, mode.h)
    if ridge is not None:
        information = np.asarray(ridge.straightened_information(problem, mode.h, mode.marginal.information))
    probes = hyper_probes(np.asarray(mode.h), information)
    points = jnp.asarray(probes.points)
    if ridge is not None:
        points = jax.vmap(lambda point: ridge.scales(problem, point))(points)
    values = np.asarray(_log_marginals(problem, mode, points)) - float(mode.marginal.value)
    others = tuple(np.asarray(points[place]) for place in probes.other_maxima(values))
    return HyperMarginal(jnp.asarray(probes.axes), probes.tabulated(values), ridge, probes.deviation, others)


@dataclass(frozen=True)
class HyperProbes:
    """Where the marginal of h is evaluated.

    Attributes
    ----------
    axes : shape (H, H).
    deviation : shape (H,), width of the marginal along each axis.
    knots : shape (H, n), along each axis, increasing.
    near : shape (H, n), which of them the table is made of; the others reach over the prior.
    points : shape (H n, H).
    """

    axes: np.ndarray
    deviation: np.ndarray
    knots: np.ndarray
    near: np.ndarray
    points: np.ndarray

    def tabulated(self, log_density: np.ndarray) -> TabulatedDensity:
        """Return the marginal along each axis, from its logarithm at the points (H n,) relative to that at the mode."""
        knots, values = (each[self.near].reshape(-1, len(_PROBES)) for each in (self.knots, self._heights(log_density)))
        return tabulate(knots, values, self.deviation)

    def other_maxima(self, log_density: np.ndarray) -> list[int]:
        """Return the places among the points of maxima beside the mode, apart from it and not hopelessly below it."""
        found = []
        for axis, (knots, height) in enumerate(zip(self.knots, self._heights(log_density), strict=True)):
            mode = int(np.argmin(np.abs(knots)))
            for place in np.flatnonzero((height[1:-1] > height[:-2]) & (height[1:-1] >= height[2:])) + 1:
                between = height[min(place, mode) : max(place, mode) + 1].min()
                if place != mode and height[place] > max(height.max() - _HOPELESS, between + _APART):
                    found.append(axis * len(knots) + int(place))
        return found

    def _heights(self, log_density: np.ndarray) -> np.ndarray:
        values = np.nan_to_num(log_density, nan=_NOWHERE, neginf=_NOWHERE, posinf=_NOWHERE)
        return np.maximum(values, _NOWHERE).reshape(self.knots.shape)


def hyper_probes(h: np.ndarray, information: np.ndarray) -> HyperProbes:
    """Return where to evaluate the marginal of h, from its mode (H,) and its negative Hessian (H, H) there."""
    eigenvalues, vectors = np.linalg.eigh(information)
    # Where the marginal is flatter than the prior, the Laplace width is unbounded; the prior has width 1.
    factor = np.linalg.cholesky((vectors / np.maximum(eigenvalues, 1.0)) @ vectors.T)
    deviation = np.diagonal(factor)
    axes = factor / deviation
    knots = np.concatenate([deviation[:, None] * _PROBES, _SURVEY - h[:, None]], axis=1)
    order = np.argsort(knots, axis=1)
    knots = np.take_along_axis(knots, order, axis=1)
    points = h + knots[..., None] * axes.T[:, None, :]
    return HyperProbes(axes, deviation, knots, order < len(_PROBES), points.reshape(-1, len(axes)))


def _conditional(approximation: NestedLaplace, problem: Problem, h: Float[Array, " H"]):
    """Return Cholesky factor of the precision of θ given h, and its mean less ẑ."""
    precision, gradient = conditional(approximation.blocks, problem, h)
    factor = jnp.linalg.cholesky(precision)
    step = solve_triangular(factor, gradient, lower=True)
    return factor, solve_triangular(factor.T, step, lower=False)


def _bent(approximation: NestedLaplace, problem: Problem, delta: Float[Array, " P"]) -> Float[Array, " P"]:
    weak = delta @ approximation.weak
    bent = 0.5 * jnp.einsum("i,j,ijp->p", weak, weak, approximation.bend)
    if approximation.along_ridge is None:
        return bent
    return approximation.along_ridge.solved(problem, approximation.z + approximation.weak @ weak, bent)


def to_point(
    approximation: NestedLaplace, problem: Problem, normal: Float[Array, " PH"]
) -> tuple[Float[Array, " PH"], Scalar]:
    """Return the point (θ, h), in z, of a standard normal vector, and the log density of the proposal there.

    The points of random vectors are proposals.
    """
    return _to_point(approximation, problem, normal)[:2]


def point_and_marginal(
    approximation: NestedLaplace, problem: Problem, misfit: Float[Array, " E"], normal: Float[Array, " PH"]
) -> tuple[Float[Array, " PH"], Scalar]:
    """Return the point of a standard normal vector, and the Laplace marginal of its h, up to a constant.

    Parameters
    ----------
    misfit : shape (E,), y − f at the mode.
    """
    point, _, (factor, mean) = _to_point(approximation, problem, normal)
    h = point[approximation.z.shape[0] :]
    joint = -0.5 * jnp.sum(residuals_of(problem, misfit, approximation.z, h) ** 2) + log_normaliser(problem, h)
    return point, joint + 0.5 * jnp.sum((factor.T @ mean) ** 2) - jnp.sum(jnp.log(jnp.diagonal(factor)))


def _to_point(approximation: NestedLaplace, problem: Problem, normal: Float[Array, " PH"]):
    """Return point and log density as `to_point`, and Cholesky factor and mean of θ given h."""
    size = approximation.z.shape[0]
    along = from_normal(approximation.along, normal[size:])
    h = approximation.scales(problem, approximation.h + approximation.hyper_axes @ along)
    factor, mean = _conditional(approximation, problem, h)
    whitened, excess = normal[:size], jnp.zeros(())
    if approximation.shape is not None:
        whitened, excess = approximation.shape.shaped(factor, whitened)
    delta = mean + solve_triangular(factor.T, whitened, lower=False)
    point = jnp.concatenate([approximation.z + delta + _bent(approximation, problem, delta), h])
    return point, _log_density(approximation, factor, whitened, along) + excess, (factor, mean)


def to_normal(
    approximation: NestedLaplace, problem: Problem, point: Float[Array, " PH"]
) -> tuple[Float[Array, " PH"], Scalar]:
    """Return the standard normal vector of a point, and the log density of the proposal there."""
    size = approximation.z.shape[0]
    z, h = point[:size], point[size:]
    along = _along(approximation, problem, h)
    factor, mean = _conditional(approximation, problem, h)
    bent = z - approximation.z
    # The bend does not change the weak coordinates, so it is computed from the bent step and subtracted.
    whitened = factor.T @ (bent - _bent(approximation, problem, bent) - mean)
    density = _log_density(approximation, factor, whitened, along)
    if approximation.shape is not None:
        whitened, excess = approximation.shape.normalised(factor, whitened)
        density = density + excess
    return jnp.concatenate([whitened, to_standard(approximation.along, along)]), density


def hyper_density(approximation: NestedLaplace, problem: Problem, h: Float[Array, " H"]) -> Scalar:
    """Return the log density of the proposal of h."""
    return jnp.sum(log_density(approximation.along, _along(approximation, problem, h)))


def _along(approximation: NestedLaplace, problem: Problem, h: Float[Array, " H"]) -> Float[Array, " H"]:
    """Return h along the axes of its marginal."""
    straight = h if approximation.ridge is None else approximation.ridge.straightened(problem, h)
    step = straight - approximation.h
    return solve_triangular(approximation.hyper_axes, step, lower=True, unit_diagonal=True) if h.size else h


def _log_density(approximation: NestedLaplace, factor, whitened: Float[Array, " P"], along: Float[Array, " H"]):
    hyper = jnp.sum(log_density(approximation.along, along))
    log_determinant = jnp.sum(jnp.log(jnp.diagonal(factor)))
    constant = 0.5 * jnp.log(2 * jnp.pi) * whitened.shape[0]
    return hyper - 0.5 * jnp.sum(whitened**2) + log_determinant - constant
