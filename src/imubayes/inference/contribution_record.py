"""What each test procedure contributes to a quantity, as a record."""

from imubayes.json_record import Record


class ProcedureShare(Record):
    """Standard deviation of a quantity from the runs of one procedure alone, and without them."""

    procedure: str
    alone: float
    without: float


class Contribution(Record):
    """Posterior standard deviation of a quantity, and by test procedure."""

    quantity: str
    unit: str
    sd: float
    by: tuple[ProcedureShare, ...]
