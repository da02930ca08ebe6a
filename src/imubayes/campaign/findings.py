"""A finding: something about the recorded data that cannot be right, or that the reader should know.

Every finding has a fixed name, so that it can be looked up, counted and tested for.  Errors stop the
campaign from loading; warnings travel with it as notes.
"""

from dataclasses import dataclass
from typing import Literal

from imubayes.errors import Issue

Severity = Literal["error", "warning"]

FINDINGS: dict[str, str] = {
    "time_not_increasing": "the time column goes back or stands still",
    "gap": "samples are missing: a time step is much longer than the others",
    "duplicate_row": "a row repeats the one before it, time included",
    "stuck_channel": "a channel keeps one value while it should move",
    "saturated_channel": "a channel is cut off at a largest or smallest value",
    "nan_values": "a cell holds NaN or infinity",
    "missing_values": "a cell that must be filled is empty",
    "empty_run": "the run has no usable row",
    "rate_unit": "the rate column or the gyro is in another unit of rate",
    "angle_in_radians": "the angle column is in radians",
    "kelvin_temperature": "the temperature is in kelvin",
    "current_unit": "the injected current is in another unit",
    "acceleration_unit": "the accelerometer is in m/s² where g is meant, or the other way round",
    "scale_far_from_nominal": "the output moves with the input by a factor far from the nominal scale",
    "sign_reversed": "the output moves against the input",
    "axes_do_not_fit": "gyros and accelerometers do not turn together: axes are exchanged or reversed",
    "segment_not_constant": "the stimulus changes within a labelled segment",
    "partial_turn": "a mean over less than one turn at an unknown angle",
    "bad_count": "a number of samples or a standard deviation that cannot be",
    "unused_columns": "columns that were read and take no part yet",
}
"""Every named finding, with its meaning."""


@dataclass(frozen=True)
class Finding:
    """One finding.

    Attributes
    ----------
    name : a key of `FINDINGS`.
    severity : ``error`` or ``warning``.
    run : name of the run.
    what, where, allowed, remedy : the four parts of a complaint.
    """

    name: str
    severity: Severity
    run: str
    what: str
    where: str
    allowed: str
    remedy: str

    def problem(self) -> Issue:
        """Return the finding as a complaint."""
        return Issue(f"{self.name}: {self.what}", self.where, self.allowed, self.remedy)

    def __str__(self) -> str:
        return f"{self.name} ({self.severity}) in run '{self.run}': {self.what} [{self.where}]"
