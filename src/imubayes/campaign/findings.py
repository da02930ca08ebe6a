"""Findings: faults and peculiarities of the recorded data, each under a fixed name.

Findings of severity error prevent the campaign from loading; warnings are kept as notes of their run.
"""

from dataclasses import dataclass
from typing import Literal

from imubayes.errors import Issue

Severity = Literal["error", "warning"]

FINDINGS: dict[str, str] = {
    "time_not_increasing": "the time column does not increase",
    "time_unit": "the time column is in another unit",
    "time_origin": "the time column does not count from the start of the run",
    "runs_overlap": "runs of the unit overlap in time",
    "same_data": "two runs hold the same data",
    "gap": "samples are missing: a time step is much longer than the sampling interval",
    "duplicate_row": "a row is identical to the one before, time included",
    "stuck_channel": "a channel keeps one value while its input varies",
    "saturated_channel": "a channel is clipped at its maximum or minimum",
    "nan_values": "a cell holds NaN, infinity or a number that no instrument reads",
    "missing_values": "a required cell is empty",
    "empty_run": "the run has no usable row",
    "rate_unit": "the rate column or the gyro is in another unit of rate",
    "angle_in_radians": "the angle column is in radians",
    "kelvin_temperature": "the temperature is in kelvin",
    "current_unit": "the injected current is in another unit",
    "acceleration_unit": "the accelerometer is in m/s² in place of g, or vice versa",
    "scale_far_from_nominal": "the observed scale factor is far from nominal",
    "sign_reversed": "the output has the opposite sign of the input",
    "axes_do_not_fit": "gyros and accelerometers are inconsistent: axes are exchanged or reversed",
    "latitude_sign": "the gyros show the Earth rate of the other hemisphere",
    "latitude_value": "the gyros show the Earth rate of another latitude",
    "temperature_unit": "temperatures are in degrees Fahrenheit",
    "thermometers_exchanged": "the temperatures of sensor and converter are exchanged",
    "temperature_reversed": "a column of temperatures runs backwards in time",
    "files_exchanged": "the tables of two runs are exchanged",
    "mounting_mislabelled": "a run was made in another mounting of the campaign",
    "mountings_exchanged": "two mountings are exchanged",
    "mounting_wrong": "the matrix of a mounting is wrong",
    "mounting_turned": "a mounting is turned about the axis of the table",
    "table_reversed": "the table turns against the stated sense",
    "table_zero": "the zero of the table angle is off",
    "axis_zero": "the zero of the outer or middle axis of a table is off",
    "table_elevation": "the elevation of the axis of a table is wrong",
    "table_azimuth": "the azimuth of the axis of a table is wrong",
    "axes_exchanged": "channels are exchanged",
    "channel_unit": "a channel has another sign or unit",
    "angle_unit": "the angle column is in another unit",
    "table_rate": "the rates of the table in a run are wrong by a factor",
    "row_disagrees": "angle or rate of the table in one row contradicts its outputs",
    "time_shift": "outputs and table are shifted in time",
    "setup_disagrees": "the outputs contradict the set-up, and no single mistake explains it",
    "not_settled": "an output does not become steady at a level of the stimulus",
    "segment_not_constant": "the stimulus varies within a labelled segment",
    "partial_turn": "a mean over less than one turn at an unknown angle",
    "bad_count": "an impossible number of samples or standard deviation",
    "unfounded_uncertainty": "an uncertainty of a temperature that is not there",
    "unused_columns": "columns that are not used",
}
"""Name of every finding → its meaning."""

SYMPTOMS = ("sign_reversed", "scale_far_from_nominal")
"""Findings of single runs that a mistake in the set-up explains."""
UNIT_FINDINGS = ("rate_unit", "acceleration_unit")
"""Findings of wrong units of outputs in single runs, which may be what a mistake `LIKE_UNITS` looks like there."""
LIKE_UNITS = (
    "files_exchanged", "mounting_mislabelled", "mountings_exchanged", "mounting_turned", "mounting_wrong",
    "table_zero", "axis_zero", "table_elevation", "table_reversed", "axes_exchanged", "time_shift", "angle_unit",
)  # fmt: skip


@dataclass(frozen=True)
class Finding:
    """One finding.

    Attributes
    ----------
    name : a key of `FINDINGS`.
    severity : ``error`` or ``warning``.
    run : name of the run.
    what, where, allowed, remedy : as in `Issue`.
    """

    name: str
    severity: Severity
    run: str
    what: str
    where: str
    allowed: str
    remedy: str

    def problem(self) -> Issue:
        """Return the finding as an issue."""
        return Issue(f"{self.name}: {self.what}", self.where, self.allowed, self.remedy)

    def __str__(self) -> str:
        run = f" in run '{self.run}'" if self.run else ""
        return f"{self.name} ({self.severity}){run}: {self.what} [{self.where}]; {self.remedy}"
