"""What a procedure is: one record of all facts about one kind of test run.

A module holds one record, with the functions that it names, and is registered by one line in `imubayes.procedures`.
Reader, simulation, figures and textbook evaluation ask the record and know no procedure by name.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import Enum, auto

import numpy as np

from imubayes.procedures.kinematics import table_input, table_stimulus
from imubayes.procedures.nominal_stimulus import Stimulus
from imubayes.procedures.planned_steps import PlanRules
from imubayes.procedures.textbook import TextbookResult
from imubayes.run import Campaign, Channel, Mounting, Run, Site, Table


class Reduction(Enum):
    """How a raw log becomes rows."""

    CONSTANT = auto()
    """One row per span of constant rate, angle or current."""
    AT_REST = auto()
    """One row per span at rest; the table never turns while it is measured."""
    BINNED = auto()
    """At rest, in bins of temperature: temperature is the stimulus, or changes beside it."""
    FOLLOWED = auto()
    """Short rows that follow a stimulus which never stands still."""
    POSES = auto()
    """Static poses and the rotations between them."""


@dataclass(frozen=True)
class Procedure:
    """One kind of run.

    Attributes
    ----------
    name : as in campaign files.
    reference : where the procedure is described.
    columns : columns of run tables that it cannot do without; of each group one is enough.
    needs_table : whether a run names a table and a mounting.
    needs_gyro : whether it is meaningless for a unit without gyros.
    reduction : how raw logs become rows.
    by_direction : whether rows name the directions of the axes (`i_axis`, `o_axis`) in place of angles.
    rate_recorded : whether the table's rate is recorded or 0; otherwise something else measures it.
    injected : whether a current takes the place of the accelerometer at the converter.
    driven : whether a gyro drives the table, whose angle is then the observation.
    abscissae : covariates that figures show a run against, the first that varies.
    row_name : what a row is called in figures.
    plan : what a plan says of a run; None where it cannot be planned.
    kinematics : run and campaign → stimulus.
    nominal_input : run, channel, site, table and mounting → nominal input of the channel, rad/s or m/s², shape (R,),
        for checks of the rows; None where nothing is known of it.
    evaluate : campaign and runs → estimates by the textbook.  Procedures with one function are evaluated together.
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

    def stimulus(self, run: Run, campaign: Campaign) -> Stimulus:
        """Return the nominal stimulus of a run, at the nodes of its rows."""
        return replace(self.kinematics(run, campaign), injected=self.injected, driven=self.driven)
