"""What a change of a model does to the prediction of rows that were left out, as a record."""

from typing import Literal

from imubayes.criticism.verdict import RmsChange
from imubayes.json_record import Record

HeldOutVerdict = Literal["helps", "unclear", "not", "costs", "spares"]
"""An addition helps or does not; a removal costs prediction or spares it; either is unclear."""


class GroupGain(Record):
    """Rise of the log predictive density of one group of rows that was left out."""

    name: str
    delta: float


class CrossValidation(Record):
    """What a change of a model does to the prediction of rows that were left out.

    Attributes
    ----------
    by : what is left out at a time.
    delta, se : rise of the expected log predictive density (Δ elpd) and its standard error, from the scatter among the
        groups; None for a single group.
    helped, of : number of groups that are predicted better, and of all groups.
    verdict : whether the addition ``helps`` (Δ elpd above two standard errors, or above what flips of the signs of the
        groups reach by chance), that it is ``unclear``, or does ``not`` help.  A removal ``costs`` prediction where
        adding the same would help, and ``spares`` it where it would not.
    each : Δ elpd of each group.
    rates : of poses: rms of each gyro at rest about its prediction, before and after.
    """

    by: Literal["run", "pose", "block"]
    delta: float
    se: float | None
    helped: int
    of: int
    verdict: HeldOutVerdict
    each: tuple[GroupGain, ...] = ()
    rates: tuple[RmsChange, ...] = ()
