"""Outliers: rows that the leading explanation predicts wrongly beyond chance."""

from statistics import NormalDist

import numpy as np

from imubayes.covariates import COVARIATES
from imubayes.criticism.evidence.posterior_summary import ExplanationPosterior
from imubayes.criticism.evidence.proposals import base_columns
from imubayes.json_record import Record
from imubayes.model.bind import Model

_CHANCE = 0.01
"""Probability that any row of a campaign is told by chance (convention)."""


class Outlier(Record):
    """An outlying sample.

    Attributes
    ----------
    row : counts from 1; of a raw log, the rows are its means.
    distance : deletion residual in standard deviations.
    time_s, table_angle_deg : of the row, as recorded; None where it has none.
    """

    run: str
    channel: str
    row: int
    distance: float
    time_s: float | None = None
    table_angle_deg: float | None = None


def outliers(posterior: ExplanationPosterior) -> tuple[Outlier, ...]:
    """Return the outlying rows beside the leading explanation, the farthest first.

    The deletion residual of a row is its residual over √(1 − leverage), in standard deviations of the noise of the
    explanation (Cook and Weisberg, 1982).
    """
    of, model = posterior.of, posterior.fitted.model
    least = -NormalDist().inv_cdf(0.5 * _CHANCE / max(of.problem.outputs, 1))
    found = [
        _outlier(model, int(of.problem.rows[k].entry[place]), float(distance[place]))
        for k in of.unit_of
        for distance in (_distances(posterior, k),)
        for place in np.flatnonzero(np.abs(distance) > least)
    ]
    return tuple(sorted(found, key=lambda each: -abs(each.distance)))


def _distances(posterior: ExplanationPosterior, channel: int) -> np.ndarray:
    """Return the deletion residual of each row of a channel, (n,)."""
    of, top = posterior.of, posterior.top
    where = of.taking_part(channel, top.columns, top.hypothesis.form)
    white = base_columns(of, top, channel) / top.scale[channel]
    weight = top.weight.get(channel)
    columns = white[:, :-1]
    covariance = of.solved(top).covariance[np.ix_(where, where)]
    leverage = np.sum((columns @ covariance) * columns, axis=1)
    residual = white[:, -1] - columns @ top.mean[where]
    if weight is not None:
        residual = residual / np.sqrt(weight)
    return residual / np.sqrt(np.maximum(1 - leverage, np.finfo(float).eps))


def _outlier(model: Model, entry: int, distance: float) -> Outlier:
    entries = model.entries
    return Outlier(
        run=model.campaign.runs[entries.run[entry]].name,
        channel=model.campaign.channels[entries.channel[entry]].name,
        row=int(entries.row[entry]) + 1,
        distance=distance,
        time_s=_read(model, "time", entry),
        table_angle_deg=_read(model, "table_angle", entry),
    )


def _read(model: Model, covariate: str, entry: int) -> float | None:
    """Return what the row of an entry recorded of a covariate, in the unit of its column; None where nothing."""
    run = model.campaign.runs[model.entries.run[entry]]
    if covariate not in run.covariates or model.entries.closing[entry]:
        return None
    value = model.campaign.as_read(run, covariate)[model.entries.row[entry]]
    known = np.isfinite(value) and (run.table is not None or not covariate.startswith("table_"))
    return float(value) / COVARIATES[covariate].factor() if known else None
