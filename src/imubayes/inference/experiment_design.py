"""Experiment design: candidate runs ranked by how much they would narrow a quantity.

The ranking follows from the Jacobian alone, without simulation: a candidate that the equipment allows adds JᵀΣ⁻¹J to
the precision, and the variance of a quantity with gradient c is cᵀH⁻¹c.  All candidates are bound together, as runs
whose observations do not count, so that one Jacobian serves all.  Angles near 0° are lengths
(`imubayes.inference.vector_length`).
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from imubayes.effects.base import Effect, Stage
from imubayes.foundations.numerics import inverse_of_precision
from imubayes.inference.candidate_runs import CandidateRun, NextRun, RunDesign, candidate_runs
from imubayes.inference.fitted_model import Fit
from imubayes.inference.identifiability import WeakDirection
from imubayes.inference.laplace_marginal import precision_of
from imubayes.inference.parameter_fit import linearise
from imubayes.inference.vector_length import Components, components_near_zero, expected_length_deviation
from imubayes.model.bind import Model, bind
from imubayes.model.derived_quantities import derived_jacobian
from imubayes.parameters.declarations import prior_slopes

# A further run is proposed for quantities with less than this share from the data.
_WANTED_SHARE = 0.5
_MOST_LISTED = 6
# A run that leaves more than this share of a standard deviation is not proposed.
_USEFUL = 0.9


def with_planned(fit: Fit, elsewhere: bool = False) -> tuple[Fit, list[CandidateRun]]:
    """Return a fit bound anew to its campaign with every candidate run appended, and these runs.

    Parameters
    ----------
    elsewhere : whether runs on another table of the same kind count.
    """
    extended, candidates = candidate_runs(fit.model.campaign, elsewhere)
    campaign = replace(extended, runs=(*extended.runs, *(candidate.run for candidate in candidates)))
    model = bind(fit.model.spec_of_known, campaign, fit.model.registry.without_files())
    z = model.layout.carried(fit.model.layout, fit.z)
    h = model.hyper_layout.carried(fit.model.hyper_layout, fit.h)
    return Fit(model, z, h, fit.optimised, fit.message, sampled=fit.sampled), candidates


def next_runs(fit: Fit, weak: Sequence[WeakDirection], from_data: Mapping[str, float | None]) -> tuple[NextRun, ...]:
    """Return, for each quantity the data left open, the run that would narrow it most; empty if none would.

    Quantities are the members of confusions first, then scale factors and mounting angles, then parameters of sensor
    and converter.  A run counts only if it narrows a quantity by at least a tenth.

    Parameters
    ----------
    fit : a converged fit.
    weak : its weak directions.
    from_data : share of the information contributed by the data, by name of parameter and derived quantity.
    """
    asked = [name for direction in weak if direction.kind == "confusion" for name in direction.quantities]
    undetermined = [name for name, share in from_data.items() if share is not None and share < _WANTED_SHARE]
    asked += [name for name in undetermined if name.startswith(("scale_factor[", "mounting_angle["))]
    sensor = _sensor_parameters(fit.model)
    asked += [name for name in undetermined if name in sensor]
    return best_runs(fit, list(dict.fromkeys(asked)))[:_MOST_LISTED]


def best_runs(fit: Fit, quantities: Sequence[str]) -> tuple[NextRun, ...]:
    """Return, for each quantity that a candidate run narrows by at least a tenth, the run that narrows it most.

    Parameters
    ----------
    fit : a converged fit.
    quantities : names of parameters or derived quantities.
    """
    best = (lines[0] for lines in rank(fit, quantities) if lines)
    return tuple(line for line in best if 0 < line.sd_after < _USEFUL * line.sd_before)


def _sensor_parameters(model: Model) -> set[str]:
    """Return the names of the parameters of sensor and converter effects."""
    return {
        parameter.name
        for effect in model.assembly.effects
        if issubclass(effect.effect_class, Effect)
        and effect.effect_class.stage >= Stage.SENSOR
        and not effect.effect_class.nuisance
        for parameter in effect.parameters
    }


def rank(fit: Fit, quantities: Sequence[str]) -> list[list[NextRun]]:
    """Return, for each quantity, the candidate runs in order of its standard deviation after them.

    Parameters
    ----------
    fit : a converged fit.
    quantities : names of parameters or derived quantities, such as ``scale_factor[gx]``.
    """
    if not quantities:
        return []
    near_zero = _near_zero(fit, quantities)
    parts = [near_zero.get(name) or Components(np.zeros(1), gradient) for name, gradient in _gradients(fit, quantities)]
    expected = expected_deviations(fit, parts)
    units = {name.name: name.unit for name in fit.derived.names} | {
        p.name: p.shown_unit for p in fit.model.layout.parameters
    }
    found = []
    for row, quantity in enumerate(quantities):
        lines = [
            NextRun(
                run=design,
                quantity=quantity,
                sd_before=float(expected.before[row]),
                sd_after=float(after[row]),
                unit=units[quantity],
            )
            for design, after in zip(expected.designs, expected.after, strict=True)
        ]
        found.append(sorted(lines, key=lambda line: line.sd_after))
    return found


class ExpectedDeviations(NamedTuple):
    """Standard deviations of n quantities now, (n,), and expected after each candidate run, (C, n)."""

    designs: list[RunDesign]
    before: np.ndarray
    after: np.ndarray


def expected_deviations(fit: Fit, quantities: Sequence[Components]) -> ExpectedDeviations:
    """Return the candidate runs and the standard deviations of quantities before and after each of them.

    Equipment of the candidate runs, such as tables and mountings, changes no quantity of the fit.

    Parameters
    ----------
    fit : a converged fit.
    quantities : with one component each, or with those of which they are the length.
    """
    wide, candidates = with_planned(fit)
    model = wide.model
    about = linearise(model.problem, np.asarray(wide.z))
    gradients = np.concatenate([each.gradient for each in quantities])
    rows = np.stack([model.layout.carried(fit.model.layout, gradient) for gradient in gradients])
    known_runs = len(fit.model.campaign.runs)

    def precision(included: Iterable[int]) -> np.ndarray:
        return precision_of(model.problem, about, np.asarray(wide.h), np.isin(model.entries.run, list(included)))

    now = precision(range(known_runs)) + np.eye(len(wide.z))
    totals = (now, *(now + precision([known_runs + place]) for place in range(len(candidates))))
    covariances = [rows @ np.linalg.solve(total, rows.T) for total in totals]
    ends = np.cumsum([len(each.gradient) for each in quantities])
    parts = [slice(end - len(each.gradient), end) for end, each in zip(ends, quantities, strict=True)]
    places = list(zip(quantities, parts, strict=True))
    found = np.array(
        [
            [_deviation(each, covariances[0][part, part], after[part, part]) for each, part in places]
            for after in covariances
        ]
    )
    return ExpectedDeviations([candidate.design for candidate in candidates], found[0], found[1:])


def _deviation(quantity: Components, before: np.ndarray, after: np.ndarray) -> float:
    """Return the standard deviation of a quantity that is expected if its components narrow to `after`."""
    if len(quantity.at_mode) == 1:
        return float(np.sqrt(after[0, 0]))
    return expected_length_deviation(quantity.at_mode, before, after)


def _near_zero(fit: Fit, quantities: Sequence[str]) -> dict[str, Components]:
    """Return the components of those quantities that are angles near zero."""
    problem = fit.model.problem
    about = linearise(problem, np.asarray(fit.z))
    precision = precision_of(problem, about, np.asarray(fit.h))
    covariance = inverse_of_precision(precision + np.eye(len(fit.z)))
    return components_near_zero(fit, quantities, covariance)


def _gradients(fit: Fit, quantities: Sequence[str]) -> Iterator[tuple[str, np.ndarray]]:
    """Yield derived quantities and parameters with their gradients, in their units, with respect to z, (1, P)."""
    layout, problem = fit.model.layout, fit.model.problem
    names = [name.name for name in fit.derived.names]
    of_derived = derived_jacobian(fit.derived.derivation, problem, fit.z)
    slopes = np.asarray(prior_slopes(problem.priors, np.asarray(fit.z))) / layout.factors()
    for quantity in quantities:
        if quantity in names:
            yield quantity, of_derived[[names.index(quantity)]]
        else:
            place = layout.index(quantity)
            yield quantity, np.eye(len(layout))[[place]] * slopes[place]
