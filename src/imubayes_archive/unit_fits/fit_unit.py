"""The fit of one unit of a batch: its posterior in a lane or alone, checked by importance weights, as table rows.

A unit is fitted alone by the path of `imubayes fit`.  An error is an outcome as well.

In lanes the posterior is the curved nested Laplace approximation of `imubayes.inference.nested_laplace`, computed from
the sums over groups instead of the whole Jacobian.  θ is drawn given each of a few hundred noise scales, several times
each.  The normal vectors behind the draws are the same for all units: a quasi-random sequence with the mean and the
covariance of the standard normal, so that mean and covariance of a normal posterior have no Monte Carlo error.

The importance weights of a few draws show whether the approximation of a unit is in doubt
(`imubayes.inference.weight_shape`).
"""

from dataclasses import replace
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
from scipy.special import ndtri
from scipy.stats import qmc

from imubayes import Fit, Registry, Settings, diagnose
from imubayes.foundations.arrays import Array, Float
from imubayes.foundations.campaign_data import Campaign, channel_of_component
from imubayes.foundations.errors import InputError
from imubayes.foundations.progress import silent
from imubayes.inference.identifiability import from_data
from imubayes.inference.outside_draws import UnbentDraws, fit_of_draws
from imubayes.inference.run_fit import joint_fit
from imubayes.inference.scale_density import Curvature, ScaleDensity, ScaleProbes, scale_probes
from imubayes.inference.weight_shape import weight_shape
from imubayes.model.bind import Model, bind
from imubayes.model.model_file import ModelSpec
from imubayes.model.problem import Problem
from imubayes.results.posterior_groups import in_units
from imubayes.results.summarise import noise_of
from imubayes.results.summary import is_constant
from imubayes_archive.unit_fits import group_moments as moments
from imubayes_archive.unit_fits.batch_folder import BatchSettings, UnitSource
from imubayes_archive.unit_fits.lanes import LANES, LaneMode, LaneStructure, Stacked, of_lane
from imubayes_archive.unit_fits.posterior_table import (
    Kind,
    Logarithms,
    Outcome,
    Quantities,
    UnitIdentity,
    UnitPosterior,
)

# Noise scales drawn, and draws of θ for each: powers of two for the quasi-random sequence.
_SCALES, _EACH = 256, 8
# Half the distance of the central differences of the gradient.
_APART = 1e-3


def hyper_curvature(
    problem: Problem, index: moments.GroupIndex, model: moments.GroupedModel, h: Float[Array, " H"]
) -> Curvature:
    """Return value, gradient and negative Hessian of the Laplace marginal of h."""

    def slope(point: Array) -> Array:
        return moments.marginal_slope(problem, index, model, point)[1]

    value, gradient = moments.marginal_slope(problem, index, model, h)

    def row(axis: Array) -> Array:
        return (slope(h - _APART * axis) - slope(h + _APART * axis)) / (2 * _APART)

    rows = jax.lax.map(row, jnp.eye(h.shape[0]))
    return Curvature(value, gradient, 0.5 * (rows + rows.T))


def marginals(
    problem: Problem, index: moments.GroupIndex, model: moments.GroupedModel, points: Float[Array, "n H"]
) -> Float[Array, " n"]:
    """Return the Laplace marginal at several h."""
    return jax.lax.map(lambda h: moments.log_marginal_of(problem, index, model, h), points)


def draws(
    problem: Problem,
    index: moments.GroupIndex,
    model: moments.GroupedModel,
    density: ScaleDensity,
    normal: tuple[Float[Array, "S H"], Float[Array, "S M P"]],
) -> UnbentDraws:
    """Return draws of the approximation before they are bent, for standard normal vectors."""

    def at(vectors: tuple[Array, Array]) -> UnbentDraws:
        step = density.steps(vectors[0])
        here = density.scales(step)
        known = moments.normal_equations(problem, index, model, here)
        factor = jnp.linalg.cholesky(known.precision)
        mean = jax.scipy.linalg.cho_solve((factor, True), known.gradient)
        spread = jax.scipy.linalg.solve_triangular(factor.T, vectors[1].T, lower=False).T
        weight = moments.log_marginal_of(problem, index, model, here) - density.log_density(step)
        return UnbentDraws(mean[None, :] + spread, here, weight)

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
    """Return vectors with mean 0 and covariance 1; as they are if there are too few for the dimensions."""
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
    densities = jax.tree.map(lambda *leaves: jnp.stack(leaves), *tables)
    vectors = tuple(jnp.broadcast_to(each, (LANES, *each.shape)) for each in normal_vectors(*structure.problem.size))
    found = structure.run(draws, varying, mode.model, densities, vectors)
    return [
        None
        if probes[lane] is None or not single[lane]
        else _fit(model, of_lane(mode, lane), of_lane(at, lane), tables[lane], of_lane(found, lane))
        for lane, model in enumerate(models)
    ]


def _probes(mode: LaneMode, at: Curvature, lane: int) -> ScaleProbes | None:
    information = np.asarray(at.information)[lane]
    if not (bool(mode.converged[lane]) and np.all(np.isfinite(information))):
        return None
    return scale_probes(np.asarray(mode.h)[lane], information)


def _fit(model: Model, found: LaneMode, at: Curvature, density: ScaleDensity, drawn: UnbentDraws) -> Fit:
    """Return the fit of one unit, without posterior if its estimates cannot be those of a working unit."""
    return fit_of_draws(model, np.asarray(found.model.z), float(found.decrement), at, density, drawn)


QUANTILES = (2.5, 25.0, 50.0, 75.0, 97.5)
# Knots of the quadrature that gives the mean of a prior.
_KNOTS = 64


def bound_to(spec: ModelSpec, campaign: Campaign) -> Model:
    """Return a model bound to a campaign; files with the user's effects are read once a process."""
    return bind(replace(spec, files=()), campaign, _registry(spec.files))


@cache
def _registry(files: tuple[str, ...]) -> Registry:
    return Registry().with_files(files)


def failure(error: Exception, source: UnitSource) -> Outcome:
    """Return what went wrong with a unit: an input that cannot be used, or an error nobody foresaw."""
    if isinstance(error, InputError):
        return Outcome("refused", "; ".join(issue.what for issue in error.issues), error.issues[0].where)
    return Outcome("failed", f"{type(error).__name__}: {error}", source.path)


def fit_alone(model: Model, settings: BatchSettings, identity: UnitIdentity) -> UnitPosterior:
    """Return the posterior of a unit by the path of `imubayes fit`, its Laplace draws those of a unit in lanes."""
    if settings.sample == "all":
        return posterior_of(_sampled(model, settings), settings, identity)
    fit = joint_fit(model, None, laplace_draws=joint_normal_vectors(*model.problem.size))
    return sampled_where_in_doubt(fit, settings, identity)


def _sampled(model: Model, settings: BatchSettings) -> Fit:
    return joint_fit(model, Settings(seed=settings.seed))


def sampled_where_in_doubt(
    fit: Fit, settings: BatchSettings, identity: UnitIdentity, recorded: Model | None = None
) -> UnitPosterior:
    """Return the tables' view of a Laplace approximation, sampled if it is in doubt and that was asked for."""
    if settings.sample != "flagged" or fit.posterior is None or not fit.converged:
        return posterior_of(fit, settings, identity, recorded)
    shape = weight_shape(fit, settings.seed)
    found = posterior_of(_sampled(fit.model, settings) if shape.flagged else fit, settings, identity, recorded)
    outcome = replace(
        found.outcome, flagged=shape.flagged, pareto_k=shape.pareto_k, weight_skewness=shape.skewness
    )  # fmt: skip
    return replace(found, outcome=outcome)


def posterior_of(
    fit: Fit, settings: BatchSettings, identity: UnitIdentity, recorded: Model | None = None
) -> UnitPosterior:
    """Return the tables' view of a fit made in this process; `recorded` is its model without padded readings."""
    problem, posterior = fit.model.problem, fit.posterior
    readings = int(np.sum(np.asarray(problem.observations.weight)))
    if posterior is None or fit.mode is None:
        return UnitPosterior(identity, Outcome("not_converged", fit.message, identity.file, readings=readings))
    outcome = Outcome(
        status="fitted" if fit.converged else "not_converged",
        reason=fit.message,
        where="" if fit.converged else identity.file,
        verdict=diagnose(fit, progress=silent).verdict if settings.diagnose else "",
        method="laplace" if posterior.chains is None else "emcee",
        pareto_k=None if posterior.chains is None else posterior.chains.diagnosis.pareto_k,
        draws=_effective_draws(fit),
        readings=readings,
        chi2=fit.chi2,
        log_evidence=fit.log_evidence,
    )
    if fit.converged:
        noise, contradicted = noise_of(fit if recorded is None else fit.without_padding(recorded))
        outcome = replace(
            outcome,
            noise_violations=tuple(dict.fromkeys(each.kind for each in noise.violations)),
            noise_contradicted=tuple(dict.fromkeys(each.parameter for each in contradicted)),
        )
    values = in_units(fit.model, posterior.points)
    return UnitPosterior(identity, outcome, quantities_of(fit, values), np.atleast_2d(np.cov(values.T, ddof=0)))


def _effective_draws(fit: Fit) -> float:
    """Return how many independent draws the estimates are worth, those of the worst component."""
    assert fit.posterior is not None
    chains = fit.posterior.chains
    return float(len(fit.posterior.points)) if chains is None else float(np.min(chains.diagnosis.ess_bulk))


def quantities_of(fit: Fit, values: np.ndarray) -> tuple[Quantities, ...]:
    """Return the estimates of parameters, noise scales and derived quantities.

    Parameters
    ----------
    values : shape (S, P + H), draws in units of measure.
    """
    posterior, model = fit.posterior, fit.model
    assert posterior is not None
    declared = model.layout.parameters + model.hyper_layout.parameters
    share = from_data(posterior.points.var(axis=0), 1.0)
    prior_mean, prior_sd = _prior_moments(model)
    quantiles = quantiles_of(values)
    size = len(model.layout)

    noise = slice(size, None)
    logarithms = Logarithms(
        _log_moments(model, values)[:, noise], *(each[noise] for each in _log_likelihoods(model, posterior.points))
    )

    def of_kind(kind: Kind, chosen: slice) -> Quantities:
        return Quantities(
            kind, tuple(p.name for p in declared[chosen]), tuple(p.unit for p in declared[chosen]),
            values[:, chosen].mean(axis=0), values[:, chosen].std(axis=0), quantiles[:, chosen],
            prior_mean[chosen], prior_sd[chosen], share[chosen], logarithms if kind == "noise" else None,
        )  # fmt: skip

    found = (of_kind("parameter", slice(0, size)), of_kind("noise", slice(size, None)))
    return tuple(part for part in (*found, *_derived(fit)) if part.names)


def quantiles_of(draws: np.ndarray) -> np.ndarray:
    """Return the `QUANTILES` of draws (S, D), interpolated linearly, shape (5, D); all from one sort."""
    ordered = np.sort(np.ascontiguousarray(draws.T))
    place = np.array(QUANTILES) / 100 * (len(draws) - 1)
    below = np.floor(place).astype(int)
    above = np.minimum(below + 1, len(draws) - 1)
    return (ordered[:, below] + (place - below) * (ordered[:, above] - ordered[:, below])).T


def _derived(fit: Fit) -> tuple[Quantities, ...]:
    posterior = fit.posterior
    assert posterior is not None
    # Components of input axes are left out: they show nothing beyond the misalignments.
    places = [place for place, each in enumerate(fit.derived.names) if channel_of_component(each.name) is None]
    if not places:
        return ()
    names = [fit.derived.names[place] for place in places]
    draws, prior = posterior.derived[:, places], posterior.prior_derived[:, places]
    fixed = np.array([is_constant(column) for column in prior.T])
    share = np.where(fixed, np.nan, from_data(draws.var(axis=0), np.where(fixed, 1.0, prior.var(axis=0))))
    return (
        Quantities(
            "derived", tuple(each.name for each in names), tuple(each.unit for each in names),
            draws.mean(axis=0), draws.std(axis=0), quantiles_of(draws),
            prior.mean(axis=0), prior.std(axis=0), share,
        ),
    )  # fmt: skip


def _log_moments(model: Model, values: np.ndarray) -> np.ndarray:
    """Return mean and sd of the logarithms of draws (S, D), and those of the prior, (4, D); NaN where not positive."""
    knots, weights = np.polynomial.hermite_e.hermegauss(_KNOTS)
    share = weights / weights.sum()
    grid = in_units(model, np.repeat(knots[:, None], values.shape[1], axis=1))
    result = np.full((4, values.shape[1]), np.nan)
    positive = np.all(values > 0, axis=0) & np.all(grid > 0, axis=0)
    draws, prior = np.log(values[:, positive]), np.log(grid[:, positive])
    mean = share @ prior
    result[:, positive] = draws.mean(axis=0), draws.std(axis=0), mean, np.sqrt(share @ (prior - mean) ** 2)
    return result


# Points of a likelihood and how far they reach, in posterior standard deviations; width of the kernels in these.
_GRID, _REACH, _KERNEL = 25, 2.5, 0.3


def _log_likelihoods(model: Model, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return logarithms of values and of their likelihood, (D, G) each, of the components of z from draws (S, D).

    The posterior density is that of normal kernels at the draws, these drawn together so that the variance remains; the
    prior is standard normal in z.
    """
    mean, deviation = points.mean(axis=0), points.std(axis=0)
    steps = np.linspace(-_REACH, _REACH, _GRID)
    grid = mean + deviation * steps[:, None]
    centres = (points - mean) / (np.where(deviation > 0, deviation, 1.0) * np.sqrt(1 + _KERNEL**2))
    width = _KERNEL / np.sqrt(1 + _KERNEL**2)
    kernels = np.exp(-0.5 * ((steps[:, None, None] - centres) / width) ** 2).mean(axis=1)
    values = in_units(model, grid)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.log(values).T, (np.log(kernels) + 0.5 * grid**2).T


def _prior_moments(model: Model) -> tuple[np.ndarray, np.ndarray]:
    """Return mean and standard deviation of the prior of each component of z in its unit, NaN where it has none."""
    declared = model.layout.parameters + model.hyper_layout.parameters
    deviation = np.array([parameter.prior_sd for parameter in declared], dtype=float)
    knots, weights = np.polynomial.hermite_e.hermegauss(_KNOTS)
    grid = np.repeat(knots[:, None], len(declared), axis=1)
    mean = weights @ in_units(model, grid) / weights.sum()
    known = np.isfinite(deviation)
    return np.where(known, mean, np.nan), np.where(known, deviation, np.nan)
