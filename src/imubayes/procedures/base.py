"""The record of a test procedure: all facts about one kind of run.

Each procedure is one module with one record and the functions that it names, registered by one line in
`imubayes.procedures`.  Reader, simulation, figures and textbook evaluation use the record, never a procedure's name.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import Enum, auto

import numpy as np

from imubayes.campaign_data import Campaign, Channel, Mounting, Run, Site, Table
from imubayes.procedures.kinematics import table_input, table_stimulus
from imubayes.procedures.nominal_stimulus import Stimulus
from imubayes.procedures.planned_steps import PlanRules
from imubayes.procedures.standard_combinations import StandardCombination
from imubayes.procedures.textbook import TextbookResult


class Reduction(Enum):
    """How a raw log is reduced to rows."""

    CONSTANT = auto()
    """One row per span of constant rate, angle or current."""
    AT_REST = auto()
    """One row per span at rest; the table does not turn during measurements."""
    BINNED = auto()
    """At rest, in bins of temperature, which is the stimulus or varies along with it."""
    BLOCKS = auto()
    """At rest, in blocks of equal duration."""
    FOLLOWED = auto()
    """Short rows that follow a continuously varying stimulus."""
    POSES = auto()
    """Static poses and the rotations between them."""


@dataclass(frozen=True)
class Procedure:
    """One kind of run.

    Attributes
    ----------
    name : as in campaign files.
    reference : source of the procedure.
    columns : required columns of run tables, in groups; of each group one is enough.
    needs_table : whether a run must name a table and a mounting.
    needs_gyro : whether the unit must have a gyro.
    reduction : how raw logs are reduced to rows.
    by_direction : whether rows give the directions of the axes (`i_axis`, `o_axis`) instead of angles.
    rate_recorded : whether the table rate is recorded (0 if absent); False if another instrument measures it.
    injected : whether a current replaces the accelerometer at the converter input.
    driven : whether a gyro drives the table, whose angle is then the observation.
    abscissae : covariates for the abscissa of figures; the first that varies is used.
    row_name : name of a row in figures.
    plan : the keys of a planned run; None if it cannot be planned.
    kinematics : run and campaign → stimulus.
    nominal_input : run, channel, site, table and mounting → nominal input of the channel, rad/s or m/s², shape (R,),
        for checks of the rows; None if unknown.
    evaluate : campaign and runs → textbook estimates.  Procedures that share the function are evaluated together.
    combinations : campaign and runs → the combinations of parameters that the procedure is known to determine.
    """

    name: str
    reference: str = ""
    columns: tuple[tuple[str, ...], ...] = ()
    needs_table: bool = False
    needs_gyro: bool = False
    reduction: Reduction = Reduction.CONSTANT
    by_direction: bool = False
    rate_recorded: bool = True
    injected: bool = False
    driven: bool = False
    abscissae: tuple[str, ...] = ("time",)
    row_name: str = "row"
    plan: PlanRules | None = None
    kinematics: Callable[[Run, Campaign], Stimulus] = table_stimulus
    nominal_input: Callable[[Run, Channel, Site, Table | None, Mounting | None], np.ndarray | None] = table_input
    evaluate: Callable[[Campaign, Sequence[Run]], list[TextbookResult]] | None = None
    combinations: Callable[[Campaign, Sequence[Run]], list[StandardCombination]] | None = None

    def stimulus(self, run: Run, campaign: Campaign) -> Stimulus:
        """Return the nominal stimulus of a run, at the nodes of its rows."""
        found = self.kinematics(run, campaign)
        return replace(found, injected=self.injected, driven=self.driven, directed=self.by_direction)
