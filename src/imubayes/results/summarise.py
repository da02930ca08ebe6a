"""The summary of a fit: every number that is reported, in datasheet units, with what the data contributed to it."""

from typing import Any

import numpy as np

from imubayes.classical.converter import THRESHOLD
from imubayes.inference.identifiability import (
    WeakDirection,
    confusions,
    effective_parameters,
    from_data,
    weak_directions,
)
from imubayes.inference.joint_fit import JointFit
from imubayes.inference.nested_laplace import posterior_precision
from imubayes.inference.posterior_tree import in_units
from imubayes.model.derived_quantities import derived_slopes
from imubayes.results.residuals import Residuals
from imubayes.results.summary import finite

_INTERVAL = (2.5, 97.5)
# A derived quantity that varies by less than this share of itself over the whole prior varies by rounding.
_ROUNDING = 1e-12


def summarise(fit: JointFit, residuals: Residuals) -> dict[str, Any]:
    """Return the contents of `summary.json` (see the interface notes in the README)."""
    model = fit.model
    precision = np.asarray(posterior_precision(model.problem, fit.mode)) if bool(fit.mode.converged) else None
    entries = int(np.sum(model.problem.observations.weight))
    dof = entries - (effective_parameters(precision) if precision is not None else len(model.layout))
    weak = _weak(fit, precision) if precision is not None else []
    return {
        "format": 1,
        "campaign": model.campaign.name,
        "model": model.spec.name,
        "converged": fit.converged,
        "message": fit.message,
        "sampled": fit.chains is not None,
        "interval": "95 % equal-tailed",
        "uncertainty": "standard deviation of the joint posterior distribution (GUM, type A and B combined)",
        "acceptance": None if fit.chains is None else fit.chains.acceptance,
        "parameters": _parameters(fit),
        "derived": _derived(fit),
        "runs": residuals.by_run_and_channel(),
        "chi2": finite(residuals.chi2),
        "dof": round(dof, 1),
        "log_evidence": _log_evidence(fit),
        "weak_directions": [{"combination": one.combination, "from_data": one.from_data} for one in weak],
        "next_runs": [],
        "contributions": [],
        "notes": [*model.campaign.notes, *(f"{run.name}: {note}" for run in model.campaign.runs for note in run.notes)],
        "seconds": {"load": 0.0, "fit": 0.0, "sample": 0.0} | fit.seconds,
    }


def _parameters(fit: JointFit) -> list[dict[str, Any]]:
    """Return one line per parameter; numbers are null where the fit did not converge."""
    parameters = fit.model.layout.parameters + fit.model.hyper_layout.parameters
    values = in_units(fit, fit.points)
    best = in_units(fit, np.concatenate([fit.mode.z, fit.mode.h])[None])[0]
    usable = bool(fit.mode.converged)
    diagnosis = fit.chains.diagnosis if fit.chains is not None else None
    lines = []
    for place, parameter in enumerate(parameters):
        draws = values[:, place]
        line = {"name": parameter.name, "unit": parameter.unit, **_numbers(draws, usable)}
        line["nuisance"] = parameter.nuisance
        line["map"] = float(best[place]) if usable else None
        line["prior_sd"] = finite(parameter.prior_sd)
        line["from_data"] = _share(fit.points[:, place]) if usable else None
        for key in ("r_hat", "ess_bulk", "ess_tail"):
            line[key] = float(getattr(diagnosis, key)[place]) if diagnosis is not None else None
        lines.append(line)
    return lines


def _share(z: np.ndarray) -> float:
    """Return the share that came from the data, in z: a skewed prior's standard deviation says little of its width."""
    return float(from_data(float(np.var(z)), 1.0))


def _numbers(draws: np.ndarray, usable: bool) -> dict[str, float | None]:
    if not usable:
        return dict.fromkeys(("mean", "sd", "q025", "q975"))
    low, high = np.percentile(draws, _INTERVAL)
    return {"mean": float(draws.mean()), "sd": float(draws.std()), "q025": float(low), "q975": float(high)}


def _derived(fit: JointFit) -> list[dict[str, Any]]:
    usable = bool(fit.mode.converged)
    lines = []
    for place, name in enumerate(fit.derived.names):
        draws, prior = fit.derived_draws[:, place], fit.prior_derived[:, place]
        line = {"name": name.name, "unit": name.unit, **_numbers(draws, usable)}
        line["prior_sd"] = float(prior.std()) if usable else None
        # What no parameter reaches is neither the data's nor a prior's.
        known = usable and float(np.ptp(prior)) > _ROUNDING * float(np.max(np.abs(prior)))
        line["from_data"] = float(from_data(float(np.var(draws)), float(np.var(prior)))) if known else None
        if name.name.startswith("delta_k["):
            # Whether the line of 1 g may stand for this input: what the textbook decides by a number without doubt.
            within = float(np.mean(draws <= 100 * THRESHOLD)) if usable else None
            line["within"] = {"threshold": 100 * THRESHOLD, "unit": name.unit, "probability": within}
        lines.append(line)
    return lines


def _weak(fit: JointFit, precision: np.ndarray) -> list[WeakDirection]:
    """Return what the data did not determine: pairs of derived quantities first, then combinations of parameters."""
    model = fit.model
    gradient = derived_slopes(fit.derived.derivation, model.problem, np.asarray(fit.mode.z))
    prior, posterior = gradient @ gradient.T, gradient @ np.linalg.solve(precision, gradient.T)
    directions = np.linalg.solve(precision, gradient.T)
    spread = np.sum(directions * np.linalg.solve(precision, directions), axis=0)
    along = 1 - spread / np.maximum(np.sum(directions**2, axis=0), 1e-300)
    names = [name.name for name in fit.derived.names]
    pairs = [
        (i, j)
        for i, first in enumerate(names)
        for j, second in enumerate(names)
        if first.startswith("scale_factor[") and second.startswith(f"mounting_angle[{first[13:-1]},")
    ]
    hidden = np.array([parameter.nuisance for parameter in model.layout.parameters])
    shown = [name for name, hide in zip(model.layout.names, hidden, strict=True) if not hide]
    found = weak_directions(precision, model.layout.names, hidden)
    # A combination of nuisance parameters alone, such as the heading of a tumble, is of no interest.
    named = [one for one in found if any(name in one.combination for name in shown)]
    return confusions(prior, posterior, along, names, pairs) + named


def _log_evidence(fit: JointFit) -> float | None:
    """Return the Laplace estimate of log p(y), h integrated out as well."""
    if not bool(fit.mode.converged):
        return None
    _, log_determinant = np.linalg.slogdet(np.asarray(fit.mode.marginal.information))
    return float(fit.mode.marginal.value + 0.5 * len(fit.mode.h) * np.log(2 * np.pi) - 0.5 * log_determinant)
