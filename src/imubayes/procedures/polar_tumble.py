"""Polar-axis tumble: a gyro turned about an axis that points to the pole, position by position (P4)."""

from imubayes.procedures.base import Procedure, table_stimulus
from imubayes.run import Campaign, Run
from imubayes.stimulus import Stimulus


class PolarTumble(Procedure):
    """Positions at rest about the pole: the Earth's rate on an input axis across it is zero, gravity goes around.

    Output axis to the north and to the south pole together determine all that the standard's ten drift coefficients
    leave determinable; with the input axis along the pole the rest.
    """

    name = "polar_tumble"
    needs = ("table_angle_deg",)
    reference = "IEEE Std 517, tumble test with the output axis parallel to the Earth's axis"

    def stimulus(self, run: Run, campaign: Campaign) -> Stimulus:
        return table_stimulus(run, campaign)
