"""The test procedures: what each kind of run does to the unit."""

from imubayes.procedures.base import Procedure
from imubayes.procedures.current_injection import CurrentInjection
from imubayes.procedures.dividing_head import DividingHead
from imubayes.procedures.free_tumble import FreeTumble
from imubayes.procedures.polar_tumble import PolarTumble
from imubayes.procedures.rate_table import RateTable
from imubayes.procedures.thermal_ramp import ThermalRamp

PROCEDURES: dict[str, Procedure] = {
    procedure.name: procedure
    for procedure in (RateTable(), DividingHead(), PolarTumble(), ThermalRamp(), CurrentInjection(), FreeTumble())
}

__all__ = ["PROCEDURES", "Procedure"]
