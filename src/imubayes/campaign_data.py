"""What was recorded, in SI, and on which equipment: the data that everything above works on.

A `Campaign` is one unit's set of runs.  A `Run` holds rows: each row is the mean of `samples` raw samples
taken while the stimulus was what the covariates say.  These are plain frozen records of NumPy arrays; files
and units are the business of `imubayes.campaign`, pictures and datasheet units of `imubayes.display`.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from imubayes.parameters.unit_grades import Grade

Kind = Literal["gyro", "accelerometer", "angle"]


@dataclass(frozen=True)
class Site:
    """Where the test was made: latitude in rad, height in m, gravity in m/s²."""

    latitude: float
    height: float
    gravity: float


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
    noise : standard deviation of one raw sample, output units, or None where nothing is known.
    current_per_acceleration : sensor current in A per m/s², or None; for injected currents.
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
    """A single-axis table; angles in rad, rate uncertainty as a ratio; all uncertainties are one sigma, 0 is exact."""

    name: str
    azimuth: float
    elevation: float
    axis_uncertainty: float | None = None
    rate_uncertainty: float | None = None
    angle_uncertainty: float | None = None


@dataclass(frozen=True)
class Mounting:
    """How the unit sits on a table: nominal body_to_table (3, 3), seat uncertainty per angle in rad, 0 exact."""

    name: str
    body_to_table: np.ndarray
    uncertainty: float | None = None


@dataclass(frozen=True)
class Tumble:
    """The moving part of a free tumble: what the gyros saw between one static pose and the next.

    Attributes
    ----------
    pose : shape (R,); the pose (0, 1, …) that each row of the run was taken in.
    attitude : shape (poses, 3, 3); first estimate of body → local level of each pose, heading arbitrary.
    start, stop : shape (transitions,); the poses that a transition joins.
    step : shape (transitions, K); length of each integration step in s, 0 where padded.
    readings : shape (transitions, K, C); mean channel outputs over each step, output units, 0 where padded.
    coning : shape (transitions, K, 3); body rotation vector of each step less its mean rate times its length, in
        rad, from the nominal calibration: what averaging the rate over a step leaves out.
    flagged : shape (poses,); True where the pose was disturbed and is excluded from the fit.
    """

    pose: np.ndarray
    attitude: np.ndarray
    start: np.ndarray
    stop: np.ndarray
    step: np.ndarray
    readings: np.ndarray
    coning: np.ndarray
    flagged: np.ndarray


@dataclass(frozen=True)
class Run:
    """One recorded run, reduced to rows.

    Attributes
    ----------
    name, procedure : as in the campaign file.
    table, mounting : names in the campaign, or None where the procedure has none.
    covariates : name in `imubayes.covariates.COVARIATES` → shape (R,) in SI.  `table_angle` is NaN where a row is a
        mean over whole turns.  `table_angle_span` is the angle swept during a row, 0 at rest.
    observed : shape (R, C) over the campaign's channels, output units, NaN where missing.
    samples : shape (R,) number of raw samples in each row's mean.
    sample_sd : shape (R, C) standard deviation of the raw samples of each row, NaN where unknown.
    start : ISO date and time of the run's beginning, or None.
    tumble : the moving part, for a free tumble.
    attitude : shape (R, 3, 3), body → local level of each row, where the record names directions instead of angles.
    notes : what the reduction did and what it left out, one sentence each.
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

    @property
    def rows(self) -> int:
        """Number of rows."""
        return len(self.samples)


@dataclass(frozen=True)
class Campaign:
    """One unit, its equipment and its runs.

    `digest` identifies the data (SHA-256 of files as read), `folder` is where they were read; both empty where the
    campaign came from no files.  `delta_k_threshold` is the Δk up to which the 1 g line of a converter applies to all
    inputs, as a ratio; None for the default.
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

    def of_kind(self, kind: str) -> list[Channel]:
        """Return the channels of a kind, in order."""
        return [channel for channel in self.channels if channel.kind == kind]

    def only(self, *names: str) -> "Campaign":
        """Return the campaign restricted to the named runs, in their original order."""
        return replace(self, runs=tuple(run for run in self.runs if run.name in names))
