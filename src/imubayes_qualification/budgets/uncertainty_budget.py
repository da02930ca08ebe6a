"""Uncertainty budget of a fit in the form of the GUM: what each run and each prior contributes to a posterior variance.

The inputs are independent: the data of each run (type A), and each parameter's prior, which states what is known of
fixture, table, site, reference and the unit itself before the test (type B).  Their contributions at given noise scales
add up exactly (`budgets.budget_parts`).  The noise scales have a posterior of their own, so
contributions are averaged over it, and the variance of the conditional mean is a line by itself (total variance).
The nonlinear part has a line of its own too, the variance of the second-order part; what the posterior variance
(`budgets.budget_parts`) has beyond the sum of all these is the remainder.  If draws are a bit
wider or narrower than the approximation, contributions are scaled to them, and the factor is stated.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from imubayes import Fit
from imubayes.foundations.numerics import inverse_of_precision
from imubayes.inference.parameter_fit import Linearised, linearise, whitened_columns
from imubayes.inference.vector_length import NEAR, Components, components_near_zero
from imubayes.model.problem import Problem
from imubayes.parameters.declarations import Layout, Parameter
from imubayes.parameters.priors import HalfCauchy, HalfNormal, LogNormal, LogUniform, Normal, Prior, Uniform
from imubayes.responses.instrument_errors import INSTRUMENTS
from imubayes.results.linear_part import (
    LinearPart,
    evenly,
    linear_part,
    thinned_scales,
)
from imubayes.results.posterior_quantities import posterior_quantities
from imubayes.results.result import Result
from imubayes.results.summary import Summary
from imubayes_qualification.budgets import budget_parts as parts
from imubayes_qualification.budgets.better_priors import (
    ConditionalMoments,
    QuantityDerivatives,
    conditional_moments,
    derivatives_of,
)
from imubayes_qualification.evaluation.decision_rules import SPLIT_DRAWS

SOURCES: dict[str, parts.Source] = {
    "mounting_error": "fixture", "pose_attitude": "fixture", "lever_arm": "fixture",
    "rotation_centre": "fixture", "servo_start": "fixture",
    "table_axis_tilt": "table", "table_rate_error": "table", "table_wobble": "table", "encoder_harmonic": "table",
    "time_skew": "table", "tumble_heading": "site", "unknown_heading": "site", "unknown_level": "site",
    "station_heading": "site",
    "station_level": "site", "gravity_anomaly": "site",
    "reference_bias": "reference", "reference_scale_factor": "reference",
    "reference_alignment": "reference", "injection_error": "reference",
    **dict.fromkeys(INSTRUMENTS, "reference"),
}  # fmt: skip
"""Effect → what its prior is about; the unit under test for all others."""

_DISTRIBUTIONS: dict[type[Prior], str] = {
    Normal: "normal", Uniform: "rectangular", LogNormal: "lognormal", HalfNormal: "half-normal",
    LogUniform: "log-uniform", HalfCauchy: "half-Cauchy",
}  # fmt: skip


@dataclass(frozen=True)
class Improvements:
    """Standard deviations of Q quantities at the mode of the noise scales, as they are and if one input were better.

    The variance that a better prior leaves is the share of `at_mode` that it leaves of the variance with the noise
    scales unknown (`budgets.better_priors`).

    Attributes
    ----------
    at_mode : shape (Q,), as they are.
    exact_prior, halved_prior : shape (Q, P), if one prior were exact, or half as wide.
    groups : names of effects whose parameters have no interest of their own, such as attitudes of poses; their priors
        are halved together.
    halved_groups : shape (Q, N), if the priors of such an effect were half as wide.
    halved_noise : shape (Q, G), if the noise of one run were halved.
    repeated : shape (Q, G), if one run were made once more.
    """

    at_mode: np.ndarray
    exact_prior: np.ndarray
    halved_prior: np.ndarray
    groups: tuple[str, ...]
    halved_groups: np.ndarray
    halved_noise: np.ndarray
    repeated: np.ndarray


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
    second_order : shape (Q,), variance of the second-order part of the quantity.
    posterior : shape (Q,), posterior variance.
    widened : shape (Q,), what standard deviations are above those of the approximation, see `PosteriorVariances`.
    posterior_error : shape (Q,), its Monte Carlo standard error.
    improved : standard deviations if one input were better.
    at_zero : angles too close to 0° or 180° to have a gradient: inputs contribute through the two components of the
        direction, and contributions are scaled to the posterior variance of the angle.
    components : of each quantity: itself, or those of which it is the length if that is near zero.
    """

    names: tuple[str, ...]
    runs: tuple[str, ...]
    priors: tuple[Parameter, ...]
    averaged: parts.LinearContributions
    degrees: np.ndarray
    noise_scales: np.ndarray
    second_order: np.ndarray
    posterior: np.ndarray
    widened: np.ndarray
    posterior_error: np.ndarray
    improved: Improvements
    at_zero: tuple[str, ...]
    components: tuple[Components, ...]

    @cached_property
    def contributions(self) -> np.ndarray:
        """Sum of all contributions, shape (Q,): types A and B, noise scales, second order."""
        return self.averaged.total + self.noise_scales + self.second_order

    @cached_property
    def remainder(self) -> np.ndarray:
        """Posterior variance beyond the contributions, shape (Q,): higher orders, and Monte Carlo error."""
        return self.posterior - self.contributions


def distribution(prior: Prior) -> str:
    """Return the name of a prior's distribution, as a GUM budget calls it."""
    return _DISTRIBUTIONS.get(type(prior), type(prior).__name__.lower())


@dataclass(frozen=True)
class FunctionOfQuantities:
    """A function of parameters and derived quantities, such as the total of two angles.

    Attributes
    ----------
    draws : shape (S,), NaN where it was not computed.
    members : the quantities that it is computed from.
    length : whether it is the length of the vector of its members, which near zero has no gradient.
    slopes : its derivatives by the members; None if they are found by regression.
    """

    draws: np.ndarray
    members: tuple[str, ...]
    length: bool = False
    slopes: tuple[float, ...] | None = None


@dataclass(frozen=True)
class _Rows:
    """Gradients of which contributions are computed: one row for a quantity, two components for an angle at zero.

    Attributes
    ----------
    gradient : shape (R, P).
    owner : shape (R,), quantity of each row.
    count : of quantities.
    """

    gradient: np.ndarray
    owner: np.ndarray
    count: int

    def summed(self, values: np.ndarray) -> np.ndarray:
        """Return the sums, (Q, …), over the rows of each quantity of values, (R, …)."""
        found = np.zeros((self.count, *values.shape[1:]))
        np.add.at(found, self.owner, values)
        return found


def budget_of(
    result: Result, names: Sequence[str], functions: Mapping[str, FunctionOfQuantities] | None = None
) -> BudgetArrays:
    """Return the uncertainty budgets of parameters and derived quantities of a result, and of functions of them.

    Parameters
    ----------
    result : a fit that converged, with its campaign in place.
    names : of the quantities, as in the summary; those without draws, and noise scales, are left out.
    functions : name → function of them, linearised by its slopes or by regression of its draws on those of its members
        (statistical linearisation); those of other members are left out.

    Raises
    ------
    InputError
        if the campaign or the draws are gone.
    """
    fit, quantities = result.fit, _draws(result, names)
    draws, slopes = _with_functions(quantities, functions or {})
    problem, campaign = fit.model.problem, fit.model.campaign
    about = fit.mode.about if fit.mode is not None else linearise(problem, np.asarray(fit.z))
    whitened, part = whitened_columns(problem, fit.h, about.jacobian), linear_part(fit, about)
    widths = part.conditionals(problem, fit.h[None]).widths[0]
    covariance = parts.posterior_covariance(whitened, widths)
    derivatives = _with_slopes(derivatives_of(fit, part, list(quantities.values)), slopes)
    components = components_near_zero(fit, list(draws.values), covariance)
    components |= _short_lengths(functions or {}, draws, derivatives.gradient, covariance)
    own = [components.get(name, _itself(derivatives.gradient[[q]])) for q, name in enumerate(draws.values)]
    rows = _rows([each.gradient for each in own], len(fit.z), partial(part.stretched, problem, fit.h))
    member = _members(fit)
    h = thinned_scales(draws.h, len(fit.z))
    moments = conditional_moments(part, problem, rows.gradient, h)
    split = rows.summed(_over_runs(problem, about, part, member, rows.gradient, evenly(h, SPLIT_DRAWS)))
    type_b, linear = rows.summed(moments.type_b), rows.summed(moments.variance.mean(axis=0))
    scales = rows.summed(moments.mean.var(axis=0))
    variances = parts.posterior_variances(part, derivatives, linear + scales, rows.summed(moments.spread), draws)
    variances = replace(variances, posterior=_stated(result.summary, tuple(draws.values), variances.posterior))
    at_zero = np.isin(list(draws.values), list(components))
    factor = np.where(at_zero, _ratio(variances.posterior, linear + scales), variances.scale)[:, None]
    type_a = split.mean(axis=2)
    type_a = type_a * _ratio(linear - type_b.sum(axis=1), type_a.sum(axis=1))[:, None]
    # Over two components the sensitivity is the root of the sum of squares: contribution = (sensitivity · width)².
    sensitivity = np.sqrt(rows.summed(moments.sensitivity**2))
    sensitivity = np.where(at_zero[:, None], sensitivity, rows.summed(moments.sensitivity))
    return BudgetArrays(
        names=tuple(draws.values),
        runs=tuple(run.name for run in campaign.runs),
        priors=fit.model.layout.parameters,
        averaged=parts.LinearContributions(factor * type_a, factor * type_b, np.sqrt(factor) * sensitivity),
        degrees=parts.degrees_of_freedom(np.moveaxis(split, 2, 0)),
        noise_scales=factor[:, 0] * scales,
        second_order=np.where(at_zero, 0.0, variances.second_order),
        posterior=variances.posterior,
        widened=variances.widened,
        posterior_error=variances.error,
        improved=_improvements(fit, rows, whitened, widths, factor, moments),
        at_zero=tuple(components),
        components=tuple(replace(each, gradient=rows.gradient[rows.owner == q]) for q, each in enumerate(own)),
    )


def _stated(summary: Summary, names: Sequence[str], posterior: np.ndarray) -> np.ndarray:
    """Return posterior variances (Q,), those of the summary of quantities that are in it.

    They are the same but for the rounding of draws that were stored.
    """
    lines = (*summary.parameters, *summary.derived, *summary.combinations)
    known = {line.name: line.sd**2 for line in lines if line.sd is not None}
    return np.array([known.get(name, float(own)) for name, own in zip(names, posterior, strict=True)])


def _itself(gradient: np.ndarray) -> Components:
    """Return a quantity with the gradient (1, P) as its only component."""
    return Components(np.zeros(1), gradient)


def _members(fit: Fit) -> np.ndarray:
    """Return whether each entry, (E,), is of each run: shape (G, E), bool."""
    return np.arange(len(fit.model.campaign.runs))[:, None] == np.asarray(fit.model.entries.run)


def _improvements(
    fit: Fit, rows: _Rows, whitened: np.ndarray, widths: np.ndarray, factor: np.ndarray, moments: ConditionalMoments
) -> Improvements:
    """Return what better inputs would leave; `factor`, (Q, 1), scales variances at the mode."""
    gradient, member = rows.gradient, _members(fit)
    covariance, groups = parts.posterior_covariance(whitened, widths), nuisance_groups(fit.model.layout)
    now = np.sum((gradient @ covariance) * gradient, axis=1)[:, None]
    # At the mode a scatter that is known from few runs is understated: shares of the averaged variance are taken.
    averaged = (moments.variance.mean(axis=0) + moments.mean.var(axis=0))[:, None]
    exact, halved = (_ratio(each, averaged) for each in (moments.exact_prior, moments.halved_prior))

    def deviation(values: np.ndarray) -> np.ndarray:
        return np.sqrt(factor * rows.summed(values**2))

    return Improvements(
        at_mode=deviation(np.sqrt(now))[:, 0],
        exact_prior=deviation(np.sqrt(now * exact)),
        halved_prior=deviation(np.sqrt(now * halved)),
        groups=tuple(groups),
        halved_groups=deviation(parts.deviation_with_halved_groups(gradient, whitened, widths, list(groups.values()))),
        halved_noise=deviation(parts.deviation_with_more_of_a_run(gradient, whitened, member, widths, 3.0)),
        repeated=deviation(parts.deviation_with_more_of_a_run(gradient, whitened, member, widths, 1.0)),
    )


def nuisance_groups(layout: Layout) -> dict[str, np.ndarray]:
    """Return, for each effect with nuisance parameters, which parameters of the layout are its, (P,) bool."""
    effects = dict.fromkeys(parameter.effect for parameter in layout.parameters if parameter.nuisance)
    return {
        effect: np.array([parameter.nuisance and parameter.effect == effect for parameter in layout.parameters])
        for effect in effects
    }


def _draws(result: Result, names: Sequence[str]) -> parts.PosteriorDraws:
    """Return the draws of a result with those of the quantities asked for, without noise scales."""
    layout, hyper = result.fit.model.layout, result.fit.model.hyper_layout
    effective = posterior_quantities(result).effective
    stored = result.draws
    values = {name: stored[name] for name in dict.fromkeys(names) if name in stored and name not in hyper.names}
    least = min(effective.values(), default=float("inf"))
    known = {name: effective.get(name, least) for name in values}
    return parts.PosteriorDraws(_standardised(layout, stored), _standardised(hyper, stored), values, known)


def _with_functions(
    known: parts.PosteriorDraws, functions: Mapping[str, FunctionOfQuantities]
) -> tuple[parts.PosteriorDraws, np.ndarray]:
    """Return the draws with those of the functions, and the slopes (F, Q) of these on the quantities."""
    values, effective, slopes = dict(known.values), dict(known.effective), []
    order = {name: place for place, name in enumerate(known.values)}
    for name, function in functions.items():
        if not set(function.members) <= order.keys() or name in values:
            continue
        row = np.zeros(len(order))
        row[[order[member] for member in function.members]] = _slopes(function, known.values)
        slopes.append(row)
        values[name] = function.draws
        effective[name] = min(known.effective[member] for member in function.members)
    return replace(known, values=values, effective=effective), np.array(slopes).reshape(-1, len(order))


def _slopes(function: FunctionOfQuantities, known: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return the slopes of a function on its members, (m,)."""
    if function.slopes is not None:
        return np.asarray(function.slopes)
    columns = [known[member] for member in function.members]
    finite = np.isfinite(np.stack([function.draws, *columns])).all(axis=0)
    about = np.stack([column[finite] - column[finite].mean() for column in columns], axis=1)
    width = np.maximum(about.std(axis=0), np.finfo(float).tiny)
    return np.linalg.lstsq(about / width, function.draws[finite] - function.draws[finite].mean())[0] / width


def _short_lengths(
    functions: Mapping[str, FunctionOfQuantities],
    draws: parts.PosteriorDraws,
    gradient: np.ndarray,
    covariance: np.ndarray,
) -> dict[str, Components]:
    """Return the members of every length that is short against their uncertainty."""
    order, found = {name: place for place, name in enumerate(draws.values)}, {}
    for name, function in functions.items():
        if function.length and name in order:
            rows = gradient[[order[member] for member in function.members]]
            widest = np.sqrt(np.linalg.eigvalsh(rows @ covariance @ rows.T)[-1])
            if np.nanmean(function.draws) < NEAR * widest:
                means = np.array([np.nanmean(draws.values[member]) for member in function.members])
                found[name] = Components(means, rows)
    return found


def _with_slopes(known: QuantityDerivatives, slopes: np.ndarray) -> QuantityDerivatives:
    """Return the derivatives of the quantities and of functions with slopes (F, Q) on them."""
    none = np.zeros((len(slopes), *known.curvature.shape[1:]))
    return QuantityDerivatives(
        np.concatenate([known.gradient, slopes @ known.gradient]), np.concatenate([known.curvature, none])
    )


def _rows(gradients: Sequence[np.ndarray], size: int, stretched: Callable[[np.ndarray], np.ndarray]) -> _Rows:
    counts = [len(each) for each in gradients]
    owner = np.repeat(np.arange(len(gradients)), counts)
    return _Rows(stretched(np.concatenate([np.zeros((0, size)), *gradients])), owner, len(gradients))


def _ratio(above: np.ndarray, below: np.ndarray) -> np.ndarray:
    return np.divide(above, below, out=np.zeros_like(above), where=np.broadcast_to(below > 0, above.shape))


def _over_runs(
    problem: Problem, about: Linearised, part: LinearPart, member: np.ndarray, gradients: np.ndarray, h: np.ndarray
) -> np.ndarray:
    """Return the contributions of the runs, (R, G, n), at draws of the noise scales, (n, H)."""
    found = []
    for scales, precision in zip(h, part.conditionals(problem, h).precision, strict=True):
        whitened = whitened_columns(problem, scales, about.jacobian)
        found.append(parts.type_a_contributions(gradients @ inverse_of_precision(precision), whitened, member))
    return np.stack(found, axis=2)


def _standardised(layout: Layout, draws: dict[str, np.ndarray]) -> np.ndarray:
    """Return the draws of all parameters of a layout in z, shape (S, P)."""
    size = len(next(iter(draws.values())))
    columns = [_z(parameter, draws[parameter.name]) for parameter in layout.parameters]
    return np.stack(columns, axis=1) if columns else np.zeros((size, 0))


def _z(parameter: Parameter, values: np.ndarray) -> np.ndarray:
    prior, si = parameter.prior, values * parameter.factor
    if isinstance(prior, Normal):
        return (si - np.asarray(prior.mean)) / np.asarray(prior.deviation)
    if isinstance(prior, LogNormal):
        return np.log(si / np.asarray(prior.median)) / np.asarray(prior.log_deviation)
    return np.array([prior.z(value) for value in si.tolist()])


def correlation_of(draws: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return the correlation matrix of Q quantities, (Q, Q); 0 for a quantity that does not vary."""
    if not draws:
        return np.zeros((0, 0))
    values = np.stack(list(draws.values()), axis=1)
    about = values - values.mean(axis=0)
    sd = about.std(axis=0)
    unit = np.divide(about, sd, out=np.zeros_like(about), where=sd > 0)
    return unit.T @ unit / len(values)
