"""Thermal ramp: the unit at rest while sensor or converter change temperature (P8)."""

from imubayes.procedures.base import Procedure, table_stimulus
from imubayes.run import Campaign, Run
from imubayes.stimulus import Stimulus


class ThermalRamp(Procedure):
    """A constant input under a changing temperature."""

    name = "thermal_ramp"
    reference = "IEEE Std 1293, thermal sensitivity test"

    def stimulus(self, run: Run, campaign: Campaign) -> Stimulus:
        return table_stimulus(run, campaign)
