"""Servo table: the gyro's own output drives the table, so that it always reads nothing (P6).

What is recorded is the table's angle, over hours.  It follows the differential equation that the balance of the gyro's
output gives: about the pole, dφ/dt = −ω_E·IA − d(f(φ)).
"""

import math
from dataclasses import replace

import numpy as np

from imubayes.procedures.base import Procedure, table_stimulus
from imubayes.run import Campaign, Run
from imubayes.stimulus import Stimulus


class ServoTable(Procedure):
    """A table slaved to a gyro, left alone for hours."""

    name = "servo_table"
    needs = ("time_s", "table_angle_deg")
    reference = "IEEE Std 517, servo table test"

    def stimulus(self, run: Run, campaign: Campaign) -> Stimulus:
        return replace(table_stimulus(run, campaign), driven=True)


def driving_channel(campaign: Campaign, run: Run) -> int:
    """Return the place among the gyros of the one that drives the table: the one most along its axis."""
    assert run.mounting is not None
    axis = campaign.mountings[run.mounting].body_to_table[2]
    gyros = [channel for channel in campaign.channels if channel.kind == "gyro"]
    return int(np.argmax([abs(float(channel.axes[0] @ axis)) for channel in gyros])) if gyros else 0


def turns_of(run: Run) -> float:
    """Return the angle that a table has been driven through, in turns."""
    return float(np.ptp(run.covariates["table_angle"])) / (2 * math.pi)
