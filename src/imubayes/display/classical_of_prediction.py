"""The classical evaluation of what the joint fit predicts: what it would find where the fit is right.

A classical estimate takes seat and table as exact and each run at its own temperature.  What these assumptions do to it
is found by evaluating the outputs that the fit predicts in the same way: where the estimate from the measured outputs
agrees with that from the predicted ones, the assumptions that the fit gives up explain its difference from the fit.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import polars as pl

from imubayes.campaign_data import Campaign, Run
from imubayes.covariates import REFERENCE_TEMPERATURE
from imubayes.procedures.classical import classical
from imubayes.procedures.textbook import Estimate
from imubayes.results.summary import Summary

# Runs closer to the reference temperature differ by less than a test at one temperature does.
_SAME_TEMPERATURE = 5.0


@dataclass(frozen=True)
class OfPrediction:
    """Classical estimates of predicted outputs.

    Attributes
    ----------
    value : (name, run) → estimate.
    of_offset : (name, run) → its change by run offsets of one standard deviation.
    temperature : run → mean temperature, °C, where it differs from that of the joint values and the model has
        parameters for it.
    """

    value: Mapping[tuple[str, str], float]
    of_offset: Mapping[tuple[str, str], float]
    temperature: Mapping[str, float]


def of_prediction(campaign: Campaign, residuals: pl.DataFrame, summary: Summary) -> OfPrediction:
    """Return the classical estimates of the outputs that a fit predicts."""
    offsets = {
        channel.name: next(
            (p.mean or 0.0 for p in summary.parameters if p.name == f"run_scatter.tau[{channel.name}]"), 0.0
        )
        for channel in campaign.channels
    }
    plain = classical_values(with_outputs(campaign, residuals, {}))
    shifted = classical_values(with_outputs(campaign, residuals, offsets))
    effects = {p.name.partition(".")[0] for p in summary.parameters}
    thermal = any("temperature" in name or "converter" in name for name in effects)
    return OfPrediction(
        plain,
        {key: abs(shifted[key] - value) for key, value in plain.items() if key in shifted},
        {run.name: at for run in campaign.runs if thermal and (at := _temperature(run)) is not None},
    )


def classical_values(campaign: Campaign) -> dict[tuple[str, str], float]:
    """Return the classical estimates of a campaign by (name, run)."""
    return {(each.name, each.run): each.value for each in classical(campaign) if isinstance(each, Estimate)}


def _temperature(run: Run) -> float | None:
    known = run.covariates.get("temperature")
    if known is None:
        return None
    mean = float(np.mean(known))
    return mean if abs(mean - REFERENCE_TEMPERATURE) > _SAME_TEMPERATURE else None


def with_outputs(campaign: Campaign, residuals: pl.DataFrame, offsets: Mapping[str, float]) -> Campaign:
    """Return the campaign with the outputs of its channels as predicted, and an offset of each run added."""
    found = {name[0]: own for name, own in residuals.group_by("run")}
    runs = []
    for run in campaign.runs:
        observed = run.observed.copy()
        for place, channel in enumerate(campaign.channels):
            if channel.kind == "angle" or run.name not in found:
                continue
            own = found[run.name].filter(pl.col("channel") == channel.name)
            observed[own["row"].to_numpy(), place] = own["predicted"].to_numpy() + offsets.get(channel.name, 0.0)
        runs.append(replace(run, observed=observed))
    return replace(campaign, runs=tuple(runs))
