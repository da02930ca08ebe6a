"""Positions by direction: a gyro's axes along East, West, North, South, Up or Down (P5).

One axis carries ±1 g at a time, so that products of two components of gravity are never seen; the Earth's rate enters
through the input axis.
"""

from dataclasses import replace

import numpy as np

from imubayes.procedures.base import Procedure, table_stimulus
from imubayes.run import Campaign, Run
from imubayes.stimulus import Stimulus


class GeographicTumble(Procedure):
    """The unit at rest in positions that are named instead of measured."""

    name = "geographic_tumble"
    needs = ("i_axis", "o_axis")
    reference = "IEEE Std 517, tumble test in geographic positions"

    def stimulus(self, run: Run, campaign: Campaign) -> Stimulus:
        assert run.attitude is not None
        still = table_stimulus(run, campaign)
        return replace(still, base=run.attitude[still.row], table_angle=np.zeros_like(still.table_angle))
