"""Rotation modulation: the unit turned forward and reverse without a stop, the table angle recorded (P3).

A bias at the angle θ from the axis keeps its part ε cos θ along the axis; the rest, ε sin θ, turns with the unit and
averages to nothing over whole turns.
"""

from imubayes.procedures.base import Procedure, table_stimulus
from imubayes.run import Campaign, Run
from imubayes.stimulus import Stimulus


class RotationModulation(Procedure):
    """Continuous rotation in a carrier, forward and reverse, in rows of known angle."""

    name = "rotation_modulation"
    needs = ("table_rate_deg_s", "table_angle_deg")
    reference = "Levinson and Majure, accuracy enhancement by rotation, AGARD 1987; Groves § 5"

    def stimulus(self, run: Run, campaign: Campaign) -> Stimulus:
        return table_stimulus(run, campaign)
