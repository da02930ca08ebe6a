"""Which run next?  The candidate runs that the equipment allows, ranked by how much they would narrow a quantity.

From the Jacobian alone, no simulation: a candidate adds JᵀΣ⁻¹J to the precision, and the variance of a quantity
with gradient c is cᵀH⁻¹c.  All candidates are declared together, as runs without measurements that count, so that
one Jacobian serves all.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from imubayes.effects.base import Effect, Stage
from imubayes.inference.candidate_runs import CandidateRun, candidate_runs
from imubayes.inference.fitted import Fitted
from imubayes.inference.joint_fit import JointFit
from imubayes.inference.posterior_precision import deviations, linearise, precision_of
from imubayes.model.bind import Model, declare
from imubayes.model.derived_quantities import derived_slopes

# Derived quantities below this share from the data ask for a further run.
_WANTED_SHARE = 0.5
_MOST_LISTED = 6
# A run that leaves more than this share of a standard deviation is not worth naming.
_USEFUL = 0.9


def with_planned(fitted: Fitted, elsewhere: bool = False) -> tuple[Fitted, list[CandidateRun]]:
    """Return a fit declared anew on its campaign with every candidate run behind it, and these runs.

    Parameters
    ----------
    elsewhere : whether runs on another table of the same kind count.
    """
    extended, planned = candidate_runs(fitted.model.campaign, elsewhere)
    campaign = replace(extended, runs=(*extended.runs, *(one.run for one in planned)))
    model = declare(fitted.model.spec, campaign, fitted.model.registry.without_files())
    z = model.layout.carried(fitted.model.layout, fitted.z)
    h = model.hyper_layout.carried(fitted.model.hyper_layout, fitted.h)
    return Fitted(model, z, h, fitted.converged, fitted.message), planned


def rank(fit: JointFit, quantities: Sequence[str]) -> dict[str, list[dict[str, Any]]]:
    """Return, for each quantity, the candidate runs in order of its standard deviation after them.

    Parameters
    ----------
    fit : a converged fit.
    quantities : names of parameters or derived quantities, such as ``scale_factor[gx]``.
    """
    wide, planned = with_planned(fit.fitted)
    if not planned:
        return {}
    model, z, h = wide.model, wide.z, wide.h
    about = linearise(model.problem, jnp.asarray(z))
    gradients = _gradients(fit, model, quantities)
    known_runs = len(fit.model.campaign.runs)

    def precision(included: Sequence[int]) -> np.ndarray:
        return precision_of(model.problem, about, jnp.asarray(h), np.isin(model.entries.run, list(included)))

    before = precision(range(known_runs)) + np.eye(len(z))
    sd_before = deviations(gradients, before)
    sd_after = [deviations(gradients, before + precision([known_runs + place])) for place in range(len(planned))]
    units = {name.name: name.unit for name in fit.derived.names} | {p.name: p.unit for p in model.layout.parameters}
    found = {}
    for row, quantity in enumerate(quantities):
        lines = [
            {
                "run": one.sentence,
                "quantity": quantity,
                "sd_before": float(sd_before[row]),
                "sd_after": float(after[row]),
                "unit": units[quantity],
            }
            for one, after in zip(planned, sd_after, strict=True)
        ]
        found[quantity] = sorted(lines, key=lambda line: line["sd_after"])
    return found


def _gradients(fit: JointFit, wide: Model, quantities: Sequence[str]) -> np.ndarray:
    """Return the gradient of derived quantities and parameters, in their units, with respect to z of `wide`, (n, P).

    What came with the planned runs, such as their tables and seats, changes no quantity of the fit.
    """
    layout, problem = fit.model.layout, fit.model.problem
    names = [name.name for name in fit.derived.names]
    of_derived = derived_slopes(fit.derived.derivation, problem, np.asarray(fit.mode.z))
    slopes = np.asarray(_slopes(problem, fit.mode.z)) / layout.factors()
    rows = []
    for quantity in quantities:
        if quantity in names:
            gradient = of_derived[names.index(quantity)]
        else:
            place = layout.index(quantity)
            gradient = np.eye(len(layout))[place] * slopes[place]
        rows.append(wide.layout.carried(layout, gradient))
    return np.array(rows)


_slopes = eqx.filter_jit(lambda problem, z: problem.priors.slopes(z))


def next_runs(fit: JointFit, summary: dict[str, Any]) -> list[dict[str, Any]]:
    """Return, for what the data left open, the run that would narrow it most; empty where all is determined.

    Asked for are scale factors and mounting angles, first those that are confused with each other, then the sensor's
    and converter's own parameters; what no candidate narrows by a tenth is left out.
    """
    if not bool(fit.mode.converged):
        return []
    confused = [one["combination"] for one in summary["weak_directions"] if " against " in one["combination"]]
    asked = dict.fromkeys(name for one in confused for name in one.split(" against "))
    asked |= dict.fromkeys(
        line["name"]
        for line in summary["derived"]
        if line["name"].startswith(("scale_factor[", "mounting_angle[")) and _open(line)
    )
    of_sensors = {p.name for one in fit.model.assembly.acting for p in one.parameters if _of_sensor(one.member)}
    asked |= dict.fromkeys(line["name"] for line in summary["parameters"] if line["name"] in of_sensors and _open(line))
    if not asked:
        return []
    best = [lines[0] for lines in rank(fit, list(asked)).values()]
    useful = [one for one in best if 0 < one["sd_after"] < _USEFUL * one["sd_before"]]
    return useful[:_MOST_LISTED]


def _open(line: dict[str, Any]) -> bool:
    return line["from_data"] is not None and line["from_data"] < _WANTED_SHARE


def _of_sensor(member) -> bool:
    return issubclass(member, Effect) and member.stage >= Stage.SENSOR and not member.nuisance


__all__ = ["next_runs", "rank", "with_planned"]
