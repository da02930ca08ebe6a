"""Rate table: the unit turns at constant rates about one axis (P1, P2).

With the unit in a tilted fixture a channel sees Ω cos θ, so that one mounting determines the product k·cos θ·(1 + table
rate error) and nothing apart; other mountings, tumble runs or a reference gyro separate the three.
"""

from imubayes.procedures.base import Procedure, table_stimulus
from imubayes.run import Campaign, Run
from imubayes.stimulus import Stimulus


class RateTable(Procedure):
    """Constant rates, forward and reverse, with static records at start and end."""

    name = "rate_table"
    needs = ("table_rate_deg_s",)
    reference = "IEEE Std 952, rate table test series"

    def stimulus(self, run: Run, campaign: Campaign) -> Stimulus:
        return table_stimulus(run, campaign)
