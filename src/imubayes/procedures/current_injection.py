"""Current injection: a known current takes the accelerometer's place at the converter (P8).

It stands for inputs that no table gives, 12 g and more, and what the sensor itself does drops out: this is what
tells the converter's gain drift from the sensor's.
"""

import numpy as np

from imubayes.procedures.base import Procedure, Reduction
from imubayes.procedures.converter_ramp import converter_test
from imubayes.procedures.planned_steps import RAMP_KEYS, PlanRules
from imubayes.run import Channel, Mounting, Run, Site, Table


def _nominal_input(
    run: Run, channel: Channel, _site: Site, _table: Table | None, _mounting: Mounting | None
) -> np.ndarray | None:
    """Return the acceleration that the current stands for."""
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
)
