"""The test procedures, one module and one line of registration each, and the textbook estimates of a campaign.

Estimates and standard combinations are found procedure by procedure.
"""

from dataclasses import replace

from imubayes.foundations.campaign_data import Campaign
from imubayes.procedures.base import Procedure, Reduction
from imubayes.procedures.centrifuge import CENTRIFUGE
from imubayes.procedures.converter_temperature import CURRENT_INJECTION, THERMAL_RAMP
from imubayes.procedures.dividing_head import DIVIDING_HEAD
from imubayes.procedures.fitted_terms import StandardCombination
from imubayes.procedures.free_rotation import FREE_ROTATION
from imubayes.procedures.free_tumble import FREE_TUMBLE
from imubayes.procedures.geographic_tumble import GEOGRAPHIC_TUMBLE
from imubayes.procedures.multi_axis_table import MULTI_AXIS_TABLE
from imubayes.procedures.polar_tumble import POLAR_TUMBLE
from imubayes.procedures.rate_table import RATE_TABLE
from imubayes.procedures.reference_gyro import REFERENCE_GYRO
from imubayes.procedures.rotation_modulation import ROTATION_MODULATION
from imubayes.procedures.servo_table import SERVO_TABLE
from imubayes.procedures.slow_motion import SLOW_MOTION
from imubayes.procedures.static_record import STATIC_RECORD
from imubayes.procedures.textbook import TextbookResult

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
        SLOW_MOTION,
        FREE_ROTATION,
        STATIC_RECORD,
    )
}
"""Name → procedure."""


def procedure_named(name: str) -> Procedure:
    """Return a procedure by its name; one without any requirement where the name is unknown."""
    return PROCEDURES.get(name) or Procedure(name)


def classical(campaign: Campaign, delta_k_threshold: float | None = None) -> tuple[TextbookResult, ...]:
    """Return the textbook estimates of a campaign, and the quantities that the textbook methods cannot determine.

    Parameters
    ----------
    delta_k_threshold : largest Δk at which the 1 g line of a converter applies to another input, as a ratio; that of
        the campaign where None.
    """
    if delta_k_threshold is not None:
        campaign = replace(campaign, delta_k_threshold=delta_k_threshold)
    found: list[TextbookResult] = []
    for evaluate in dict.fromkeys(procedure.evaluate for procedure in PROCEDURES.values()):
        runs = [run for run in campaign.runs if PROCEDURES[run.procedure].evaluate is evaluate]
        found += evaluate(campaign, runs) if evaluate and runs else []
    return tuple(found)


def declared_combinations(campaign: Campaign) -> tuple[StandardCombination, ...]:
    """Return the standard combinations that the procedures of a campaign declare, each name once."""
    found: dict[str, StandardCombination] = {}
    for name, procedure in PROCEDURES.items():
        runs = [run for run in campaign.runs if run.procedure == name]
        for each in procedure.combinations(campaign, runs) if procedure.combinations and runs else []:
            found.setdefault(each.name, each)
    return tuple(found.values())


__all__ = ["PROCEDURES", "Procedure", "Reduction", "classical", "declared_combinations", "procedure_named"]
