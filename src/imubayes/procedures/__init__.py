"""The test procedures: what each kind of run does to the unit."""

from imubayes.procedures.base import Procedure
from imubayes.procedures.current_injection import CurrentInjection
from imubayes.procedures.dividing_head import DividingHead
from imubayes.procedures.free_tumble import FreeTumble
from imubayes.procedures.geographic_tumble import GeographicTumble
from imubayes.procedures.polar_tumble import PolarTumble
from imubayes.procedures.rate_table import RateTable
from imubayes.procedures.reference_gyro import ReferenceGyro
from imubayes.procedures.rotation_modulation import RotationModulation
from imubayes.procedures.servo_table import ServoTable
from imubayes.procedures.thermal_ramp import ThermalRamp

PROCEDURES: dict[str, Procedure] = {
    procedure.name: procedure
    for procedure in (
        RateTable(),
        RotationModulation(),
        DividingHead(),
        PolarTumble(),
        GeographicTumble(),
        ServoTable(),
        ThermalRamp(),
        CurrentInjection(),
        ReferenceGyro(),
        FreeTumble(),
    )
}

__all__ = ["PROCEDURES", "Procedure"]
