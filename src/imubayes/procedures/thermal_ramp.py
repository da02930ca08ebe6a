"""Thermal ramp: the unit at rest while the temperature of sensor or converter varies (P8)."""

from imubayes.procedures.base import Procedure, Reduction
from imubayes.procedures.converter_temperature import combinations, converter_test
from imubayes.procedures.planned_steps import PlanRules

THERMAL_RAMP = Procedure(
    name="thermal_ramp",
    reference="IEEE Std 1293, thermal sensitivity test",
    columns=(("converter_temperature_degC", "temperature_degC"),),
    needs_table=True,
    reduction=Reduction.BINNED,
    abscissae=("converter_temperature", "temperature", "time"),
    plan=PlanRules(("converter_temperature_degC",), ("rows", "rate_degC_per_h")),
    evaluate=converter_test,
    combinations=combinations,
)
