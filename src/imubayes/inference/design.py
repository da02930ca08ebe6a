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

from imubayes.inference.joint import JointFit
from imubayes.inference.precision import knowledge, linearise
from imubayes.model.declaration import declare
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
    return extended, found


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
    samples = float(np.median(np.concatenate([run.samples for run in campaign.runs])))
    name = f"candidate {table.name} {mounting.name}"
    shape = (count, len(campaign.channels))
    run = Run(
        name, procedure, table.name, mounting.name, covariates, np.zeros(shape), np.full(count, samples),
        np.full(shape, np.nan),
    )  # fmt: skip
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


def rank(fit: JointFit, quantity: str) -> list[dict[str, Any]]:
    """Return candidate runs in order of the standard deviation of a derived quantity after them.

    Parameters
    ----------
    fit : a converged fit.
    quantity : name of a derived quantity, such as ``scale_factor[gx]``.
    """
    extended, planned = candidates(fit.model.campaign)
    if not planned:
        return []
    campaign = replace(extended, runs=(*extended.runs, *(one.run for one in planned)))
    model = declare(fit.model.spec, campaign)
    z = _carried(model.layout.names, fit.model.layout.names, np.asarray(fit.mode.z))
    h = _carried(model.hyper_layout.names, fit.model.hyper_layout.names, np.asarray(fit.mode.h))
    about = linearise(model.problem, jnp.asarray(z))
    names = [name.name for name in derive(model.assembly).names]
    gradient = np.asarray(_gradient(derive(model.assembly).derivation, model.problem, z))[names.index(quantity)]
    known_runs = len(fit.model.campaign.runs)

    def precision(included: Sequence[int]) -> np.ndarray:
        weight = np.isin(model.entries.run, list(included)).astype(float)
        masked = eqx.tree_at(lambda p: p.observations.weight, model.problem, jnp.asarray(weight))
        return np.asarray(_precision(masked, about, jnp.asarray(h)))

    before = precision(range(known_runs)) + np.eye(len(z))
    sd_before = float(np.sqrt(gradient @ np.linalg.solve(before, gradient)))
    unit = next(name.unit for name in fit.derived.names if name.name == quantity)
    lines = []
    for place, one in enumerate(planned):
        after = before + precision([known_runs + place])
        sd_after = float(np.sqrt(gradient @ np.linalg.solve(after, gradient)))
        lines.append(
            {"run": one.sentence, "quantity": quantity, "sd_before": sd_before, "sd_after": sd_after, "unit": unit}
        )
    return sorted(lines, key=lambda line: line["sd_after"])[:_MOST_LISTED]


_precision = eqx.filter_jit(lambda problem, about, h: knowledge(problem, about, h).precision)


def _carried(names: Sequence[str], known: Sequence[str], values: np.ndarray) -> np.ndarray:
    """Return values by name, 0 (the middle of the prior) for names not known."""
    lookup = dict(zip(known, values.tolist(), strict=True))
    return np.array([lookup.get(name, 0.0) for name in names])


def next_runs(fit: JointFit, summary: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the candidate runs for the quantity that most needs one; none where all are determined."""
    if not bool(fit.mode.converged) or not fit.model.campaign.tables:
        return []
    open_ones = [
        line for line in summary["derived"]
        if line["name"].startswith(("scale_factor[", "mounting_angle[")) and line["from_data"] < _WANTED_SHARE
    ]  # fmt: skip
    confused = [one["combination"] for one in summary["weak_directions"] if " against " in one["combination"]]
    if confused:
        return rank(fit, confused[0].split(" against ")[0])
    if open_ones:
        return rank(fit, min(open_ones, key=lambda line: line["from_data"])["name"])
    return []


__all__ = ["Candidate", "candidates", "next_runs", "rank"]
