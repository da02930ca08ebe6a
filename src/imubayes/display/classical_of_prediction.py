"""The classical evaluation of what the joint fit predicts: what it would find where the fit is right.

A classical estimate takes seat and table as exact and each run at its own temperature.  What these assumptions do to it
is found by evaluating the outputs that the fit predicts in the same way: where the estimate from the measured outputs
agrees with that from the predicted ones, the assumptions that the fit gives up explain its difference from the fit.
Which of them: the difference is formed again with the parameters of each effect at their null values.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import polars as pl

from imubayes.campaign_data import Campaign, Run
from imubayes.covariates import REFERENCE_TEMPERATURE
from imubayes.criticism.warm_start import null_point
from imubayes.inference.determined_combinations import combined
from imubayes.inference.fitted_model import Fit
from imubayes.inference.posterior_groups import in_units
from imubayes.model.derived_quantities import evaluate_derived
from imubayes.model.problem import predict_many
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
    plain = _values(_predicted(campaign, residuals, {}))
    shifted = _values(_predicted(campaign, residuals, offsets))
    effects = {p.name.partition(".")[0] for p in summary.parameters}
    thermal = any("temperature" in name or "converter" in name for name in effects)
    return OfPrediction(
        plain,
        {key: abs(shifted[key] - value) for key, value in plain.items() if key in shifted},
        {run.name: at for run in campaign.runs if thermal and (at := _temperature(run)) is not None},
    )


def effects_behind(
    fit: Fit, residuals: pl.DataFrame, summary: Summary
) -> Mapping[tuple[str, str], Sequence[tuple[str, float]]]:
    """Return what each effect of a model adds to the classical less the joint estimate, by (name, run).

    Parameters
    ----------
    fit : read from its folder.
    residuals, summary : of the same folder.
    """
    model = fit.model
    of_effect = np.array([parameter.effect for parameter in model.layout.parameters])
    effects, null = list(dict.fromkeys(of_effect.tolist())), null_point(model)
    points = np.stack([fit.z, *(np.where(of_effect == each, null, fit.z) for each in effects)])
    change = predict_many(model.problem, points)
    joint = _joint(fit, points, summary)
    entries, campaign = model.entries, model.campaign
    here = ~entries.closing
    names = np.array([channel.name for channel in campaign.channels])
    keys = {
        "run": np.array([run.name for run in campaign.runs])[entries.run[here]],
        "row": entries.row[here],
        "channel": names[entries.channel[here]],
    }
    differences = []
    for predicted, values in zip(change, joint, strict=True):
        moved = pl.DataFrame({**keys, "moved": (predicted - change[0])[here]})
        table = residuals.join(moved, on=["run", "row", "channel"], how="left")
        table = table.with_columns(pl.col("predicted") + pl.col("moved").fill_null(0.0))
        found = _values(_predicted(campaign, table, {}))
        differences.append({key: value - values[key[0]] for key, value in found.items() if key[0] in values})
    whole, *without = differences
    return {
        key: [(name, total - other[key]) for name, other in zip(effects, without, strict=True) if key in other]
        for key, total in whole.items()
    }


def _joint(fit: Fit, points: np.ndarray, summary: Summary) -> list[dict[str, float]]:
    """Return parameters, derived quantities and their combinations by name, at each of some points in z (n, P)."""
    derived = evaluate_derived(fit.derived.derivation, fit.model.problem, points)
    full = np.concatenate([points, np.broadcast_to(fit.h, (len(points), len(fit.h)))], axis=1)
    parameters = in_units(fit.model, full)[:, : points.shape[1]]
    names = (*fit.model.layout.names, *(quantity.name for quantity in fit.derived.names))
    table = dict(zip(names, np.concatenate([parameters, derived], axis=1).T, strict=True))
    for each in summary.combinations:
        if all(name in table for name in each.quantities):
            table[each.name] = combined(each.weights, each.constant, [table[name] for name in each.quantities])
    return [{name: float(values[place]) for name, values in table.items()} for place in range(len(points))]


def _values(campaign: Campaign) -> dict[tuple[str, str], float]:
    return {(each.name, each.run): each.value for each in classical(campaign) if isinstance(each, Estimate)}


def _temperature(run: Run) -> float | None:
    known = run.covariates.get("temperature")
    if known is None:
        return None
    mean = float(np.mean(known))
    return mean if abs(mean - REFERENCE_TEMPERATURE) > _SAME_TEMPERATURE else None


def _predicted(campaign: Campaign, residuals: pl.DataFrame, offsets: Mapping[str, float]) -> Campaign:
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
