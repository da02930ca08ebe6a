"""The test procedures: one module and one line of registration each."""

from imubayes.procedures.base import Procedure, Reduction
from imubayes.procedures.centrifuge import CENTRIFUGE
from imubayes.procedures.current_injection import CURRENT_INJECTION
from imubayes.procedures.dividing_head import DIVIDING_HEAD
from imubayes.procedures.free_tumble import FREE_TUMBLE
from imubayes.procedures.geographic_tumble import GEOGRAPHIC_TUMBLE
from imubayes.procedures.multi_axis_table import MULTI_AXIS_TABLE
from imubayes.procedures.polar_tumble import POLAR_TUMBLE
from imubayes.procedures.rate_table import RATE_TABLE
from imubayes.procedures.reference_gyro import REFERENCE_GYRO
from imubayes.procedures.rotation_modulation import ROTATION_MODULATION
from imubayes.procedures.servo_table import SERVO_TABLE
from imubayes.procedures.static_record import STATIC_RECORD
from imubayes.procedures.thermal_ramp import THERMAL_RAMP

PROCEDURES: dict[str, Procedure] = {
    procedure.name: procedure
    for procedure in (
        RATE_TABLE,
        ROTATION_MODULATION,
        DIVIDING_HEAD,
        POLAR_TUMBLE,
        GEOGRAPHIC_TUMBLE,
        SERVO_TABLE,
        THERMAL_RAMP,
        CURRENT_INJECTION,
        REFERENCE_GYRO,
        MULTI_AXIS_TABLE,
        CENTRIFUGE,
        FREE_TUMBLE,
        STATIC_RECORD,
    )
}
"""Name → procedure."""


def procedure_named(name: str) -> Procedure:
    """Return a procedure by its name; one without any requirement where the name is unknown."""
    return PROCEDURES.get(name) or Procedure(name)


__all__ = ["PROCEDURES", "Procedure", "Reduction", "procedure_named"]
