"""Uncertainty budget of a fit in the form of the GUM: what each run and each prior contributes to a posterior variance.

The inputs are independent: the data of each run (type A), and each parameter's prior, which states what is known of
fixture, table, site, reference and the unit itself before the test (type B).  Their contributions at given noise scales
add up exactly (`imubayes.qualification.budget_algebra`).  The noise scales have a posterior of their own, so
contributions are averaged over it, and the variance of the conditional mean is a line by itself (total variance).
What the posterior variance has beyond that sum is the nonlinear remainder.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from imubayes.array_shapes import Array, Float
from imubayes.inference.fitted_model import Fit
from imubayes.inference.posterior_precision import Linearised, knowledge, linearise
from imubayes.model.derived_quantities import derived_jacobian
from imubayes.model.noise_covariance import whiten, whitener
from imubayes.model.problem import Problem, prior_widths
from imubayes.parameters.priors import HalfCauchy, HalfNormal, LogNormal, LogUniform, Normal, Prior, Uniform
from imubayes.parameters.vector import Layout, Parameter
from imubayes.qualification.budget_algebra import (
    LinearContributions,
    degrees_of_freedom,
    deviation_with_exact_priors,
    deviation_with_halved_noise,
    deviation_with_halved_priors,
    linear_contributions,
    posterior_covariance,
)
from imubayes.qualification.tolerances import CONDITIONING_DRAWS, CONDITIONING_WORK
from imubayes.results.posterior_draws import complete, draws_of
from imubayes.results.result import Result

Source = Literal["fixture", "table", "site", "reference", "unit"]
SOURCES: dict[str, Source] = {
    "mounting_error": "fixture", "pose_attitude": "fixture", "lever_arm": "fixture", "servo_start": "fixture",
    "table_axis_tilt": "table", "table_rate_error": "table", "table_wobble": "table", "encoder_harmonic": "table",
    "time_skew": "table", "tumble_heading": "site", "station_heading": "site", "station_level": "site",
    "gravity_anomaly": "site", "reference_bias": "reference", "reference_scale_factor": "reference",
    "reference_alignment": "reference", "injection_error": "reference",
}  # fmt: skip
"""Effect → what its prior is about; the unit under test for all others."""

_DISTRIBUTIONS: dict[type[Prior], str] = {
    Normal: "normal", Uniform: "rectangular", LogNormal: "lognormal", HalfNormal: "half-normal",
    LogUniform: "log-uniform", HalfCauchy: "half-Cauchy",
}  # fmt: skip


@dataclass(frozen=True)
class BudgetArrays:
    """The budget of Q quantities as arrays; variances in the squared units of the quantities.

    Attributes
    ----------
    names : of the quantities.
    runs : names of the groups of type A.
    priors : the parameters whose priors are the inputs of type B.
    averaged : contributions averaged over the noise scales.
    degrees : shape (Q, G), degrees of freedom of the contributions of type A.
    noise_scales : shape (Q,), variance of the conditional mean over the noise scales.
    posterior : shape (Q,), posterior variance of the draws.
    exact_prior, halved_prior : shape (Q, P), standard deviation at the mode if one prior were exact, or half as wide.
    halved_noise : shape (Q, G), the same if the noise of one run were halved.
    at_mode : shape (Q,), standard deviation at the mode.
    correlation : shape (Q, Q), of the posterior draws.
    """

    names: tuple[str, ...]
    runs: tuple[str, ...]
    priors: tuple[Parameter, ...]
    averaged: LinearContributions
    degrees: np.ndarray
    noise_scales: np.ndarray
    posterior: np.ndarray
    exact_prior: np.ndarray
    halved_prior: np.ndarray
    halved_noise: np.ndarray
    at_mode: np.ndarray
    correlation: np.ndarray

    @cached_property
    def remainder(self) -> np.ndarray:
        """Posterior variance beyond the contributions, shape (Q,): nonlinearity, and the Monte Carlo error of both."""
        return self.posterior - self.averaged.total - self.noise_scales


def distribution(prior: Prior) -> str:
    """Return the name of a prior's distribution, as a GUM budget calls it."""
    return _DISTRIBUTIONS.get(type(prior), type(prior).__name__.lower())


@eqx.filter_jit
def _conditional(problem: Problem, about: Linearised, h: Float[Array, " H"]):
    """Return whitened Jacobian (E, P), prior widths (P,) and gradient of the log density (P,) at noise scales h."""
    widths = prior_widths(problem, h)
    gradient = knowledge(problem, about, h).gradient - about.z / widths**2
    return whiten(problem, whitener(problem, h), about.jacobian), widths, gradient


def budget_of(result: Result, names: Sequence[str]) -> BudgetArrays:
    """Return the uncertainty budgets of parameters and derived quantities of a result.

    Parameters
    ----------
    result : a fit that converged, with its campaign in place.
    names : of the quantities, as in the summary; those without draws, and noise scales, are left out.

    Raises
    ------
    InputError
        where the campaign or the draws are gone.
    """
    fit = result.fit
    layout, hyper = fit.model.layout, fit.model.hyper_layout
    draws = draws_of(result.posterior_file or result.posterior, [*layout.names, *hyper.names, *names])
    names = [name for name in dict.fromkeys(names) if name in draws and name not in hyper.names]
    h = _standardised(hyper, draws)
    gradients = _gradients(fit, names)
    problem, runs = fit.model.problem, tuple(run.name for run in fit.model.campaign.runs)
    about, group = linearise(problem, jnp.asarray(fit.z)), np.asarray(fit.model.entries.run)
    parts, means = _over_noise_scales(problem, about, group, len(runs), h, gradients)
    averaged = LinearContributions(
        *(np.mean([getattr(part, key) for part in parts], axis=0) for key in ("type_a", "type_b", "sensitivity"))
    )
    whitened, widths, _ = (np.asarray(part) for part in _conditional(problem, about, jnp.asarray(fit.h)))
    covariance = posterior_covariance(whitened, widths)
    return BudgetArrays(
        names=tuple(names),
        runs=runs,
        priors=layout.parameters,
        averaged=averaged,
        degrees=degrees_of_freedom(np.stack([part.type_a for part in parts])),
        noise_scales=means.var(axis=0),
        posterior=np.array([np.nanvar(draws[name]) for name in names]),
        exact_prior=deviation_with_exact_priors(gradients, covariance),
        halved_prior=deviation_with_halved_priors(gradients, covariance, widths),
        halved_noise=deviation_with_halved_noise(gradients, whitened, np.arange(len(runs))[:, None] == group, widths),
        at_mode=np.sqrt(np.sum((gradients @ covariance) * gradients, axis=1)),
        correlation=_correlation(complete({name: draws[name] for name in names})),
    )


def _over_noise_scales(
    problem: Problem, about: Linearised, group: np.ndarray, groups: int, h: np.ndarray, gradients: np.ndarray
) -> tuple[list[LinearContributions], np.ndarray]:
    """Return the contributions at evenly spaced draws of the noise scales, and the conditional means, (H, Q)."""
    affordable = CONDITIONING_WORK / (len(group) * gradients.shape[1] ** 2)
    count = min(int(np.clip(affordable, *CONDITIONING_DRAWS)), len(h)) if h.shape[1] else 1
    chosen = np.linspace(0, len(h) - 1, count).astype(int)
    member, parts, means = np.arange(groups)[:, None] == group, [], []
    for place in chosen:
        at = jax.device_get(_conditional(problem, about, jnp.asarray(h[place])))
        whitened, widths, gradient = (np.asarray(part) for part in at)
        along = gradients @ posterior_covariance(whitened, widths)
        parts.append(linear_contributions(along, whitened, member, widths))
        means.append(along @ gradient)
    return parts, np.stack(means)


def _standardised(layout: Layout, draws: dict[str, np.ndarray]) -> np.ndarray:
    """Return the draws of all parameters of a layout in z, shape (S, P)."""
    size = len(next(iter(draws.values())))
    columns = [_z(parameter, draws[parameter.name]) for parameter in layout.parameters]
    return np.stack(columns, axis=1) if columns else np.zeros((size, 0))


def _z(parameter: Parameter, values: np.ndarray) -> np.ndarray:
    prior, si = parameter.prior, values * parameter.factor
    if isinstance(prior, Normal):
        return (si - np.asarray(prior.mean)) / np.asarray(prior.deviation)
    return np.array([prior.z(value) for value in si.tolist()])


def _gradients(fit: Fit, names: Sequence[str]) -> np.ndarray:
    """Return the derivatives at the mode of quantities, in their units, by every parameter in z, shape (Q, P)."""
    layout, problem = fit.model.layout, fit.model.problem
    slopes = np.diag(np.asarray(problem.priors.slopes(jnp.asarray(fit.z))) / layout.factors())
    derived = derived_jacobian(fit.derived.derivation, problem, fit.z)
    known = dict(zip(layout.names, slopes, strict=True))
    known |= {quantity.name: row for quantity, row in zip(fit.derived.names, derived, strict=True)}
    return np.stack([known[name] for name in names])


def _correlation(draws: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return the correlation matrix of Q quantities, (Q, Q); 0 for a quantity that does not vary."""
    values = np.stack(list(draws.values()), axis=1)
    about = values - values.mean(axis=0)
    sd = about.std(axis=0)
    unit = np.divide(about, sd, out=np.zeros_like(about), where=sd > 0)
    return unit.T @ unit / len(values)
