"""Experiment design: the candidate runs that the equipment allows, ranked by how much they would narrow a quantity.

From the Jacobian alone, without simulation: a candidate adds JᵀΣ⁻¹J to the precision, and the variance of a quantity
with gradient c is cᵀH⁻¹c.  All candidates are bound together, as runs whose observations do not count, so that one
Jacobian serves all.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import jax.numpy as jnp
import numpy as np

from imubayes.array_shapes import Array, Float
from imubayes.effects.base import Effect, Stage
from imubayes.inference.candidate_runs import CandidateRun, RunDesign, candidate_runs
from imubayes.inference.fitted_model import Fit
from imubayes.inference.identifiability import WeakDirection
from imubayes.inference.next_run import NextRun
from imubayes.inference.posterior_precision import deviations, linearise, precision_of
from imubayes.kept_programs import kept
from imubayes.model.bind import Model, bind
from imubayes.model.derived_quantities import derived_jacobian
from imubayes.model.problem import Problem

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
    model = bind(fit.model.spec, campaign, fit.model.registry.without_files())
    z = model.layout.carried(fit.model.layout, fit.z)
    h = model.hyper_layout.carried(fit.model.hyper_layout, fit.h)
    return Fit(model, z, h, fit.optimised, fit.message, sampled=fit.sampled), candidates


def next_runs(fit: Fit, weak: Sequence[WeakDirection], from_data: Mapping[str, float | None]) -> tuple[NextRun, ...]:
    """Return, for each quantity the data left open, the run that would narrow it most; empty where none would.

    Quantities are the members of confusions first, then scale factors and mounting angles, then parameters of sensor
    and converter.  A run counts only where it narrows a quantity by at least a tenth.

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
    best = (lines[0] for lines in rank(fit, list(dict.fromkeys(asked))) if lines)
    return tuple(line for line in best if 0 < line.sd_after < _USEFUL * line.sd_before)[:_MOST_LISTED]


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
    designs, sd_before, sd_after = narrowed(fit, _gradients(fit, quantities))
    units = {name.name: name.unit for name in fit.derived.names} | {
        p.name: p.shown_unit for p in fit.model.layout.parameters
    }
    found = []
    for row, quantity in enumerate(quantities):
        lines = [
            NextRun(
                run=design,
                quantity=quantity,
                sd_before=float(sd_before[row]),
                sd_after=float(after[row]),
                unit=units[quantity],
            )
            for design, after in zip(designs, sd_after, strict=True)
        ]
        found.append(sorted(lines, key=lambda line: line.sd_after))
    return found


def narrowed(fit: Fit, gradients: np.ndarray) -> tuple[list[RunDesign], np.ndarray, np.ndarray]:
    """Return the candidate runs, and the standard deviation of quantities before, (n,), and after each of them, (C, n).

    What came with the candidate runs, such as their tables and mountings, changes no quantity of the fit.

    Parameters
    ----------
    fit : a converged fit.
    gradients : shape (n, P), of the quantities with respect to z.
    """
    wide, candidates = with_planned(fit)
    model = wide.model
    about = linearise(model.problem, jnp.asarray(wide.z))
    rows = np.stack([model.layout.carried(fit.model.layout, gradient) for gradient in gradients])
    known_runs = len(fit.model.campaign.runs)

    def precision(included: Iterable[int]) -> np.ndarray:
        return precision_of(model.problem, about, jnp.asarray(wide.h), np.isin(model.entries.run, list(included)))

    before = precision(range(known_runs)) + np.eye(len(wide.z))
    after = [deviations(rows, before + precision([known_runs + place])) for place in range(len(candidates))]
    designs = [candidate.design for candidate in candidates]
    return designs, deviations(rows, before), np.array(after).reshape(-1, len(rows))


def _gradients(fit: Fit, quantities: Sequence[str]) -> np.ndarray:
    """Return the gradient of derived quantities and parameters, in their units, with respect to z, (n, P)."""
    layout, problem = fit.model.layout, fit.model.problem
    names = [name.name for name in fit.derived.names]
    of_derived = derived_jacobian(fit.derived.derivation, problem, fit.z)
    slopes = np.asarray(_slopes(problem, jnp.asarray(fit.z))) / layout.factors()
    rows = []
    for quantity in quantities:
        if quantity in names:
            gradient = of_derived[names.index(quantity)]
        else:
            place = layout.index(quantity)
            gradient = np.eye(len(layout))[place] * slopes[place]
        rows.append(gradient)
    return np.array(rows)


@kept
def _slopes(problem: Problem, z: Float[Array, " P"]) -> Float[Array, " P"]:
    return problem.priors.slopes(z)
