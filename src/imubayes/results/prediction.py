"""Records of runs that a fitted model predicts: goodness of prediction, and the estimates they contradict.

A prediction fails if the readings together, a run and channel, or the shift of an estimate are less likely than one
in a hundred; the three are asked at once, of all runs and channels and of all estimates, and share that chance
(Bonferroni).
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
import polars as pl

from imubayes.foundations.campaign_data import Campaign
from imubayes.foundations.records import Presented, Record, finite
from imubayes.foundations.tail_probabilities import chi2_survival
from imubayes.loop.predicted_runs import PredictedRuns, ShiftedEstimate, predict_runs, root_mean_square_scales
from imubayes.results.result import Predicted, Result, residual_table
from imubayes.results.stored_tables import Residuals
from imubayes.results.summary import RunSummary, Summary

LEAST_CHANCE = 0.01
"""Chance below which a prediction fails.  Convention."""


class PredictionSummary(Record):
    """Everything `imubayes predict --json` says (format 1).

    Attributes
    ----------
    campaign, result_campaign, model : names of the predicted campaign, of that of the fit, and of the model.
    verdict : whether the runs are as predicted.
    runs : n, χ² by the predictive distribution and residual rms of each run and channel.
    chi2, n, p : of all readings together; n are degrees of freedom.
    calibration_chi2, directions, calibration_p : of the combinations of estimates that the new runs know better than
        the fit.
    worst_run_p, worst_shift_p : the least chance of a run and channel, and of a shift, each for all of them together.
    shifts : of the estimates, largest pull first.
    fitted, changed, elsewhere : runs left out as the fit has seen them; equipment that is not that of the fit although
        named alike; whether the site is another one.
    unknowns : parameters that belong to the new runs alone, and were fitted.
    """

    format: Literal[1] = 1
    campaign: str
    result_campaign: str
    model: str
    verdict: Literal["as_predicted", "not_as_predicted"]
    runs: tuple[RunSummary, ...]
    chi2: float | None
    n: int
    p: float | None
    calibration_chi2: float | None
    directions: int
    calibration_p: float | None
    worst_run_p: float | None
    worst_shift_p: float | None
    shifts: tuple[ShiftedEstimate, ...]
    fitted: tuple[str, ...]
    changed: tuple[str, ...]
    elsewhere: bool
    unknowns: tuple[str, ...]


@dataclass(frozen=True, repr=False)
class RunPrediction(Presented):
    """Runs against their prediction; shows itself in a terminal and in a notebook.

    Attributes
    ----------
    summary : the record of the prediction.
    residuals : one row per new run, row and channel; `whitened` is by the predictive distribution.
    fit : summary of the fit.

    Examples
    --------
    >>> import imubayes
    >>> found = imubayes.predict("results/accel-channel", "campaigns/later")
    >>> found.holds, found.residuals.table["run"].n_unique()
    (True, 3)
    """

    summary: PredictionSummary
    residuals: Residuals
    fit: Summary

    @property
    def holds(self) -> bool:
        """Whether the runs are as predicted."""
        return self.summary.verdict == "as_predicted"


def broad_scales(result: Result) -> np.ndarray:
    """Return the noise scales of a result, (H,) in z, by the posterior mean of their squares."""
    known = {
        name: (each.mean, each.sd)
        for name, each in result.quantities.items()
        if each.mean is not None and each.sd is not None
    }
    return root_mean_square_scales(result.fit, known)


def prediction(
    result: Result, campaign: Campaign, changed: tuple[str, ...], any_unit: bool, tell: Callable[[str], None]
) -> RunPrediction:
    """Return the runs of a campaign against their prediction by a result; see `imubayes.predict`."""
    found = predict_runs(result.fit, campaign, broad_scales(result), changed, any_unit, tell)
    residuals = _table(found)
    runs = _runs(residuals, found.freedom)
    chances = [float(chi2_survival(run.chi2, run.n)) for run in runs if run.chi2 is not None and run.n]
    pulls = [shift.p for shift in found.shifts]
    p = float(chi2_survival(found.chi2, found.n))
    worst_run, worst_shift = (min(1.0, len(each) * min(each, default=1.0)) for each in (chances, pulls))
    fails = not 3 * min(p, worst_run, worst_shift) >= LEAST_CHANCE
    layout, shared = found.joined.model.layout, found.joined.shared_with(result.fit)
    summary = PredictionSummary(
        campaign=campaign.name,
        result_campaign=result.summary.campaign,
        model=result.summary.model,
        verdict="not_as_predicted" if fails else "as_predicted",
        runs=runs,
        chi2=finite(found.chi2),
        n=found.n,
        p=finite(p),
        calibration_chi2=finite(found.calibration_chi2),
        directions=found.directions,
        calibration_p=float(chi2_survival(found.calibration_chi2, found.directions)) if found.directions else None,
        worst_run_p=worst_run,
        worst_shift_p=worst_shift,
        shifts=found.shifts,
        fitted=found.joined.together.fitted,
        changed=found.joined.together.changed,
        elsewhere=found.joined.together.elsewhere,
        unknowns=tuple(name for name, known in zip(layout.names, shared.tolist(), strict=True) if not known),
    )
    return RunPrediction(summary, residuals, result.summary)


def _runs(residuals: Residuals, freedom: np.ndarray) -> tuple[RunSummary, ...]:
    """Return the quality of each run and channel, with its degrees of freedom for n."""
    shares = residuals.table.select("run", "channel", freedom=pl.Series(freedom)).group_by("run", "channel").sum()
    count = {(run, channel): round(total) for run, channel, total in shares.iter_rows()}
    return tuple(run.model_copy(update={"n": count[run.name, run.channel]}) for run in residuals.by_run_and_channel())


def _table(found: PredictedRuns) -> Residuals:
    new, model = found.joined.entries, found.joined.model

    def everywhere(values: np.ndarray) -> np.ndarray:
        whole = np.zeros(len(new))
        whole[new] = values
        return whole

    parts = (found.predicted, found.model_sd, found.noise_sd, found.whitened)
    table = residual_table(model, Predicted(*map(everywhere, parts))).table
    return Residuals(table.filter(pl.Series(new)))
