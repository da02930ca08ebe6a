"""Motion of the carrier of a rotating unit, as recorded or with the fitted errors taken out, with uncertainty.

Errors that are constant in the unit, of the calibration or of a run, stay along the axis of rotation; across it they
rotate, and of their mean over a run only the part remains that an unfinished turn leaves.
"""

from dataclasses import dataclass

import numpy as np

from imubayes.campaign_data import Campaign, Run
from imubayes.procedures.rotation_modulation import Carrier, attenuation, carrier, noise_of, to_table_axes
from imubayes.results.corrected_outputs import CorrectedRun

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
