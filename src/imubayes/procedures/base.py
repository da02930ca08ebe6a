"""The record of a test procedure: all facts about one kind of run, and the rows that a planned run gives.

Each procedure is one module with one record and the functions that it names, registered by one line in
`imubayes.procedures`.  Reader, simulation, figures and textbook evaluation use the record, never a procedure's name.

The steps of a planned run give rows that are consecutive in time: a turning row lasts whole turns, so that
angle-dependent terms average out, and consecutive rows are separated by the time to reach the next rate or position.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum, auto
from typing import Annotated

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from imubayes.foundations.campaign_data import Campaign, Channel, Mounting, Run, Site, Table
from imubayes.procedures.fitted_terms import StandardCombination
from imubayes.procedures.kinematics import Stimulus, table_input, table_stimulus
from imubayes.procedures.textbook import TextbookResult

SECONDS_PER_ROW = 60.0
Temperature = Annotated[float, Field(ge=-150, le=150)]
Positive = Annotated[float, Field(gt=0)]
OfAxes = Annotated[list[float], Field(min_length=2, max_length=3, description="outer, middle if there is one, inner")]


class PlannedSteps(BaseModel):
    """The keys of a planned run that define its steps; each procedure accepts some of them."""

    model_config = ConfigDict(
        extra="forbid", strict=True, allow_inf_nan=False, frozen=True, use_attribute_docstrings=True
    )

    rates_deg_s: Annotated[list[float], Field(min_length=1)] | None = None
    """rates of the table (of a centrifuge, of its arm), a row each"""
    positions: Annotated[int, Field(ge=1, le=100_000)] | None = None
    """number of equal steps of a full turn"""
    angles_deg: Annotated[list[float], Field(min_length=1)] | None = None
    """angles of the table, a row each"""
    converter_temperature_degC: Annotated[list[Temperature], Field(min_length=2, max_length=2)] | None = None
    """first and last temperature of the converter, in any run"""
    rows: Annotated[int, Field(ge=1, le=100_000)] | None = None
    """number of rows"""
    rate_degC_per_h: Positive | None = None
    """rate of a temperature ramp"""
    current_mA: float | None = None
    """current fed into the converter"""
    turns: Positive | None = None
    """turns of the table"""
    arc_deg: Annotated[float, Field(gt=0, le=90)] | None = None
    """angle over which a row is a mean"""
    axis_angles_deg: Annotated[list[OfAxes], Field(min_length=1)] | None = None
    """a row each: angles of the outer, (middle,) and inner axis"""
    axis_rates_deg_s: Annotated[list[OfAxes], Field(min_length=1)] | None = None
    """a row each: rates of the outer, (middle,) and inner axis"""
    directions: Annotated[list[str], Field(min_length=1)] | None = None
    """a row each: where input and output axis point, such as EN"""
    counter_rotation: bool | None = None
    """whether the platform of a centrifuge turns back, so that the unit keeps its heading"""
    hours: Annotated[float, Field(gt=0, le=1000)] | None = None
    """duration of the record"""
    poses: Annotated[int, Field(ge=9, le=200)] | None = None
    """rests of a free tumble"""
    samples: Annotated[int, Field(ge=1)] = 1200
    """raw samples in the mean of a row"""
    seconds_per_row: Positive | None = None
    """duration of a row"""

    @model_validator(mode="after")
    def _axes_of_every_row(self) -> "PlannedSteps":
        angles, rates = self.axis_angles_deg, self.axis_rates_deg_s
        if angles and len({len(row) for row in (*angles, *(rates or []))}) > 1:
            raise ValueError("every row gives the same axes: outer and inner, or outer, middle and inner")
        if angles and rates and len(angles) != len(rates):
            raise ValueError("'axis_rates_deg_s' has as many rows as 'axis_angles_deg'")
        return self

    @property
    def duration(self) -> float:
        """Shortest duration of a row, s."""
        return self.seconds_per_row or SECONDS_PER_ROW


RAMP_KEYS = ("converter_temperature_degC", "rows", "rate_degC_per_h")
OF_ANY_RUN = ("converter_temperature_degC",)
"""Covariates of every run, whatever its procedure."""
STEP_KEYS = tuple(key for key in PlannedSteps.model_fields if key not in ("samples", "seconds_per_row"))


@dataclass(frozen=True)
class PlannedRows:
    """The rows of a planned run.

    Attributes
    ----------
    duration : shape (R,), s.
    columns : shape (R,) each, in the units of the file; letters if a column is a direction.
    attitude : shape (R, 3, 3), body → local level, of a unit turned by hand; None on a table.
    motion : columns that the simulation needs and no instrument records.
    sampled : whether rows are raw samples, without `samples`.
    """

    duration: np.ndarray
    columns: dict[str, np.ndarray]
    attitude: np.ndarray | None = None
    motion: dict[str, np.ndarray] = field(default_factory=dict)
    sampled: bool = False


def ramp_rows(steps: PlannedSteps) -> PlannedRows:
    """Return the rows of a run at rest, over a temperature ramp if one is planned."""
    if steps.rate_degC_per_h is None or steps.converter_temperature_degC is None:
        return PlannedRows(np.full(steps.rows or 1, steps.duration), {})
    low, high = steps.converter_temperature_degC
    whole = 3600.0 * abs(high - low) / steps.rate_degC_per_h
    rows = steps.rows or max(1, round(whole / steps.duration))
    return PlannedRows(np.full(rows, whole / rows), {})


@dataclass(frozen=True)
class PlanRules:
    """The keys of planned runs of a procedure, and the rows that they give.

    Attributes
    ----------
    one_of : alternatives, of which a run has exactly one.
    further : optional keys.
    pause : time to reach the next rate or position, s.
    rows : steps → rows.
    nominal : columns, site, table and mounting → further columns that the nominal motion gives; None for none.
    """

    one_of: tuple[str, ...]
    further: tuple[str, ...] = ()
    pause: float = 0.0
    rows: Callable[[PlannedSteps], PlannedRows] = ramp_rows
    nominal: Callable[[dict[str, np.ndarray], Site, Table, Mounting], dict[str, np.ndarray]] | None = None


def position_rows(steps: PlannedSteps) -> PlannedRows:
    """Return the rows of static positions: evenly spaced over the circle, or at the planned angles."""
    angle = np.array(steps.angles_deg or 360.0 * np.arange(steps.positions or 0) / (steps.positions or 1))
    return PlannedRows(np.full(len(angle), steps.duration), {"table_angle_deg": angle})


def columns_of(steps: PlannedSteps, rules: PlanRules, rows: PlannedRows) -> dict[str, np.ndarray]:
    """Return the columns of a run except the outputs, in the units of the file; angles are NaN over whole turns."""
    end = np.cumsum(rows.duration + rules.pause) - rules.pause
    centre = end - rows.duration / 2
    columns = {"time_s": np.round(centre, 6)} | rows.columns
    if steps.converter_temperature_degC is not None:
        low, high = steps.converter_temperature_degC
        columns["converter_temperature_degC"] = low + (high - low) * centre / end[-1]
    if steps.current_mA is not None:
        columns["current_mA"] = np.full(len(centre), steps.current_mA)
    return columns | ({} if rows.sampled else {"samples": np.full(len(centre), float(steps.samples))})


def whole_turns(rate: float, seconds: float) -> float:
    """Return the shortest duration of whole turns at a rate in deg/s that is at least `seconds`."""
    if rate == 0:
        return seconds
    turn = 360.0 / abs(rate)
    return turn * max(1, math.ceil(seconds / turn - 1e-9))


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
    CARRIED = auto()
    """Short windows of a unit in motion, and the rotations from pose to pose."""

    @property
    def by_hand(self) -> bool:
        """Whether the gyros record a motion that nobody knows, of a unit without a table."""
        return self in (Reduction.POSES, Reduction.CARRIED)


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
    without_gyros : whether a log in motion is reduced if no gyros carry its attitude.
    by_direction : whether rows give the directions of the axes (`i_axis`, `o_axis`) instead of angles.
    rate_recorded : whether the table rate is recorded (0 if absent); False if another instrument measures it.
    injected : whether a current replaces the accelerometer at the converter input.
    at_rest : whether the unit rests from the first sample to the last.
    driven : whether a gyro drives the table, whose angle is then the observation.
    followed : whether rows may follow the angle of the table through its motion (`followed_rows`).
    abscissae : covariates for the abscissa of figures; the first that varies is used.
    row_name : name of a row in figures.
    plan : the keys of a planned run; None if it cannot be planned.
    kinematics : run and campaign → stimulus.
    nominal_input : run, channel, site, table and mounting → nominal input of the channel, rad/s or m/s², shape (R,),
        for checks of the rows; None if unknown.
    evaluate : campaign and runs → textbook estimates.  Procedures that share the function are evaluated together.
    purposes : effects whose coefficients the procedure is made to determine.
    combinations : campaign and runs → the combinations of parameters that the procedure is known to determine.
    """

    name: str
    reference: str = ""
    columns: tuple[tuple[str, ...], ...] = ()
    needs_table: bool = False
    needs_gyro: bool = False
    reduction: Reduction = Reduction.CONSTANT
    without_gyros: bool = False
    by_direction: bool = False
    rate_recorded: bool = True
    injected: bool = False
    at_rest: bool = False
    driven: bool = False
    followed: bool = False
    abscissae: tuple[str, ...] = ("time",)
    row_name: str = "row"
    plan: PlanRules | None = None
    kinematics: Callable[[Run, Campaign], Stimulus] = table_stimulus
    nominal_input: Callable[[Run, Channel, Site, Table | None, Mounting | None], np.ndarray | None] = table_input
    evaluate: Callable[[Campaign, Sequence[Run]], list[TextbookResult]] | None = None
    purposes: tuple[str, ...] = ()
    combinations: Callable[[Campaign, Sequence[Run]], list[StandardCombination]] | None = None

    def stimulus(self, run: Run, campaign: Campaign) -> Stimulus:
        """Return the nominal stimulus of a run, at the nodes of its rows."""
        found = self.kinematics(run, campaign)
        put = not (self.by_direction or self.injected or run.tumble is not None)
        return replace(
            found, injected=self.injected, driven=self.driven, directed=self.by_direction,
            unstated=campaign.unstated(run) if put else found.unstated,
        )  # fmt: skip
