"""Dividing head: static positions about a horizontal axis carry gravity around the unit (P7)."""

from imubayes.procedures.base import Procedure, table_stimulus
from imubayes.run import Campaign, Run
from imubayes.stimulus import Stimulus


class DividingHead(Procedure):
    """Positions at rest; in a 1 g field sin² + cos² = 1 hides K_oo and K_pp behind bias and K2."""

    name = "dividing_head"
    needs = ("table_angle_deg",)
    reference = "IEEE Std 1293, multipoint tumble test"

    def stimulus(self, run: Run, campaign: Campaign) -> Stimulus:
        return table_stimulus(run, campaign)
