"""The posterior of units in lanes: the curved nested Laplace approximation of `imubayes.inference.nested_laplace`.

The same approximation, from the sums over groups instead of the whole Jacobian.  θ is drawn given each of a few hundred
noise scales, several times each.  The normal vectors behind the draws are the same for all units: a quasi-random
sequence with the mean and the covariance of the standard normal, so that mean and covariance of a posterior that is
normal have no Monte Carlo error.
"""

from dataclasses import replace
from functools import cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy.special import ndtri
from scipy.stats import qmc

from imubayes.array_shapes import Array, Float
from imubayes.batch.group_moments import GroupedModel, GroupIndex, log_marginal_of, normal_equations
from imubayes.batch.lane_mode import LaneMode
from imubayes.batch.lanes import LANES, LaneStructure, Stacked, of_lane
from imubayes.batch.marginal_slope import marginal_slope
from imubayes.inference.conditional_precision import ExactPrecision
from imubayes.inference.fitted_model import Fit
from imubayes.inference.nested_laplace import HyperProbes, NestedLaplace, curved_directions, hyper_probes
from imubayes.inference.noise_marginal import Curvature
from imubayes.inference.noise_scale_modes import resampled
from imubayes.inference.posterior_mode import Mode
from imubayes.inference.posterior_precision import linearise
from imubayes.inference.run_fit import judged_fit, posterior_of_draws
from imubayes.inference.tabulated_density import TabulatedDensity, from_normal, log_density
from imubayes.model.bind import Model
from imubayes.model.problem import Problem

# Noise scales drawn, and draws of θ for each: powers of two for the quasi-random sequence.
_SCALES, _EACH = 256, 8
# Half the distance of the central differences of the gradient.
_APART = 1e-3


class LaneDraws(eqx.Module):
    """Steps of θ from the mode before the bend, M for each noise scale, and the noise scales; their axes come first.

    `log_weight`, up to a constant, is the Laplace marginal of the scales over the density that they were drawn from.
    """

    delta: Float[Array, "*S M P"]
    h: Float[Array, "*S H"]
    log_weight: Float[Array, "*S"]


def hyper_curvature(problem: Problem, index: GroupIndex, model: GroupedModel, h: Float[Array, " H"]) -> Curvature:
    """Return value, gradient and negative Hessian of the Laplace marginal of h."""

    def slope(point: Array) -> Array:
        return marginal_slope(problem, index, model, point)[1]

    value, gradient = marginal_slope(problem, index, model, h)

    def row(axis: Array) -> Array:
        return (slope(h - _APART * axis) - slope(h + _APART * axis)) / (2 * _APART)

    rows = jax.lax.map(row, jnp.eye(h.shape[0]))
    return Curvature(value, gradient, 0.5 * (rows + rows.T))


def marginals(
    problem: Problem, index: GroupIndex, model: GroupedModel, points: Float[Array, "n H"]
) -> Float[Array, " n"]:
    """Return the Laplace marginal at several h."""
    return jax.lax.map(lambda h: log_marginal_of(problem, index, model, h), points)


def draws(
    problem: Problem,
    index: GroupIndex,
    model: GroupedModel,
    h: Float[Array, " H"],
    axes: Float[Array, "H H"],
    along: TabulatedDensity,
    normal: tuple[Float[Array, "S H"], Float[Array, "S M P"]],
) -> LaneDraws:
    """Return draws of the approximation before they are bent, for standard normal vectors."""

    def at(vectors: tuple[Array, Array]) -> LaneDraws:
        step = from_normal(along, vectors[0])
        here = h + axes @ step
        known = normal_equations(problem, index, model, here)
        factor = jnp.linalg.cholesky(known.precision)
        mean = jax.scipy.linalg.cho_solve((factor, True), known.gradient)
        spread = jax.scipy.linalg.solve_triangular(factor.T, vectors[1].T, lower=False).T
        weight = log_marginal_of(problem, index, model, here) - jnp.sum(log_density(along, step))
        return LaneDraws(mean[None, :] + spread, here, weight)

    return jax.lax.map(at, normal)


@cache
def normal_vectors(size: int, hyper: int) -> tuple[np.ndarray, np.ndarray]:
    """Return standard normal vectors for noise scales, (S, H), and for θ, (S, M, P), together with covariance 1.

    The M vectors of a draw of the noise scales are successive points of a Sobol sequence, which fill the whole space.
    The draws are in random order: by their numbers, points of two such sequences depend on each other.
    """
    scales = _standardised(_sobol(_SCALES, hyper, 0)[np.random.default_rng(2).permutation(_SCALES)])
    parameters = _sobol(_SCALES * _EACH, size, 1)
    together = _standardised(np.concatenate([np.repeat(scales, _EACH, axis=0), parameters], axis=1))
    return scales, together[:, hyper:].reshape(_SCALES, _EACH, size)


def joint_normal_vectors(size: int, hyper: int) -> np.ndarray:
    """Return the standard normal vectors (S M, P + H) behind the draws of a unit, those of its noise scales last."""
    scales, parameters = normal_vectors(size, hyper)
    return np.concatenate([parameters.reshape(-1, size), np.repeat(scales, _EACH, axis=0)], axis=1)


def _sobol(count: int, dimensions: int, seed: int) -> np.ndarray:
    points = qmc.Sobol(dimensions, scramble=True, rng=np.random.default_rng(seed)).random(count)
    return ndtri(np.clip(points, 1e-12, 1 - 1e-12))


def _standardised(vectors: np.ndarray) -> np.ndarray:
    """Return vectors with mean 0 and covariance 1; as they are where there are too few for the dimensions."""
    centred = vectors - vectors.mean(axis=0)
    if len(vectors) <= 2 * vectors.shape[1]:
        return centred / centred.std(axis=0)
    return np.linalg.solve(np.linalg.cholesky(centred.T @ centred / len(vectors)), centred.T).T


def posteriors(structure: LaneStructure, varying: Stacked, mode: LaneMode, models: list[Model]) -> list[Fit | None]:
    """Return the fits of the units in lanes; None for one whose noise scales have another mode, or no curvature."""
    at: Curvature = structure.run(hyper_curvature, varying, mode.model, mode.h)
    probes = [_probes(mode, at, lane) for lane in range(len(models))]
    usable = next((each for each in probes if each is not None), None)
    if usable is None:
        return [None] * len(models)
    chosen = [each or usable for each in probes] + [usable] * (LANES - len(models))
    values = structure.run(marginals, varying, mode.model, jnp.asarray(np.stack([each.points for each in chosen])))
    relative = np.asarray(values) - np.asarray(at.value)[:, None]
    tables = [each.tabulated(row) for each, row in zip(chosen, relative, strict=True)]
    single = [not each.other_maxima(row) for each, row in zip(chosen, relative, strict=True)]
    along = jax.tree.map(lambda *leaves: jnp.stack(leaves), *tables)
    axes = jnp.asarray(np.stack([each.axes for each in chosen]))
    vectors = tuple(jnp.broadcast_to(each, (LANES, *each.shape)) for each in normal_vectors(*structure.problem.size))
    found = structure.run(draws, varying, mode.model, mode.h, axes, along, vectors)
    return [
        None
        if probes[lane] is None or not single[lane]
        else _fit(model, of_lane(mode, lane), of_lane(at, lane), axes[lane], tables[lane], of_lane(found, lane))
        for lane, model in enumerate(models)
    ]


def _probes(mode: LaneMode, at: Curvature, lane: int) -> HyperProbes | None:
    information = np.asarray(at.information)[lane]
    if not (bool(mode.converged[lane]) and np.all(np.isfinite(information))):
        return None
    return hyper_probes(np.asarray(mode.h)[lane], information)


def _fit(model: Model, found: LaneMode, at: Curvature, axes: Array, along: TabulatedDensity, drawn: LaneDraws) -> Fit:
    """Return the fit of one unit, without posterior where its estimates cannot be those of a working unit."""
    problem, z = model.problem, found.model.z
    about = linearise(problem, z)
    true = jnp.asarray(True)
    mode = Mode(z, found.h, found.decrement, about, at, jnp.asarray(0), true, true)
    fit = judged_fit(model, mode)
    if not fit.converged:
        return fit
    weak, _, bend = curved_directions(problem, mode)
    approximation = NestedLaplace(z, found.h, axes, along, ExactPrecision(about), weak, bend)
    delta = np.asarray(drawn.delta).reshape(-1, len(z))
    bent = delta + _bent(delta, np.asarray(weak), np.asarray(bend))
    points = np.concatenate([np.asarray(z) + bent, np.repeat(np.asarray(drawn.h), _EACH, axis=0)], axis=1)
    points = resampled(points, np.repeat(np.asarray(drawn.log_weight), _EACH))
    return replace(fit, posterior=posterior_of_draws(fit, points, approximation, None))


def _bent(delta: np.ndarray, weak: np.ndarray, bend: np.ndarray) -> np.ndarray:
    """Return the bend of steps (S, P)."""
    along = delta @ weak
    pairs = (along[:, :, None] * along[:, None, :]).reshape(len(delta), -1)
    return 0.5 * pairs @ bend.reshape(-1, delta.shape[1])
