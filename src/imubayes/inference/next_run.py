"""A run that would determine what the data did not, as a record."""

from imubayes.inference.candidate_runs import RunDesign
from imubayes.json_record import Record


class NextRun(Record):
    """A run that would narrow a quantity: expected standard deviation before and after it."""

    run: RunDesign
    quantity: str
    sd_before: float
    sd_after: float
    unit: str
