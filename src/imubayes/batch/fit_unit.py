"""One unit of a batch: the path of `imubayes fit`, and a fit as rows of the tables; an error is an outcome as well."""

from dataclasses import replace
from functools import cache

import numpy as np

from imubayes.batch.batch_settings import BatchSettings
from imubayes.batch.doubtful_posterior import weight_shape
from imubayes.batch.lane_posterior import joint_normal_vectors
from imubayes.batch.posterior_table import Kind, Outcome, Quantities, UnitIdentity, UnitPosterior
from imubayes.batch.unit_sources import UnitSource
from imubayes.campaign_data import Campaign
from imubayes.criticism.diagnose import judge
from imubayes.errors import InputError
from imubayes.inference.ensemble_sampling import Settings
from imubayes.inference.fitted_model import Fit, Posterior
from imubayes.inference.identifiability import from_data
from imubayes.inference.posterior_groups import in_units
from imubayes.inference.posterior_mode import log_evidence
from imubayes.inference.run_fit import joint_fit
from imubayes.kept_programs import kept
from imubayes.model.bind import Model, bind
from imubayes.model.effect_registry import Registry
from imubayes.model.likelihood import whitened
from imubayes.model.model_spec import ModelSpec
from imubayes.parameters.input_axis_names import channel_of_component
from imubayes.results.estimates import is_constant

QUANTILES = (2.5, 25.0, 50.0, 75.0, 97.5)
# Knots of the quadrature that gives the mean of a prior.
_KNOTS = 64

_whitened = kept(whitened)


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


def sampled_where_in_doubt(fit: Fit, settings: BatchSettings, identity: UnitIdentity) -> UnitPosterior:
    """Return the tables' view of a Laplace approximation, sampled where it is in doubt and that was asked for."""
    if settings.sample != "flagged" or fit.posterior is None or not fit.converged:
        return posterior_of(fit, settings, identity)
    shape = weight_shape(fit, settings.seed)
    found = posterior_of(_sampled(fit.model, settings) if shape.flagged else fit, settings, identity)
    outcome = replace(
        found.outcome, flagged=shape.flagged, pareto_k=shape.pareto_k, weight_skewness=shape.skewness
    )  # fmt: skip
    return replace(found, outcome=outcome)


def posterior_of(fit: Fit, settings: BatchSettings, identity: UnitIdentity) -> UnitPosterior:
    """Return the tables' view of a fit made in this process."""
    problem, posterior = fit.model.problem, fit.posterior
    readings = int(np.sum(np.asarray(problem.observations.weight)))
    if posterior is None or fit.mode is None:
        return UnitPosterior(identity, Outcome("not_converged", fit.message, identity.file, readings=readings))
    outcome = Outcome(
        status="fitted" if fit.converged else "not_converged",
        reason=fit.message,
        where="" if fit.converged else identity.file,
        verdict=judge(fit).verdict if settings.diagnose else "",
        method="laplace" if posterior.chains is None else "emcee",
        pareto_k=None if posterior.chains is None else posterior.chains.diagnosis.pareto_k,
        draws=_effective_draws(posterior),
        readings=readings,
        chi2=float(np.sum(np.asarray(_whitened(problem, fit.mode.h, fit.mode.about.misfit)) ** 2)),
        log_evidence=float(log_evidence(fit.mode)),
    )
    values = in_units(fit.model, posterior.points)
    return UnitPosterior(identity, outcome, quantities_of(fit, values), np.atleast_2d(np.cov(values.T, ddof=0)))


def _effective_draws(posterior: Posterior) -> float:
    """Return how many independent draws the estimates are worth, those of the worst component."""
    if posterior.chains is None:
        return float(len(posterior.points))
    return float(np.min(posterior.chains.diagnosis.ess_bulk))


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

    def of_kind(kind: Kind, chosen: slice) -> Quantities:
        return Quantities(
            kind, tuple(p.name for p in declared[chosen]), tuple(p.unit for p in declared[chosen]),
            values[:, chosen].mean(axis=0), values[:, chosen].std(axis=0), quantiles[:, chosen],
            prior_mean[chosen], prior_sd[chosen], share[chosen],
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
    # Components of input axes are left out: they tell nothing beyond the misalignments.
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


def _prior_moments(model: Model) -> tuple[np.ndarray, np.ndarray]:
    """Return mean and standard deviation of the prior of each component of z in its unit, NaN where it has none."""
    declared = model.layout.parameters + model.hyper_layout.parameters
    deviation = np.array([parameter.prior_sd for parameter in declared], dtype=float)
    knots, weights = np.polynomial.hermite_e.hermegauss(_KNOTS)
    grid = np.repeat(knots[:, None], len(declared), axis=1)
    mean = weights @ in_units(model, grid) / weights.sum()
    known = np.isfinite(deviation)
    return np.where(known, mean, np.nan), np.where(known, deviation, np.nan)
