"""Which effects of a model make the classical estimates differ from the joint ones.

The difference is formed again with the parameters of each effect at their null values.  What it then lacks the effect
adds: the classical evaluation leaves that effect out.
"""

from collections.abc import Mapping, Sequence

import numpy as np
import polars as pl

from imubayes.display.classical_comparison import classical_values, with_outputs
from imubayes.inference.determined_combinations import combined
from imubayes.inference.fitted_model import Fit
from imubayes.loop.warm_start import null_point
from imubayes.model.derived_quantities import evaluate_derived
from imubayes.model.problem import predict_many
from imubayes.results.posterior_groups import in_units
from imubayes.results.summary import Summary


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
        found = classical_values(with_outputs(campaign, table, {}))
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
