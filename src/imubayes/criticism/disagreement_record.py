"""A run that does not agree with the others, and what would make it agree, as records."""

from typing import Literal

from imubayes.json_record import Record


class AgreeingInput(Record):
    """A recorded quantity of a run, or of one row of it, and what would make the run agree with the others.

    Attributes
    ----------
    form : an ``offset`` or a ``factor`` of a column; the attitude of the ``seat``; an ``output_offset`` of each channel
        or an ``output_factor`` of all.
    quantity : the column; ``mounting``; ``outputs``, or the channel of the only output.
    unit : of the values; of a factor 1, of outputs the unit of the first channel.
    recorded : what the record says: the value of the row, the mean of the column, or 0 for the attitude and offsets and
        1 for a factor.
    agreeing : what would agree, for each component: value, factor, or rotation vector in body axes.
    sd : its standard uncertainty, the parameters of the model estimated beside it.
    probability : among all wrong inputs.
    """

    form: Literal["offset", "factor", "seat", "output_offset", "output_factor"]
    quantity: str
    unit: str
    recorded: float | None
    agreeing: tuple[float, ...]
    sd: tuple[float, ...]
    probability: float


class Disagreement(Record):
    """A run, or one row of it, whose record is wrong in the likeliest explanation.

    Attributes
    ----------
    row : counts from 1; None for the run as a whole.
    log_odds : natural logarithm of the odds against the likeliest explanation with the record as it is.
    causes : what would make it agree, the likeliest first; those that the runs do not distinguish.
    instead : runs and rows with a cause that explains the same, in place of this one.
    """

    run: str
    row: int | None
    log_odds: float
    causes: tuple[AgreeingInput, ...]
    instead: tuple[str, ...] = ()
