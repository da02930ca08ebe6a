"""Table of two or three axes: static positions and rates about its axes, one at a time or several together.

The outer axis carries the middle axis, which carries the inner one with the unit; the entry of the table states their
directions. `table_rate_deg_s` and `table_angle_deg` are those of the inner axis.

The textbook evaluates all rows of a temperature together, in any mounting: accelerometers in the static rows, by least
squares with the terms that the positions separate (24 positions, IEEE Std 1293 and 1554), gyros in all rows, the Earth
rate being part of the known input (IEEE Std 952).  Axes, zeros and mounting are taken as exact.
"""

from collections.abc import Sequence

import numpy as np

from imubayes.foundations.campaign_data import Campaign, Run
from imubayes.procedures.base import PlannedRows, PlannedSteps, PlanRules, Procedure, whole_turns
from imubayes.procedures.fitted_terms import term_estimates
from imubayes.procedures.kinematics import AXES, serial_input, serial_stimulus
from imubayes.procedures.textbook import TextbookResult, by_temperature

METHOD = "multiposition test"


def multiposition_test(campaign: Campaign, runs: Sequence[Run]) -> list[TextbookResult]:
    """Return the coefficients of every channel that the positions and rates of a temperature separate."""
    found: list[TextbookResult] = []
    for group in by_temperature(runs):
        for place, channel in enumerate(campaign.channels):
            still = channel.kind == "accelerometer"
            found += term_estimates(campaign, group, place, still, METHOD)
    return found


def _planned_rows(steps: PlannedSteps) -> PlannedRows:
    """Return rows at the planned angles; an axis that turns alone makes whole turns."""
    angle = np.array(steps.axis_angles_deg)
    rate = np.zeros_like(angle) if steps.axis_rates_deg_s is None else np.array(steps.axis_rates_deg_s)
    alone = (np.count_nonzero(rate, axis=1) == 1)[:, None] & (rate != 0)
    duration = np.array([whole_turns(float(np.abs(each).max()), steps.duration) for each in np.where(alone, rate, 0)])
    names = AXES if angle.shape[1] == len(AXES) else (AXES[0], AXES[-1])
    columns: dict[str, np.ndarray] = {}
    for place, name in enumerate(names):
        columns[f"{name}_rate_deg_s"] = rate[:, place]
        columns[f"{name}_angle_deg"] = np.where(alone[:, place], np.nan, angle[:, place])
        columns[f"{name}_angle_span_deg"] = np.where(alone[:, place], 360.0, np.abs(rate[:, place]) * duration)
    return PlannedRows(duration, columns)


MULTI_AXIS_TABLE = Procedure(
    name="multi_axis_table",
    reference="IEEE Std 1293, multiposition tests; IEEE Std 952, rate tests",
    columns=(("outer_angle_deg",), ("table_angle_deg",), ("samples",)),
    needs_table=True,
    abscissae=("time", "table_angle", "middle_angle", "outer_angle", "table_rate", "outer_rate"),
    kinematics=serial_stimulus,
    nominal_input=serial_input,
    plan=PlanRules(("axis_angles_deg",), ("axis_rates_deg_s",), 10.0, _planned_rows),
    evaluate=multiposition_test,
)
