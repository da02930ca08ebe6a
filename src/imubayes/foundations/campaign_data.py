"""Recorded data in SI, and the equipment: the data that everything above works on.

A `Campaign` is one unit's set of runs.  A `Run` holds rows: each row is the mean of `samples` raw samples taken while
the stimulus was what the covariates say.  These are plain frozen records of NumPy arrays; files and units are the
business of `imubayes.campaign`, pictures and datasheet units of `imubayes.display`.

A unit has a grade, to which default priors belong.  The default prior of a parameter is that of a tactical or
navigation-grade unit.  If coarser units are met with larger errors, the parameter declares the widths for these:
`coarse`, for an industrial and for a consumer unit.  Widths are the largest values of data sheets: consumer, MPU-6050,
MPU-9250, BMI160, ICM-20948, LSM6DS3 (zero-rate output 5 to 20 deg/s, sensitivity 3 %, cross-axis 2 %, zero-g 60 to
80 mg); industrial, ADIS16448, ADIS16465, MTi-30, HG4930 (0.2 to 1 deg/s, 0.2 to 1 %, 0.05 to 0.2 deg, 10 to 20 mg).
If data sheets are silent (g², dT/dt, hysteresis) the width follows from the bias or the scale factor in the ratio
that it has for better units.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal, get_args

import numpy as np

from imubayes.foundations.earth import normal_gravity, table_to_local, towards
from imubayes.foundations.quantity_names import INPUT_AXIS, QuantityName, name_of
from imubayes.foundations.records import Record
from imubayes.foundations.units import to_si

Grade = Literal["consumer", "industrial", "tactical", "navigation"]
"""Grade of a unit, which chooses the default priors."""
GRADES: tuple[Grade, ...] = get_args(Grade)
"""All grades, the coarsest first."""


def graded_prior(prior: str, unit: str, coarse: tuple[float, float] | None, grade: Grade) -> str:
    """Return the default prior of a parameter for a grade of unit, as written in a model file.

    Parameters
    ----------
    prior : for tactical and navigation grade.
    unit : of the widths.
    coarse : width (of a lognormal prior the median) for industrial and consumer grade; None if it is the same.
    """
    if coarse is None or grade not in ("industrial", "consumer"):
        return prior
    width = f"{coarse[0 if grade == 'industrial' else 1]:g} {unit}"
    family, arguments = prior.rstrip(")").split("(", 1)
    if family == "normal":
        return f"normal(0, {width})"
    return ", ".join([f"{family}({width}", *arguments.split(",")[1:]]).replace(",  ", ", ") + ")"


Kind = Literal["gyro", "accelerometer", "angle"]
KINDS: tuple[Kind, ...] = ("accelerometer", "gyro")
"""Kinds of inertial sensors, sorted: JAX walks through a dictionary in this order."""
INPUT_UNIT: dict[str, str] = {"gyro": "deg/s", "accelerometer": "g", "angle": "deg"}
"""Unit in which inputs and residuals at the input are stated, by kind of channel."""


@dataclass(frozen=True)
class Site:
    """Where the test was made: latitude in rad, height in m, gravity and its standard uncertainty in m/s².

    The uncertainty is 0 if gravity is exact, and None if it is not stated.

    Examples
    --------
    >>> import imubayes
    >>> campaign = imubayes.load_campaign("data/accel-channel")
    >>> round(campaign.site.height)
    400
    """

    latitude: float
    height: float
    gravity: float
    gravity_uncertainty: float | None = None

    @property
    def has_normal_gravity(self) -> bool:
        """Whether gravity is that of the ellipsoid at latitude and height, not measured at the site."""
        return self.gravity == normal_gravity(self.latitude, self.height)


@dataclass(frozen=True)
class Channel:
    """One sensitive axis with its readout.

    Attributes
    ----------
    name : its column in the run tables.
    kind : ``gyro`` or ``accelerometer``; ``angle`` for the reading of a table that a gyro drives, which is no channel
        of the unit.
    axes : shape (3, 3); rows are the nominal input, output and spin/pendulous axis (I, O, S) in body axes,
        a right-handed orthonormal set.
    output_unit : free text, for labels.
    scale : nominal output units per `per`.
    per : input unit of the datasheet: deg/s, deg/h, rad/s, g or m/s^2.
    scale_si : nominal output units per rad/s or per m/s².
    offset : nominal output at zero input, output units.
    noise : standard deviation of one raw sample, output units, or None if nothing is known.
    current_per_acceleration : sensor current in A per m/s², or None; for injected currents.

    Examples
    --------
    >>> import imubayes
    >>> campaign = imubayes.load_campaign("data/accel-channel")
    >>> campaign.channels[0].scale, campaign.channels[0].per
    (20000.0, 'g')
    """

    name: str
    kind: Kind
    axes: np.ndarray
    output_unit: str
    scale: float
    per: str
    scale_si: float
    offset: float = 0.0
    noise: float | None = None
    current_per_acceleration: float | None = None


@dataclass(frozen=True)
class Table:
    """A table of one, two or three axes, or a centrifuge.

    Azimuth and elevation are those of the outer axis, which carries the middle one and that the inner one, on which the
    unit is mounted.  Each axis has a frame with z along it; at zero angles the frame of an axis is that of the outer
    one after the smallest rotation that takes z to its direction.  A table of one axis is an inner axis alone.

    Attributes
    ----------
    name : as in campaign files.
    azimuth, elevation : rad.
    axis_uncertainty, rate_uncertainty, angle_uncertainty : of the direction of the outer axis, rad; of rates, ratio; of
        an angle that is read, rad.
    middle_axis, inner_axis : unit vectors in the frame of the outer axis at zero angles; None if there is none, or
        if there is only one axis.
    arm : distance of the inner from the outer axis along x of the outer one, m; 0 but for a centrifuge.
    zero_uncertainty, squareness_uncertainty : of the zero of each axis and of the angle between successive axes, rad.
    intersection_uncertainty, arm_uncertainty : of the distance between successive axes and of the arm, m.
    azimuth_uncertainty, elevation_uncertainty : rad; None if they are that of the axis.
    zero_angle : reading of the angle of the inner axis at its zero, rad; angles of runs are counted from that zero.
    azimuth_known : whether the azimuth was stated; if not, it is 0.

    All uncertainties are one sigma; 0 is exact.

    Examples
    --------
    >>> import imubayes
    >>> campaign = imubayes.load_campaign("data/accel-channel")
    >>> round(campaign.tables["plate"].elevation, 4)  # a vertical axis, in rad
    1.5708
    """

    name: str
    azimuth: float
    elevation: float
    axis_uncertainty: float | None = None
    rate_uncertainty: float | None = None
    angle_uncertainty: float | None = None
    middle_axis: tuple[float, float, float] | None = None
    inner_axis: tuple[float, float, float] | None = None
    arm: float = 0.0
    zero_uncertainty: float | None = None
    squareness_uncertainty: float | None = None
    intersection_uncertainty: float | None = None
    arm_uncertainty: float | None = None
    azimuth_uncertainty: float | None = None
    elevation_uncertainty: float | None = None
    zero_angle: float = 0.0
    azimuth_known: bool = True

    @property
    def tilt_uncertainty(self) -> tuple[float | None, float | None]:
        """Uncertainty of the direction of the outer axis about table x and y at angle 0, rad; None if not stated.

        Table x is horizontal: a tilt about it is one of the elevation, and one about y moves the axis by the azimuth
        times the cosine of the elevation.
        """
        across, about_x, about_y = self.axis_uncertainty, self.elevation_uncertainty, self.azimuth_uncertainty
        return (
            across if about_x is None else about_x,
            across if about_y is None else about_y * math.cos(self.elevation),
        )

    @property
    def outer_to_local(self) -> np.ndarray:
        """C of the frame of the outer axis at angle 0 to the local level, shape (3, 3)."""
        return table_to_local(self.azimuth, self.elevation)

    @property
    def to_local(self) -> np.ndarray:
        """C of the frame of the inner axis at zero angles to the local level, shape (3, 3)."""
        return self.outer_to_local if self.inner_axis is None else self.outer_to_local @ towards(self.inner_axis)

    @property
    def links(self) -> np.ndarray:
        """Rotations from the frame of the next axis to that of the outer and of the middle axis, shape (2, 3, 3).

        A table of two axes has no middle one: its place is taken by one along the inner axis that stands still.
        """
        inner = np.eye(3) if self.inner_axis is None else towards(self.inner_axis)
        middle = inner if self.middle_axis is None else towards(self.middle_axis)
        return np.stack([middle, middle.T @ inner])


@dataclass(frozen=True)
class Mounting:
    """How the unit sits on a table: nominal body_to_table (3, 3), seat uncertainty per angle in rad, 0 exact.

    Examples
    --------
    >>> import imubayes
    >>> campaign = imubayes.load_campaign("data/accel-channel")
    >>> campaign.mountings["up"].body_to_table[2].tolist()  # body x is up
    [1.0, 0.0, 0.0]
    """

    name: str
    body_to_table: np.ndarray
    uncertainty: float | None = None


def _trihedral() -> np.ndarray:
    azimuth = np.array([0.0, 120.0, 240.0]) * to_si("deg")
    across, along = math.sqrt(2 / 3), math.sqrt(1 / 3)
    return np.stack([across * np.cos(azimuth), across * np.sin(azimuth), np.full(3, along)])


PRESETS = {"trihedral": _trihedral(), "aligned": np.eye(3)}
"""Preset mountings: the trihedral (corner-cube) mounting, and body axes along the table axes."""


@dataclass(frozen=True)
class Thermometer:
    """A thermometer whose error is common to all runs that name it.

    Attributes
    ----------
    offset_uncertainty : standard uncertainty of its error at 25 °C, °C; None if the campaign states none.
    gain_uncertainty : of the error that grows with the distance from 25 °C, a ratio; None likewise.
    """

    name: str
    offset_uncertainty: float | None = None
    gain_uncertainty: float | None = None


THERMOMETERS = ("thermometer", "converter_thermometer")
"""Names of the fields of a run that name a thermometer: of the sensors, and of the converter."""


@dataclass(frozen=True)
class Instruments:
    """Relative standard uncertainties of instruments beside thermometers; None if the campaign states none.

    Attributes
    ----------
    clock, vibration : of the clock of the runs and of the vibration sensor.
    time_base, meter : of what outputs are counted or measured by.
    """

    clock: float | None = None
    vibration: float | None = None
    time_base: float | None = None
    meter: float | None = None


def _no_places() -> np.ndarray:
    return np.zeros(0, dtype=int)


@dataclass(frozen=True)
class Tumble:
    """The moving part of a unit that a hand or a drill turns: what the gyros saw between one pose and the next.

    A row is the mean over a static pose, or over a short window in motion.  The instants of such a window are carried:
    their attitude is that of the nearest pose, turned by what the gyros saw since.

    Attributes
    ----------
    pose : shape (R,); the pose (0, 1, …) that each row of the run was taken in.
    attitude : shape (poses, 3, 3); first estimate of body → local level of each pose, heading arbitrary.
    start, stop : shape (transitions,); the poses that a transition joins.
    step : shape (transitions, K); length of each integration step in s, 0 if padded.
    readings : shape (transitions, K, C); mean channel outputs over each step, output units, 0 if padded.
    coning : shape (transitions, K, 3); body rotation vector of each step less its mean rate times its length, in
        rad, from the nominal calibration: what averaging the rate over a step leaves out.
    flagged : shape (poses,); True if the pose was disturbed and is excluded from the fit.
    carried_row, carried_weight : shape (n,); row of each instant in motion, and its weight in the mean; empty if all
        rows are static.
    carried_turn, carried_step : shape (n,); its transition, and the number of steps from the start of that.
    carried_back : shape (n,); True if its pose is that at the end of the transition.
    first_gyros : shape (7, 6); first estimate of bias, rad/s, and scale factor error of the gyros along the body axes,
        from which a fit begins, then its information matrix; empty if all rows are static.
    waved : shape (R,), whether a row is a window in motion with a pose of its own, as nothing carries the attitude on;
        empty if all rows are static or carried.
    """

    pose: np.ndarray
    attitude: np.ndarray
    start: np.ndarray
    stop: np.ndarray
    step: np.ndarray
    readings: np.ndarray
    coning: np.ndarray
    flagged: np.ndarray
    carried_row: np.ndarray = field(default_factory=_no_places)
    carried_weight: np.ndarray = field(default_factory=lambda: np.zeros(0))
    carried_turn: np.ndarray = field(default_factory=_no_places)
    carried_step: np.ndarray = field(default_factory=_no_places)
    carried_back: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=bool))
    first_gyros: np.ndarray = field(default_factory=lambda: np.zeros((0, 6)))
    waved: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=bool))

    @property
    def carried(self) -> bool:
        """Whether the gyros carry the attitude from window to window."""
        return len(self.carried_row) > 0

    @property
    def in_motion(self) -> bool:
        """Whether rows are windows in motion."""
        return self.carried or bool(np.any(self.waved))

    @property
    def row_seconds(self) -> np.ndarray:
        """The time that each carried row averages over, s, shape (rows,); rows may be far apart."""
        ends = np.flatnonzero(np.diff(self.carried_row, append=-1))
        begins = np.concatenate([[0], ends[:-1] + 1])
        since = np.concatenate([np.zeros((len(self.step), 1)), np.cumsum(self.step, axis=1)], axis=1)
        turn, step = self.carried_turn, self.carried_step
        return since[turn[ends], step[ends]] - since[turn[begins], step[begins]]

    @property
    def turns(self) -> int:
        """Number of transitions; 0 for pose means."""
        return len(self.start)


@dataclass(frozen=True)
class Run:
    """One recorded run, reduced to rows.

    Attributes
    ----------
    name, procedure : as in the campaign file.
    table, mounting : names in the campaign, or None if the procedure has none.
    covariates : name in `imubayes.foundations.covariates.COVARIATES` → shape (R,) in SI.  `table_angle` is NaN if a
        row is a mean over whole turns.  `table_angle_span` is the angle swept during a row, 0 at rest.
    observed : shape (R, C) over the campaign's channels, output units, NaN if missing.
    samples : shape (R,) number of raw samples in each row's mean.
    sample_sd : shape (R, C) standard deviation of the raw samples of each row, NaN if unknown.
    start : ISO date and time of the run's beginning, or None.
    tumble : the moving part, for a free tumble.
    attitude : shape (R, 3, 3), body → local level of each row, if the record names directions instead of angles.
    notes : what the reduction did and what it left out, one sentence each.
    temperature_uncertainty, converter_temperature_uncertainty : standard uncertainty of the error of these temperatures
        that is common to all rows and independent of other runs, °C; None or 0 if there is no such error.
    thermometer, converter_thermometer : names of the thermometers of these temperatures; None for one of the run alone.
    turn_uncertainty : standard uncertainty of the angle of each row that turns, rad, if it is a turn from rest to
        rest; None if rows are at constant rates.

    Examples
    --------
    >>> import imubayes
    >>> campaign = imubayes.load_campaign("data/accel-channel")
    >>> run = campaign.runs[0]
    >>> run.procedure, run.observed.shape == (run.rows, len(campaign.channels))
    ('thermal_ramp', True)
    """

    name: str
    procedure: str
    table: str | None
    mounting: str | None
    covariates: Mapping[str, np.ndarray]
    observed: np.ndarray
    samples: np.ndarray
    sample_sd: np.ndarray
    start: str | None = None
    tumble: Tumble | None = None
    attitude: np.ndarray | None = None
    notes: tuple[str, ...] = ()
    temperature_uncertainty: float | None = None
    converter_temperature_uncertainty: float | None = None
    turn_uncertainty: float | None = None
    thermometer: str | None = None
    converter_thermometer: str | None = None

    @property
    def rows(self) -> int:
        """Number of rows."""
        return len(self.samples)


class SetAside(Record):
    """Readings that a model leaves out, and why; their files stay as they are.

    Attributes
    ----------
    channels, rows : of the run, rows counted from 1; empty for all.
    """

    run: str
    reason: str
    channels: tuple[str, ...] = ()
    rows: tuple[int, ...] = ()


@dataclass(frozen=True)
class Campaign:
    """One unit, its equipment and its runs.

    `digest` identifies the data (SHA-256 of files as read), `folder` is where they were read; both empty if the
    campaign came from no files.  `delta_k_threshold` is the Δk up to which the 1 g line of a converter applies to all
    inputs, as a ratio; None for the default.  `set_aside` are readings that a model has taken out of its runs.
    `labels` are what the campaign states of its unit or its making that may distinguish units, such as the lot.

    Examples
    --------
    >>> import imubayes
    >>> campaign = imubayes.load_campaign("data/accel-channel")
    >>> campaign.name, [channel.name for channel in campaign.channels], round(campaign.site.gravity, 3)
    ('accel-channel', ['ax'], 9.795)
    """

    name: str
    site: Site
    channels: tuple[Channel, ...]
    tables: Mapping[str, Table]
    mountings: Mapping[str, Mounting]
    runs: tuple[Run, ...]
    serial: str = ""
    digest: str = ""
    notes: tuple[str, ...] = field(default=())
    folder: str = ""
    grade: Grade | None = None
    delta_k_threshold: float | None = None
    set_aside: tuple[SetAside, ...] = ()
    labels: Mapping[str, str] = field(default_factory=dict)
    thermometers: Mapping[str, Thermometer] = field(default_factory=dict)
    instruments: Instruments = Instruments()

    def of_kind(self, kind: str) -> list[Channel]:
        """Return the channels of a kind, in order."""
        return [channel for channel in self.channels if channel.kind == kind]

    def north_is_stated(self, run: Run) -> bool:
        """Whether the azimuth of the table of a run is stated; without a table it is unknown."""
        return run.table is not None and self.tables[run.table].azimuth_known

    def unstated(self, run: Run) -> frozenset[str]:
        """Return the facts of the table of a run that are not stated, as effects need them: north and level."""
        if self.north_is_stated(run):
            return frozenset()
        level = run.table is not None and self.tables[run.table].axis_uncertainty is not None
        return frozenset({"unknown_heading"} if level else {"unknown_heading", "unknown_level"})

    def as_read(self, run: Run, covariate: str) -> np.ndarray:
        """Return a covariate of a run as it was read, (R,) in SI: the angle of a table on its scale."""
        table = self.tables.get(run.table or "")
        zero = table.zero_angle if table is not None and covariate == "table_angle" else 0.0
        return run.covariates[covariate] + zero

    def only(self, *names: str) -> "Campaign":
        """Return the campaign restricted to the named runs, in their original order."""
        return replace(self, runs=tuple(run for run in self.runs if run.name in names))


COMPONENTS = ("x", "y", "z")


def component_names(channel: str) -> tuple[str, ...]:
    """Return the names of the three components of a channel's input axis."""
    return tuple(name_of(INPUT_AXIS, channel, component) for component in COMPONENTS)


def channel_of_component(name: str) -> str | None:
    """Return the channel if a derived quantity is a component of its input axis; None of any other quantity."""
    parts = QuantityName.of(name)
    return parts.first if parts.family == INPUT_AXIS else None
