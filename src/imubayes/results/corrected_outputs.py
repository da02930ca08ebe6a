"""Outputs of a run with every fitted error taken out, with uncertainty.

The fit predicts the outputs of the real unit, in its real mounting on the real table.  The outputs of an ideal unit at
the nominal stimulus, plus what the fit does not predict, are the corrected outputs: bias, scale factor and input axes
times the rate, temperature and every other fitted effect are removed by what they make of the outputs, whichever of
them the runs can tell apart.  Motion of the carrier beyond the nominal stimulus stays in, uncorrected to first order.
"""

from dataclasses import dataclass, replace

import numpy as np
import polars as pl

from imubayes.campaign_data import Campaign, Run
from imubayes.errors import InputError, Issue, closest_first
from imubayes.procedures.kinematics import nominal_outputs
from imubayes.results.residual_table import Residuals
from imubayes.results.summary import Summary


@dataclass(frozen=True)
class CorrectedRun:
    """A run with corrected outputs.

    Attributes
    ----------
    run : the run, with corrected outputs.
    calibration_sd : shape (R, C), standard uncertainty of the correction, output units; common to the rows.
    offset_sd : shape (C,), standard deviation of the offsets of runs, output units.
    """

    run: Run
    calibration_sd: np.ndarray
    offset_sd: np.ndarray


def corrected_run(campaign: Campaign, run: Run, residuals: Residuals, summary: Summary) -> CorrectedRun:
    """Return a run with every fitted error taken out of its outputs.

    Raises
    ------
    InputError
        where the fit did not use the run.
    """
    own = residuals.table.filter(pl.col("run") == run.name)
    if own.is_empty():
        known = residuals.table["run"].unique().to_list()
        issue = Issue(
            f"the fit has no run '{run.name}'",
            f"result of campaign '{campaign.name}'",
            closest_first(run.name, known),
            "name a run of the fit, or fit the campaign with it",
        )
        raise InputError(issue)
    columns = {channel.name: place for place, channel in enumerate(campaign.channels)}
    predicted = np.full(run.observed.shape, np.nan)
    spread = np.full(run.observed.shape, np.nan)
    places = np.array([columns[name] for name in own["channel"].to_list()])
    rows = own["row"].to_numpy()
    predicted[rows, places], spread[rows, places] = own["predicted"].to_numpy(), own["model_sd"].to_numpy()
    found = run.observed - predicted + nominal_outputs(campaign, run)
    scatter = {parameter.name: parameter.mean for parameter in summary.parameters}
    offsets = [scatter.get(f"run_scatter.tau[{channel.name}]") or 0.0 for channel in campaign.channels]
    return CorrectedRun(replace(run, observed=found), spread, np.array(offsets))
