"""Outputs of a run, and the motion of what carries a rotating unit, without the fitted errors, with uncertainty.

The fit predicts the outputs of the real unit, in its real mounting on the real table.  The outputs of an ideal unit at
the nominal stimulus, plus what the fit does not predict, are the corrected outputs: bias, scale factor and input axes
times the rate, temperature and every other fitted effect are removed by what they make of the outputs, whichever of
them the runs can distinguish.  Motion of the carrier beyond the nominal stimulus stays in, uncorrected to first order.

The motion of the carrier is reported as recorded, or corrected.  Errors that are constant in the unit, of the
calibration or of a run, stay along the axis of rotation; across it they rotate, and of their mean over a run only the
part remains that an unfinished turn leaves.
"""

from dataclasses import dataclass, replace

import numpy as np
import polars as pl

from imubayes.foundations.campaign_data import Campaign, Run
from imubayes.foundations.errors import closest_first, input_error
from imubayes.procedures.kinematics import nominal_outputs
from imubayes.procedures.rotation_modulation import attenuation, noise_of, to_table_axes
from imubayes.results.stored_tables import Residuals
from imubayes.results.summary import Summary
from imubayes_qualification.onboard.carrier_motion import Carrier, carrier


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
        if the fit did not use the run.
    """
    own = residuals.table.filter(pl.col("run") == run.name)
    if own.is_empty():
        known = residuals.table["run"].unique().to_list()
        raise input_error(
            f"the fit has no run '{run.name}'",
            f"result of campaign '{campaign.name}'",
            closest_first(run.name, known),
            "name a run of the fit, or fit the campaign with it",
        )
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


KINDS = ("gyro", "accelerometer")


@dataclass(frozen=True)
class CarrierEstimate:
    """The motion of the carrier in table axes at angle 0, SI, and its mean over the run.

    Attributes
    ----------
    motion : row by row.
    mean, mean_sd : kind → shape (3,), weighted by the arcs of the rows, and its standard uncertainty.
    row_sd : kind → shape (R, 3), standard uncertainty of a row.
    corrected : whether the fitted errors are taken out; if not, uncertainties contain the noise alone.
    """

    motion: Carrier
    mean: dict[str, np.ndarray]
    mean_sd: dict[str, np.ndarray]
    row_sd: dict[str, np.ndarray]
    corrected: bool


def estimate_carrier(campaign: Campaign, run: Run, corrected: CorrectedRun | None = None) -> CarrierEstimate:
    """Return the motion of the carrier with its uncertainty.

    Parameters
    ----------
    run : as recorded.
    corrected : the same run with the fitted errors taken out; None for the recorded outputs.
    """
    used = run if corrected is None else corrected.run
    motion = carrier(campaign, used)
    weight = np.abs(run.covariates["table_angle_span"])
    weight = weight / weight.sum() if weight.any() else np.full(run.rows, 1 / run.rows)
    mean, mean_sd, row_sd = {}, {}, {}
    for kind, vector in zip(KINDS, (motion.rate, motion.force), strict=True):
        mean[kind] = weight @ vector
        mean_sd[kind], row_sd[kind] = _uncertainty(campaign, run, used, kind, weight, corrected)
    return CarrierEstimate(motion, mean, mean_sd, row_sd, corrected is not None)


def _uncertainty(
    campaign: Campaign, run: Run, used: Run, kind: str, weight: np.ndarray, corrected: CorrectedRun | None
) -> tuple[np.ndarray, np.ndarray]:
    """Return the standard uncertainty of the mean, (3,), and of every row, (R, 3)."""
    places, to_table = to_table_axes(campaign, used, kind)
    if len(places) < 3:
        return np.full(3, np.nan), np.full((run.rows, 3), np.nan)
    scale = np.array([campaign.channels[place].scale_si for place in places])
    noise = noise_of(campaign, used, places)
    constant = np.zeros(len(places))
    if corrected is not None:
        constant = np.hypot(np.mean(corrected.calibration_sd[:, places], axis=0), corrected.offset_sd[places]) / scale
    angle, mean = run.covariates["table_angle"], attenuation(run)
    c, s = np.cos(angle) / mean, np.sin(angle) / mean
    turn = np.zeros((run.rows, 3, 3))
    turn[:, 0, 0], turn[:, 0, 1], turn[:, 1, 0], turn[:, 1, 1], turn[:, 2, 2] = c, -s, s, c, 1.0
    each = turn @ to_table
    # Noise is independent from row to row; what is constant in the unit is averaged by its rotation.
    averaged = np.einsum("r,rij->ij", weight, each)
    scattered = np.einsum("r,rij,j->i", weight**2, each**2, noise**2)
    return (
        np.sqrt(scattered + (averaged * constant) ** 2 @ np.ones(len(places))),
        np.sqrt(np.einsum("rij,j->ri", each**2, noise**2 + constant**2)),
    )
