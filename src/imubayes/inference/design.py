"""Which run next?  The candidate runs that the equipment allows, ranked by how much they would narrow a quantity.

From the Jacobian alone, no simulation: a candidate adds JᵀΣ⁻¹J to the precision, and the variance of a quantity
with gradient c is cᵀH⁻¹c.  All candidates are declared together, as runs without measurements that count, so that
one Jacobian serves all.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from imubayes.effects.base import Effect, Stage
from imubayes.inference.joint import JointFit
from imubayes.inference.precision import knowledge, linearise
from imubayes.model.declaration import Model, declare
from imubayes.model.derived import derive
from imubayes.model.likelihood import values_of
from imubayes.run import Campaign, Mounting, Run, Table

# Derived quantities below this share from the data ask for a further run.
_WANTED_SHARE = 0.5
_HEAD_POSITIONS = 12
_DEFAULT_RATES = (100.0, 30.0, 10.0, -100.0, -30.0, -10.0)  # deg/s
_VERTICAL = math.radians(45.0)
_STANDARD = {
    "x-up": np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]),
    "y-up": np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]),
    "z-up": np.eye(3),
}
_MOST_LISTED = 6
# A run that leaves more than this share of a standard deviation is not worth naming.
_USEFUL = 0.9
_INJECTED_G, _RAMP = 10.0, (15.0, 45.0)


@dataclass(frozen=True)
class Candidate:
    """A run that could be made: a sentence for the engineer, and the run itself."""

    sentence: str
    run: Run


def candidates(campaign: Campaign) -> tuple[Campaign, list[Candidate]]:
    """Return the campaign with standard mountings added, and the runs that its tables and mountings allow."""
    mountings = dict(campaign.mountings)
    seats = [one.uncertainty for one in mountings.values() if one.uncertainty]
    for name, matrix in _STANDARD.items():
        if not any(np.allclose(one.body_to_table[2], matrix[2], atol=1e-3) for one in mountings.values()):
            mountings[name] = Mounting(name, matrix, max(seats, default=None))
    extended = replace(campaign, mountings=mountings)
    used = {(run.table, run.mounting) for run in campaign.runs}
    found = []
    for table in campaign.tables.values():
        for mounting in mountings.values():
            run, sentence = _planned(campaign, table, mounting)
            again = "another run: " if (table.name, mounting.name) in used else ""
            found.append(Candidate(again + sentence, run))
    found.extend(_injections(campaign))
    return extended, found


def _injections(campaign: Campaign) -> list[Candidate]:
    """Return a run with injected current over a converter ramp, where the sensors have a current output."""
    currents = [c.current_per_acceleration for c in campaign.channels if c.current_per_acceleration]
    if not currents or not any("converter_temperature" in run.covariates for run in campaign.runs):
        return []
    current = _INJECTED_G * campaign.site.gravity * currents[0]
    count = _HEAD_POSITIONS
    still = np.zeros(count)
    covariates = {
        "time": 600.0 * np.arange(count),
        "table_rate": still,
        "table_angle": still,
        "table_angle_span": still,
        "converter_temperature": np.linspace(*_RAMP, count),
        "current": np.full(count, current),
    }
    run = _empty_run(campaign, "candidate injection", "current_injection", None, None, covariates)
    sentence = f"current_injection of {current * 1e3:.3g} mA ({_INJECTED_G:g} g) over a converter ramp of "
    return [Candidate(sentence + f"{_RAMP[1] - _RAMP[0]:g} degC", run)]


def _empty_run(
    campaign: Campaign, name: str, procedure: str, table: str | None, mounting: str | None, covariates: dict
) -> Run:
    """Return a run whose readings are yet to be made."""
    count = len(covariates["time"])
    samples = float(np.median(np.concatenate([run.samples for run in campaign.runs])))
    known = np.array([procedure != "current_injection" or bool(c.current_per_acceleration) for c in campaign.channels])
    observed = np.where(known, np.zeros((count, len(known))), np.nan)
    return Run(
        name, procedure, table, mounting, covariates, observed, np.full(count, samples), np.full_like(observed, np.nan)
    )


def _planned(campaign: Campaign, table: Table, mounting: Mounting) -> tuple[Run, str]:
    if table.elevation > _VERTICAL:
        rates = _rates(campaign, table)
        rate = np.array([0.0, *rates, 0.0])
        angle = np.where(rate == 0, 0.0, np.nan)
        procedure, what = "rate_table", f"rates to ±{max(map(abs, rates)):.0f} deg/s"
    else:
        rate = np.zeros(_HEAD_POSITIONS)
        angle = 2 * np.pi * np.arange(_HEAD_POSITIONS) / _HEAD_POSITIONS
        procedure, what = "dividing_head", f"{_HEAD_POSITIONS} positions"
        rates = []
    rate = np.radians(rate)
    count = len(rate)
    covariates = {"time": np.arange(count, dtype=float), "table_rate": rate, "table_angle": angle}
    covariates["table_angle_span"] = np.zeros(count)
    for name in ("temperature", "converter_temperature"):
        known = [run.covariates[name].mean() for run in campaign.runs if name in run.covariates]
        if known:
            covariates[name] = np.full(count, float(np.median(known)))
    run = _empty_run(
        campaign, f"candidate {table.name} {mounting.name}", procedure, table.name, mounting.name, covariates
    )
    return run, f"{procedure} on '{table.name}' in mounting '{mounting.name}', {what}"


def _rates(campaign: Campaign, table: Table) -> list[float]:
    """Return the rates that this table has been run at, deg/s, or usual ones."""
    made = [run.covariates["table_rate"] for run in campaign.runs if run.table == table.name]
    rates = np.unique(np.degrees(np.round(np.concatenate(made), 9))) if made else np.zeros(0)
    turning = [float(rate) for rate in rates if rate != 0]
    return turning or list(_DEFAULT_RATES)


@eqx.filter_jit
def _gradient(derivation, problem, z):
    return jax.jacfwd(lambda one: derivation(values_of(problem, one)))(z)


def rank(fit: JointFit, quantities: Sequence[str]) -> dict[str, list[dict[str, Any]]]:
    """Return, for each quantity, the candidate runs in order of its standard deviation after them.

    Parameters
    ----------
    fit : a converged fit.
    quantities : names of parameters or derived quantities, such as ``scale_factor[gx]``.
    """
    extended, planned = candidates(fit.model.campaign)
    if not planned:
        return {}
    campaign = replace(extended, runs=(*extended.runs, *(one.run for one in planned)))
    model = declare(fit.model.spec, campaign)
    z = carried(model.layout.names, fit.model.layout.names, np.asarray(fit.mode.z))
    h = carried(model.hyper_layout.names, fit.model.hyper_layout.names, np.asarray(fit.mode.h))
    about = _linearise(model.problem, jnp.asarray(z))
    gradients = _gradients(model, z, quantities)
    known_runs = len(fit.model.campaign.runs)

    def precision(included: Sequence[int]) -> np.ndarray:
        weight = np.isin(model.entries.run, list(included)).astype(float)
        masked = eqx.tree_at(lambda p: p.observations.weight, model.problem, jnp.asarray(weight))
        return np.asarray(_precision(masked, about, jnp.asarray(h)))

    def deviations(total: np.ndarray) -> np.ndarray:
        return np.sqrt(np.sum(gradients * np.linalg.solve(total, gradients.T).T, axis=1))

    before = precision(range(known_runs)) + np.eye(len(z))
    sd_before = deviations(before)
    sd_after = [deviations(before + precision([known_runs + place])) for place in range(len(planned))]
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


def _gradients(model: Model, z: np.ndarray, quantities: Sequence[str]) -> np.ndarray:
    """Return the gradient with respect to z of derived quantities and parameters, in their units, (n, P)."""
    derived = derive(model.assembly)
    names = [name.name for name in derived.names]
    of_derived = np.asarray(_gradient(derived.derivation, model.problem, z))
    slopes = np.asarray(_slopes(model.problem, z)) / model.layout.factors()
    rows = []
    for quantity in quantities:
        if quantity in names:
            rows.append(of_derived[names.index(quantity)])
        else:
            place = model.layout.index(quantity)
            rows.append(np.eye(len(z))[place] * slopes[place])
    return np.array(rows)


_linearise = eqx.filter_jit(linearise)
_slopes = eqx.filter_jit(lambda problem, z: jax.jvp(problem.priors.values, (z,), (jnp.ones_like(z),))[1])
_precision = eqx.filter_jit(lambda problem, about, h: knowledge(problem, about, h).precision)


def carried(names: Sequence[str], known: Sequence[str], values: np.ndarray) -> np.ndarray:
    """Return values by name, 0 (the middle of the prior) for names not known."""
    lookup = dict(zip(known, values.tolist(), strict=True))
    return np.array([lookup.get(name, 0.0) for name in names])


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
        if line["name"].startswith(("scale_factor[", "mounting_angle[")) and line["from_data"] < _WANTED_SHARE
    )
    of_sensors = {p.name for one in fit.model.assembly.acting for p in one.parameters if _of_sensor(one.member)}
    asked |= dict.fromkeys(
        line["name"]
        for line in summary["parameters"]
        if line["name"] in of_sensors and line["from_data"] < _WANTED_SHARE
    )
    if not asked:
        return []
    best = [lines[0] for lines in rank(fit, list(asked)).values()]
    useful = [one for one in best if 0 < one["sd_after"] < _USEFUL * one["sd_before"]]
    return useful[:_MOST_LISTED]


def _of_sensor(member) -> bool:
    return issubclass(member, Effect) and member.stage >= Stage.SENSOR and not member.nuisance


__all__ = ["Candidate", "candidates", "next_runs", "rank"]
