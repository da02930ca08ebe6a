"""The curved nested Laplace approximation: a proposal close to the posterior.

A normal distribution about the mode is a poor proposal in fifty dimensions for three reasons, each with its remedy.
The width of all θ depends on the noise scales: h is drawn first, from its Laplace marginal, then θ given h, with the
precision that θ has at that h (`imubayes.inference.conditional_precision`).  Its marginal is drawn from as
tabulated (`imubayes.inference.scale_density`).  Correlated noise has a curved ridge, which the
scale of its innovations makes straight (`imubayes.inference.conditional_precision`).  The few directions that the data
leave to the prior are curved ridges: along them the strong directions are bent by half the second derivative,
δ → δ + ½ Σ_ij w_i w_j A_ij with w the weak coordinates (geodesic acceleration, Transtrum & Sethna 2011).  The bend does
not change w, so its determinant is 1 and it is inverted by subtraction: the density of the proposal is exact, whatever
its quality.  A wide angle beside a sensor that is accurate to its third power leaves that parabola: there the strong
directions are solved for along the ridge.  If the marginal of a weak direction is not normal it is tabulated, too
(`imubayes.inference.tabulated_directions`).
"""

from dataclasses import dataclass, replace

import jax
import numpy as np
import scipy  # loads its parts when they are first used
import scipy.special

from imubayes.compiled.kept_programs import kept
from imubayes.foundations.arrays import Array, Float, cholesky, solve_each, solve_lower
from imubayes.foundations.numerics import inverse_of_precision
from imubayes.inference.conditional_precision import (
    Conditional,
    InnovationScale,
    conditional,
    conditional_precision,
    innovation_scale,
)
from imubayes.inference.laplace_marginal import ScaleMarginal, inverse_within, knowledge
from imubayes.inference.posterior_mode import Mode
from imubayes.inference.scale_density import ScaleDensity, scale_probes
from imubayes.inference.scale_statistics import ScaleStatistics
from imubayes.inference.tabulated_directions import TabulatedDirections, tabulated_directions
from imubayes.model.likelihood import log_normaliser, residuals_of
from imubayes.model.noise_covariance import inverse_covariance, whitener
from imubayes.model.problem import Problem, hyper_prior_square, predict_many, prior_widths

# A direction is weak if its posterior standard deviation exceeds this share of the prior's; below, a ridge is
# straight.
_WEAK_SD = 0.03
# Second derivatives are taken over pairs of directions: 60 directions have 1830 pairs.
_MOST_WEAK = 60
# Points over which the distance from the ridge is judged, its root mean square that is left, in standard deviations,
# and the most steps of the chord method that bring it there.  Points that are off by d standard deviations have log
# weights of standard deviation d; a standard uncertainty, one direction of many, is off by less than d²/2.
_RIDGE_POINTS, _ON_RIDGE, _MOST_CHORDS = 32, 0.3, 4
# Draws whose precisions are formed and factored together: of more, what is read again is no longer in the cache.
_AT_ONCE = 64
# Noise scales for a multiple of which a density is compiled.
_COMPILED_FOR = 16


@dataclass(frozen=True)
class NestedLaplace:
    """The proposal.

    Attributes
    ----------
    z : the mode of θ.
    of_scales : density of h, or of u if there is a ridge.
    blocks : precision of θ given h.
    weak : shape (P, K), orthonormal weak directions.
    bend : shape (K, K, P), acceleration along pairs of weak directions.
    shape : marginals of weak directions that are not normal; None if all are.
    ridge : coordinates u in which the scales of correlated noise have no ridge; None if no rows are correlated.
    along_ridge : what is left of the ridge beside the bend; None if that is far below the noise.
    """

    z: Float[Array, " P"]
    of_scales: ScaleDensity
    blocks: Conditional
    weak: Float[Array, "P K"]
    bend: Float[Array, "K K P"]
    shape: TabulatedDirections | None = None
    ridge: InnovationScale | None = None
    along_ridge: "ChordSteps | None" = None

    def scales(self, problem: Problem, straight: Float[Array, "n H"]) -> np.ndarray:
        """Return the noise scales h of u."""
        return straight if self.ridge is None else self.ridge.scales(problem, straight)


@dataclass(frozen=True)
class ChordSteps:
    """Steps of the chord method from a bent point to the ridge: the highest point for its weak coordinates.

    The Jacobian is that at the mode, so that a step costs one prediction and its error falls by the relative change of
    the Jacobian.

    Attributes
    ----------
    gain : shape (P, E), step in the strong directions for a change of the misfit.
    restoring : shape (P, P), the same for a change of z, by the prior.
    steps : their number.
    """

    gain: np.ndarray
    restoring: np.ndarray
    steps: int

    def solved(self, problem: Problem, z: Float[Array, "n P"], bent: Float[Array, "n P"]) -> np.ndarray:
        """Return the strong part of the steps from z to the ridge, from their first estimates `bent`."""
        for _ in range(self.steps):
            bent = bent + self.step(problem, z + bent)
        return bent

    def step(self, problem: Problem, z: Float[Array, "n P"]) -> np.ndarray:
        """Return one step from each z."""
        return (problem.observations.value - predict_many(problem, z)) @ self.gain.T - z @ self.restoring.T


def posterior_precision(problem: Problem, mode: Mode) -> np.ndarray:
    """Return the Gauss–Newton precision of θ at the mode, in z, (P, P)."""
    known = knowledge(problem, mode.about, mode.h)
    return known.precision + np.diag(prior_widths(problem, mode.h) ** -2)


def bends(problem: Problem, mode: Mode, weak: np.ndarray, reach: np.ndarray, inverse: np.ndarray) -> np.ndarray:
    """Return the acceleration along every pair of weak directions, (K, K, P).

    The second derivatives are central differences over one posterior standard deviation to each side, the range of the
    proposal, rather than the derivatives at the mode.

    Parameters
    ----------
    weak : shape (P, K), orthonormal weak directions, at least one.
    reach : shape (K,), posterior standard deviation along each.
    inverse : shape (P, P), inverse of the precision restricted to the strong directions.
    """
    count = weak.shape[1]
    steps = weak.T * reach[:, None]
    rows, columns = np.triu_indices(count)
    pairs, middle = steps[rows] + steps[columns], mode.z
    centre = problem.observations.value - mode.about.misfit
    whole = predict_many(problem, middle + pairs) + predict_many(problem, middle - pairs) - 2 * centre
    # ∂²f[a, b] = ½ (∂²f[a + b, a + b] − ∂²f[a, a] − ∂²f[b, b]); the difference for (a, a) is along 2a: 4 ∂²f[a, a].
    own, far = whole[rows == columns] / 4, reach
    mixed = 0.5 * (whole - own[rows] - own[columns]) / (far[rows] * far[columns])[:, None]
    pulled = inverse_covariance(problem, whitener(problem, mode.h), mode.about.jacobian)[0]
    acceleration = -(mixed @ pulled) @ inverse
    result = np.zeros((count, count, weak.shape[0]))
    result[rows, columns] = result[columns, rows] = acceleration
    return result


def nested_laplace(problem: Problem, mode: Mode, marginal: "HyperMarginal | None" = None) -> NestedLaplace:
    """Return the proposal about a mode; `marginal` is that of its noise scales, if it is at hand."""
    weak, reach, bend = curved_directions(problem, mode)
    shape, chords = (
        tabulated_directions(problem, mode, weak, reach, bend),
        chord_steps(problem, mode, weak, reach, bend),
    )
    own = marginal or hyper_marginal(problem, mode)
    given = conditional_precision(problem, mode)
    return NestedLaplace(mode.z, own.density, given, weak, bend, shape, own.ridge, chords)


def weak_directions(problem: Problem, mode: Mode) -> tuple[np.ndarray, np.ndarray, TabulatedDirections | None]:
    """Return the weak directions about a mode, as of `curved_directions`, and the marginals that are not normal."""
    weak, reach, bend = curved_directions(problem, mode)
    return weak, bend, tabulated_directions(problem, mode, weak, reach, bend)


def curved_directions(problem: Problem, mode: Mode) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the weak directions about a mode.

    Returns
    -------
    Orthonormal directions (P, K), the posterior standard deviation along each, (K,), and the acceleration along every
    pair, (K, K, P).
    """
    precision = posterior_precision(problem, mode)
    variances, vectors = np.linalg.eigh(inverse_of_precision(precision))
    count = min(int(np.sum(variances > _WEAK_SD**2)), _MOST_WEAK)
    # The largest variance comes first, as the least precision.
    weak, strong = vectors[:, ::-1][:, :count], vectors[:, ::-1][:, count:]
    inverse, reach = inverse_within(precision, strong), variances[::-1][:count] ** 0.5
    none = np.zeros((0, 0, mode.z.shape[0]))
    return weak, reach, bends(problem, mode, weak, reach, inverse) if count else none


def chord_steps(
    problem: Problem, mode: Mode, weak: np.ndarray, reach: np.ndarray, bend: np.ndarray
) -> ChordSteps | None:
    """Return the steps that lead from bent points to the ridge; None if the bend does, or if they would not.

    Parameters
    ----------
    weak, reach, bend : as of `curved_directions`.
    """
    if not reach.size:
        return None
    precision = posterior_precision(problem, mode)
    inverse = inverse_within(precision, scipy.linalg.null_space(weak.T))
    pulled = inverse_covariance(problem, whitener(problem, mode.h), mode.about.jacobian)[0]
    chords = ChordSteps(inverse @ pulled.T, inverse * prior_widths(problem, mode.h)[None, :] ** -2, 0)
    z = ridge_points(mode.z, weak, reach, bend)
    before = np.inf
    for count in range(_MOST_CHORDS + 1):
        step = chords.step(problem, z)
        size = np.sqrt(np.einsum("np,pq,nq->n", step, precision, step, optimize=True).mean())
        if size < _ON_RIDGE:
            return replace(chords, steps=count) if count else None
        if not size < before:
            return None
        z, before = z + step, size
    return replace(chords, steps=_MOST_CHORDS)


def ridge_points(middle: np.ndarray, weak: np.ndarray, reach: np.ndarray, bend: np.ndarray) -> np.ndarray:
    """Return bent points over which the distance from the ridge is judged, (n, P).

    Normal vectors of all parameters are projected on the directions: the points do not depend on the signs of the
    directions, which are those of an eigenvalue solver, nor on the basis of directions of equal variance.

    Parameters
    ----------
    middle : shape (P,), the mode.
    weak, reach, bend : as of `curved_directions`.
    """
    w = reach * (np.random.default_rng(0).normal(size=(_RIDGE_POINTS, len(middle))) @ weak)
    return middle + w @ weak.T + 0.5 * np.einsum("ni,nj,ijp->np", w, w, bend)


@dataclass(frozen=True)
class HyperMarginal:
    """The marginal of h about a mode: see `NestedLaplace`.

    Attributes
    ----------
    deviation : shape (H,), its width along each axis.
    others : h (H,) near other maxima along the axes.
    """

    density: ScaleDensity
    ridge: InnovationScale | None
    deviation: np.ndarray
    others: tuple[np.ndarray, ...]


def hyper_marginal(problem: Problem, mode: Mode) -> HyperMarginal:
    """Return the marginal of h, or of u if there is a ridge, along each of its axes."""
    information, ridge = np.asarray(mode.marginal.information), innovation_scale(problem, mode.h)
    if ridge is not None:
        information = ridge.straightened_information(problem, mode.h, information)
    probes = scale_probes(mode.h, information)
    points = probes.points if ridge is None else ridge.scales(problem, probes.points)
    values = ScaleMarginal(problem, mode.about).values(points) - float(mode.marginal.value)
    others = tuple(points[place] for place in probes.other_maxima(values))
    return HyperMarginal(probes.tabulated(values), ridge, probes.deviation, others)


@dataclass(frozen=True)
class _Given:
    """The density of θ given each of n noise scales, of which m differ.

    Attributes
    ----------
    factor : shape (m, P, P), Cholesky factors of the precision.
    place : shape (n,), which of them belongs to each.  They are not copied: they are most of the memory.
    half : shape (n, P), whitened mean less ẑ.
    at_mode : shape (n,), log p(y, ẑ, h) up to a constant; None if it does not come with them.
    """

    factor: np.ndarray
    place: np.ndarray
    half: np.ndarray
    at_mode: np.ndarray | None

    @property
    def factors(self) -> list[np.ndarray]:
        """The factor of each of the n noise scales, (P, P), not copied."""
        return [self.factor[place] for place in self.place.tolist()]

    @property
    def log_determinant(self) -> np.ndarray:
        """Half the logarithm of the determinant of the precision, (n,)."""
        return np.sum(np.log(np.diagonal(self.factor, axis1=1, axis2=2)), axis=1)[self.place]


def _given(approximation: NestedLaplace, problem: Problem, h: np.ndarray) -> _Given:
    """Return the density of θ given each h, (n, H), computed once for neighbours that are alike."""
    first, place = _neighbours(h)
    factor, half, at_mode = _computed(approximation, problem, h[first])
    return _Given(factor, place, half[place], None if at_mode is None else at_mode[place])


def _neighbours(h: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the first row of each stretch of equal rows, and the stretch of each row, (n,)."""
    begins = np.concatenate([[True], np.any(h[1:] != h[:-1], axis=1)])
    return np.flatnonzero(begins), np.cumsum(begins) - 1


def _computed(
    approximation: NestedLaplace, problem: Problem, h: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """Return factor, half and at_mode of `_Given` for noise scales that all differ."""
    of, at_mode = approximation.blocks, None
    if isinstance(of, ScaleStatistics):
        known = of.normal(h)
        precision, gradient = known.precision, known.gradient
        at_mode = -0.5 * (known.square + known.log_determinant + hyper_prior_square(problem, h))
    else:
        precision, gradient = conditional(of, problem, h)
    factor = cholesky(precision)
    return factor, solve_each(factor, gradient), at_mode


def _bent(approximation: NestedLaplace, problem: Problem, delta: np.ndarray) -> np.ndarray:
    weak = delta @ approximation.weak
    count, size = weak.shape[1], delta.shape[1]
    products = (weak[:, :, None] * weak[:, None, :]).reshape(len(delta), count**2)
    bent = 0.5 * products @ approximation.bend.reshape(count**2, size)
    if approximation.along_ridge is None:
        return bent
    return approximation.along_ridge.solved(problem, approximation.z + weak @ approximation.weak.T, bent)


def to_points(approximation: NestedLaplace, problem: Problem, normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the points (θ, h), in z, of standard normal vectors (n, P + H), and the log density of the proposal there.

    The points of random vectors are proposals.
    """
    parts = [_to_points(approximation, problem, rows)[:2] for rows in _blocks(normal)]
    return np.concatenate([points for points, _ in parts]), np.concatenate([density for _, density in parts])


def points_and_marginals(
    approximation: NestedLaplace, problem: Problem, misfit: np.ndarray, normal: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the points of standard normal vectors (n, P + H), and the Laplace marginal of their h, up to a constant.

    Parameters
    ----------
    misfit : shape (E,), y − f at the mode.
    """
    points, marginals, size = [], [], approximation.z.shape[0]
    for rows in _blocks(normal):
        found, _, given = _to_points(approximation, problem, rows)
        density = given.at_mode
        if density is None:
            first, place = _neighbours(found[:, size:])
            some = np.resize(first, -len(first) % _COMPILED_FOR + len(first))
            density = np.asarray(_log_densities(problem, misfit, approximation.z, found[some, size:]))[place]
        points.append(found)
        marginals.append(density + 0.5 * np.sum(given.half**2, axis=1) - given.log_determinant)
    return np.concatenate(points), np.concatenate(marginals)


@kept
def _log_densities(problem: Problem, misfit, z, h: Float[Array, "n H"]) -> Float[Array, " n"]:
    """Return the log density at the mode of θ for several h, compiled: for correlated rows and heavy tails."""

    def at(scales):
        return -0.5 * (residuals_of(problem, misfit, z, scales) ** 2).sum() + log_normaliser(problem, scales)

    return jax.lax.map(at, h)


def _blocks(rows: np.ndarray) -> list[np.ndarray]:
    return np.split(rows, range(_AT_ONCE, len(rows), _AT_ONCE))


def grouped_normals(draws: int, size: int, scales: int) -> np.ndarray:
    """Return standard normal vectors (draws, size + scales) in fours with the same noise scales, for `to_points`.

    The precision of θ is computed once for each four, two pairs of opposite θ.  The noise scales are stratified along
    each axis (Latin hypercube, McKay, Beckman and Conover 1979), so that a quarter as many show their marginals no less
    accurately than independent ones would.
    """
    random, groups = np.random.RandomState(0), -(-draws // 4)
    strata = np.argsort(random.uniform(size=(groups, scales)), axis=0)
    of_scales = scipy.special.ndtri((strata + random.uniform(size=(groups, scales))) / groups)
    pair = random.normal(size=(groups, 2, size))
    own = np.stack([pair, -pair], axis=2).reshape(4 * groups, size)
    return np.concatenate([own, np.repeat(of_scales, 4, axis=0)], axis=1)[:draws]


def _to_points(approximation: NestedLaplace, problem: Problem, normal: np.ndarray):
    """Return points and log density as `to_points`, and the density of θ given h."""
    size = approximation.z.shape[0]
    along = approximation.of_scales.steps(normal[:, size:])
    h = approximation.scales(problem, approximation.of_scales.scales(along))
    given = _given(approximation, problem, h)
    whitened, excess = normal[:, :size], 0.0
    if approximation.shape is not None:
        whitened, excess = approximation.shape.shaped(given.factors, whitened)
    delta = solve_each(given.factors, given.half + whitened, transposed=True)
    points = np.concatenate([approximation.z + delta + _bent(approximation, problem, delta), h], axis=1)
    return points, _log_density(approximation, given, whitened, along) + excess, given


def to_normals(approximation: NestedLaplace, problem: Problem, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the standard normal vectors of points (n, P + H), and the log density of the proposal there."""
    parts = [_to_normals(approximation, problem, rows) for rows in _blocks(points)]
    return np.concatenate([normal for normal, _ in parts]), np.concatenate([density for _, density in parts])


def _to_normals(approximation: NestedLaplace, problem: Problem, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    size = approximation.z.shape[0]
    z, h = points[:, :size], points[:, size:]
    along = _along(approximation, problem, h)
    given = _given(approximation, problem, h)
    bent = z - approximation.z
    # The bend does not change the weak coordinates, so it is computed from the bent step and subtracted.
    step = bent - _bent(approximation, problem, bent)
    factor = given.factor[given.place]
    whitened = (np.swapaxes(factor, 1, 2) @ step[..., None])[..., 0] - given.half
    density = _log_density(approximation, given, whitened, along)
    if approximation.shape is not None:
        whitened, excess = approximation.shape.normalised(factor, whitened)
        density = density + excess
    return np.concatenate([whitened, approximation.of_scales.normals(along)], axis=1), density


def hyper_density(approximation: NestedLaplace, problem: Problem, h: Float[Array, "n H"]) -> np.ndarray:
    """Return the log density of the proposal of each h, (n,)."""
    return approximation.of_scales.log_density(_along(approximation, problem, h))


def _along(approximation: NestedLaplace, problem: Problem, h: Float[Array, "n H"]) -> np.ndarray:
    """Return h along the axes of its marginal."""
    straight = h if approximation.ridge is None else approximation.ridge.straightened(problem, h)
    own = approximation.of_scales
    return solve_lower(own.axes, (straight - own.h).T).T if h.size else h


def _log_density(approximation: NestedLaplace, given: _Given, whitened: np.ndarray, along: np.ndarray):
    hyper = approximation.of_scales.log_density(along)
    constant = 0.5 * np.log(2 * np.pi) * whitened.shape[1]
    return hyper - 0.5 * np.sum(whitened**2, axis=1) + given.log_determinant - constant
