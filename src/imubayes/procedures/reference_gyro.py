"""Runs beside a reference gyro: the table need not hold its rate (P9).

The reference rides along with the unit and measures the inertial rate about the axes of the body, the Earth's with it.
Its reading stands in the place of the true rate; that it is a reading is `reference_noise`, its scale, bias and
alignment and the delay of its clock are effects.  The table says how the unit stands to gravity.
"""

from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicSpline

from imubayes.procedures.base import Procedure, table_stimulus
from imubayes.run import Campaign, Run
from imubayes.stimulus import Stimulus

AXES = ("reference_x", "reference_y", "reference_z")


class ReferenceGyro(Procedure):
    """The unit turned forward and reverse, at whatever rate, with a better gyro beside it."""

    name = "reference_gyro"
    needs = ("time_s", "reference_x_deg_s", "reference_y_deg_s", "reference_z_deg_s")
    reference = "IEEE Std 952, comparison with a reference gyro; errors in variables: Fuller (1987)"

    def stimulus(self, run: Run, campaign: Campaign) -> Stimulus:
        rate = reference_rate(run)
        nominal = table_stimulus(run, campaign)
        return replace(
            nominal,
            # The reference knows better.
            table_rate=np.zeros_like(nominal.table_rate),
            table_acceleration=np.zeros_like(nominal.table_acceleration),
            reference_rate=rate[nominal.row],
            reference_acceleration=_acceleration(run.covariates["time"], rate)[nominal.row],
            ambient=nominal.ambient | {"table_rate": (rate @ _axis(run, campaign))[nominal.row]},
        )


def reference_rate(run: Run) -> np.ndarray:
    """Return what the reference measured, body axes, rad/s, shape (R, 3)."""
    return np.stack([run.covariates[name] for name in AXES], axis=1)


def _axis(run: Run, campaign: Campaign) -> np.ndarray:
    """Return the table's axis in body axes."""
    return campaign.mountings[run.mounting].body_to_table[2] if run.mounting is not None else np.array([0.0, 0.0, 1.0])


def _acceleration(time: np.ndarray, rate: np.ndarray) -> np.ndarray:
    """Return the slope of a cubic spline through the rates, (R, 3); differences would flatten what wanders fast."""
    order = np.argsort(time, kind="stable")
    found = np.zeros_like(rate)
    if len(time) > 3 and np.all(np.diff(time[order]) > 0):
        found[order] = CubicSpline(time[order], rate[order]).derivative()(time[order])
    return found
