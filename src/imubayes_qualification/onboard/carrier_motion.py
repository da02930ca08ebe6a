"""The motion of the carrier of a unit on a turning table, demodulated by the angle of the table."""

from dataclasses import dataclass

import numpy as np

from imubayes.foundations.campaign_data import Campaign, Run
from imubayes.procedures.rotation_modulation import attenuation, to_table_axes


@dataclass(frozen=True)
class Carrier:
    """The motion of the carrier, demodulated: in table axes at angle 0.

    Attributes
    ----------
    time : shape (R,), s; the row index if the run has no time.
    angle : shape (R,), table angle, rad.
    rate, force : shape (R, 3), rad/s and m/s²; NaN if the unit has fewer than three channels of the kind.
    """

    time: np.ndarray
    angle: np.ndarray
    rate: np.ndarray
    force: np.ndarray


def carrier(campaign: Campaign, run: Run) -> Carrier:
    """Return the rate and specific force of the carrier, demodulated by the recorded table angle and rate."""
    angle = run.covariates["table_angle"]
    found = {kind: _vector(campaign, run, kind) for kind in ("gyro", "accelerometer")}
    found["gyro"][:, 2] -= run.covariates["table_rate"]
    c, s, mean = np.cos(angle), np.sin(angle), attenuation(run)
    for vector in found.values():
        x, y = vector[:, 0] / mean, vector[:, 1] / mean
        vector[:, 0], vector[:, 1] = c * x - s * y, s * x + c * y
    time = run.covariates.get("time", np.arange(run.rows, dtype=float))
    return Carrier(time, angle, found["gyro"], found["accelerometer"])


def _vector(campaign: Campaign, run: Run, kind: str) -> np.ndarray:
    """Return the vector measured by a kind, turning table axes, SI, (R, 3); NaN for fewer than three channels."""
    places, to_table = to_table_axes(campaign, run, kind)
    if len(places) < 3:
        return np.full((run.rows, 3), np.nan)
    channels = [campaign.channels[place] for place in places]
    offset, scale = (np.array([getattr(channel, name) for channel in channels]) for name in ("offset", "scale_si"))
    return (run.observed[:, places] - offset) / scale @ to_table.T
