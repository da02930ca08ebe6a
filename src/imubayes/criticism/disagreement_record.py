"""A run that does not agree with the others, and what would make it agree, as records."""

from typing import Literal

from imubayes.json_record import Record


class DoubtedRun(Record):
    """A run that the others, which agree with one another, do not predict; `p` for all runs together."""

    run: str
    p: float


class AgreeingInput(Record):
    """A recorded quantity of a run, or of one row of it, and what would make the run agree with the others.

    Attributes
    ----------
    form : an ``offset`` or a ``factor`` of a column; the attitude of the ``seat``; an ``output_offset`` of each channel
        or an ``output_factor`` of all.
    quantity : the column; ``mounting`` or ``outputs``.
    unit : of the values; of a factor 1, of outputs the unit of the first channel.
    recorded : what the record says: the value of the row, the mean of the column, or 0 for the attitude and offsets and
        1 for a factor.
    agreeing : what would agree, for each component: value, factor, or rotation vector in body axes.
    sd : its standard uncertainty, the parameters of the model estimated beside it.
    delta_chi2 : drop of χ² with it, the model refitted, at the noise known before the fit.
    """

    form: Literal["offset", "factor", "seat", "output_offset", "output_factor"]
    quantity: str
    unit: str
    recorded: float | None
    agreeing: tuple[float, ...]
    sd: tuple[float, ...]
    delta_chi2: float


class RivalOfInput(Record):
    """Effects, acting in all runs, that explain what a wrong input explains; `log_odds` are theirs against it."""

    effects: tuple[str, ...]
    log_odds: float

    @property
    def leads(self) -> bool:
        """Whether the effects are likelier."""
        return self.log_odds >= 0


class Disagreement(Record):
    """A run, or one row of it, that does not agree with all others at the noise that was known before the fit.

    Attributes
    ----------
    row : counts from 1; None for the run as a whole.
    chi2, dof : what it adds to the χ² of all others, and its number of outputs.
    p : chance of that, corrected for the number of looks.
    causes : what would make it agree, the best first; those that the runs do not distinguish; empty where nothing in
        the record of the run explains it.
    instead : runs with a cause that explains the same, in place of this run.
    rivals : effects of the catalogue that explain the same, the likeliest first.
    """

    run: str
    row: int | None
    chi2: float
    dof: int
    p: float
    causes: tuple[AgreeingInput, ...]
    instead: tuple[str, ...] = ()
    rivals: tuple[RivalOfInput, ...] = ()

    @property
    def leads(self) -> bool:
        """Whether something wrong in the record of this run is likelier than any effect."""
        return not any(each.leads for each in self.rivals)
