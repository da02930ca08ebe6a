"""The textbook estimate of each procedure, run by run, beside which the joint fit stands."""

from collections.abc import Callable, Sequence

from imubayes.classical.base import Estimate, Finding, Undetermined
from imubayes.classical.converter import converter_test
from imubayes.classical.geographic_tumble import geographic_tumble
from imubayes.classical.polar_tumble import polar_tumble
from imubayes.classical.rate_test import rate_test
from imubayes.classical.reference_gyro import reference_test
from imubayes.classical.rotation_modulation import rotation_modulation
from imubayes.classical.servo_table import servo_test
from imubayes.classical.tumble import tumble_test
from imubayes.run import Campaign, Run

METHODS: dict[tuple[str, ...], Callable[[Campaign, Sequence[Run]], list[Finding]]] = {
    ("rate_table",): rate_test,
    ("dividing_head",): tumble_test,
    ("thermal_ramp", "current_injection"): converter_test,
    ("polar_tumble",): polar_tumble,
    ("geographic_tumble",): geographic_tumble,
    ("servo_table",): servo_test,
    ("rotation_modulation",): rotation_modulation,
    ("reference_gyro",): reference_test,
}
"""Procedures → evaluation of their runs together."""


def classical(campaign: Campaign) -> tuple[Finding, ...]:
    """Return the textbook estimates of a campaign, and what its runs cannot determine by the textbook."""
    found: list[Finding] = []
    for procedures, evaluate in METHODS.items():
        runs = [run for run in campaign.runs if run.procedure in procedures]
        found += evaluate(campaign, runs) if runs else []
    return tuple(found)


__all__ = ["METHODS", "Estimate", "Finding", "Undetermined", "classical"]
