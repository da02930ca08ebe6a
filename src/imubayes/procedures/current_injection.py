"""Current injection: a known current takes the accelerometer's place at the converter (P8).

It stands for inputs that no table gives, 12 g and more, and what the sensor itself does drops out: this is what
tells the converter's gain drift from the sensor's.
"""

from imubayes.procedures.base import Procedure, table_stimulus
from imubayes.run import Campaign, Run
from imubayes.stimulus import Stimulus


class CurrentInjection(Procedure):
    """A known current into the converter alone."""

    name = "current_injection"
    needs = ("current_mA",)
    reference = "IEEE Std 1293, electronics calibration"

    def stimulus(self, run: Run, campaign: Campaign) -> Stimulus:
        return table_stimulus(run, campaign, injected=True)
