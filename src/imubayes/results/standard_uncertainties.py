"""Standard uncertainties of the quantities of a fit, with as little Monte Carlo error as there can be.

The summary states one for each quantity.  Terminal, report, certificate and their exports take it from there, so that
a quantity has the same one everywhere.  That of a noise scale is the standard deviation of its draws.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from imubayes.inference.fitted_model import Fit
from imubayes.model.derived_quantities import derived_jacobian
from imubayes.results.linear_part import linear_moments, linear_part, thinned_scales
from imubayes.results.posterior_groups import in_units
from imubayes.results.posterior_variance import KnownVariance, variance_of
from imubayes.results.summary import CombinationSummary, ParameterSummary, Quantity, is_constant


@dataclass(frozen=True)
class EstimatedCombination:
    """A determined combination with draws of its posterior and of its prior, (S,) each, in its unit."""

    summary: CombinationSummary
    posterior: np.ndarray
    prior: np.ndarray


@dataclass(frozen=True)
class _Quantities:
    """Gradients by the parameters in z, (P,) each, and draws, (S,) each, of quantities by name."""

    gradients: dict[str, np.ndarray]
    draws: dict[str, np.ndarray]

    def with_combination(self, combination: EstimatedCombination) -> "_Quantities":
        found = combination.summary
        members = [self.draws[name] for name in found.quantities]
        rows = np.stack([self.gradients[name] for name in found.quantities])
        gradient = np.array(slopes(found, members)) @ rows
        return _Quantities(self.gradients | {found.name: gradient}, self.draws | {found.name: combination.posterior})

    @property
    def varying(self) -> tuple[str, ...]:
        """Names of those that vary."""
        return tuple(name for name, draws in self.draws.items() if not is_constant(draws))


def standard_uncertainties(
    fit: Fit, lines: Sequence[Quantity], combinations: Sequence[EstimatedCombination]
) -> dict[str, float]:
    """Return the standard uncertainties of parameters, derived quantities and combinations of a fit, in their units.

    Parameters
    ----------
    fit : made in this process; without posterior there are none.
    lines, combinations : of its summary.
    """
    posterior, problem, size = fit.posterior, fit.model.problem, len(fit.z)
    if posterior is None or fit.mode is None or not size:
        return {}
    known = _parameters_and_derived(fit)
    for found in combinations:
        known = known.with_combination(found)
    names = known.varying
    # A quantity without a gradient, such as an angle of exactly zero, has no linear part: its draws decide.
    gradient = np.nan_to_num(np.array([known.gradients[name] for name in names]).reshape(-1, size))
    part, scales = linear_part(fit, fit.mode.about), thinned_scales(posterior.points[:, size:], size)
    moments = linear_moments(part, problem, part.stretched(problem, fit.h, gradient), scales)
    linear = part.unbent(posterior.points[:, :size])[0] @ gradient.T
    entries, least = {line.name: line for line in lines}, least_effective(lines)
    variances = map(KnownVariance, moments.total.tolist(), moments.spread.tolist())
    found = {}
    for name, along, of_linear in zip(names, linear.T, variances, strict=True):
        draws = known.draws[name]
        effective = effective_size(entries.get(name), draws, least)
        found[name] = math.sqrt(variance_of(draws, along, of_linear, effective).value)
    return found


def _parameters_and_derived(fit: Fit) -> _Quantities:
    posterior, layout, problem = fit.posterior, fit.model.layout, fit.model.problem
    assert posterior is not None
    own = np.asarray(problem.priors.slopes(np.asarray(fit.z))) / layout.factors()
    gradients = dict(zip(layout.names, np.diag(own), strict=True))
    draws = dict(zip(layout.names, in_units(fit.model, posterior.points)[:, : len(layout)].T, strict=True))
    names = tuple(quantity.name for quantity in fit.derived.names)
    if names:
        gradients |= zip(names, derived_jacobian(fit.derived.derivation, problem, fit.z), strict=True)
        draws |= zip(names, posterior.derived.T, strict=True)
    return _Quantities(gradients, draws)


def with_stated[L: Quantity](lines: Sequence[L], stated: Mapping[str, float]) -> tuple[L, ...]:
    """Return lines of a summary with the standard uncertainties of those that have one."""
    return tuple(line.model_copy(update={"sd": stated[line.name]}) if line.name in stated else line for line in lines)


def slopes(found: CombinationSummary, members: Sequence[np.ndarray]) -> tuple[float, ...]:
    """Return the derivatives of a combination by its members, at the means of their draws."""
    if found.weights is not None:
        return found.weights
    scale, angle = (float(np.nanmean(each)) for each in members)
    return float(np.cos(np.radians(angle))), float(-scale * np.sin(np.radians(angle)) * np.pi / 180)


def least_effective(lines: Sequence[Quantity]) -> float:
    """Return the effective size of the parameter that is sampled worst; infinite for independent draws."""
    return min((_sampled_size(line) for line in lines if isinstance(line, ParameterSummary)), default=math.inf)


def effective_size(line: Quantity | None, draws: np.ndarray, least: float) -> float:
    """Return the effective number of draws of a quantity.

    A derived quantity is computed for some of the draws, so that its error has two parts: that of all draws, which is
    taken from the parameter sampled worst, and that of the selection.

    Parameters
    ----------
    line : of the quantity; None if it has none.
    least : effective size of the parameter sampled worst.
    """
    own = _sampled_size(line) if isinstance(line, ParameterSummary) else least
    finite = int(np.isfinite(draws).sum())
    if finite == len(draws):
        return float(min(own, finite))
    return 1 / (1 / own + 1 / finite)


def _sampled_size(line: ParameterSummary) -> float:
    """Return the smaller effective size of a parameter; infinite for independent draws."""
    return min((size for size in (line.ess_bulk, line.ess_tail) if size is not None), default=math.inf)
