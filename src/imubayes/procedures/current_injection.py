"""Current injection: a known current replaces the accelerometer at the converter input (P8).

It is equivalent to inputs beyond the range of a table, 12 g and more.  The sensor is out of the loop, which separates
the gain drift of the converter from that of the sensor.
"""

import numpy as np

from imubayes.campaign_data import Channel, Mounting, Run, Site, Table
from imubayes.procedures.base import Procedure, Reduction
from imubayes.procedures.converter_temperature import combinations, converter_test
from imubayes.procedures.planned_steps import RAMP_KEYS, PlanRules


def _nominal_input(
    run: Run, channel: Channel, _site: Site, _table: Table | None, _mounting: Mounting | None
) -> np.ndarray | None:
    """Return the acceleration equivalent to the current, m/s², shape (R,)."""
    if not channel.current_per_acceleration or "current" not in run.covariates:
        return None
    return run.covariates["current"] / channel.current_per_acceleration


CURRENT_INJECTION = Procedure(
    name="current_injection",
    reference="IEEE Std 1293, electronics calibration",
    columns=(("current_mA",),),
    reduction=Reduction.BINNED,
    injected=True,
    abscissae=("converter_temperature", "current", "temperature", "time"),
    plan=PlanRules(("current_mA",), RAMP_KEYS),
    nominal_input=_nominal_input,
    evaluate=converter_test,
    combinations=combinations,
)
