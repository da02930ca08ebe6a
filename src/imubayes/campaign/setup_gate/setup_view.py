"""The recorded facts of a run, as a view that set-up mistakes change, with the motion of the outer axes of its table.

A `RunView` holds the nominal set-up of one run beside its outputs.  A suspected mistake is a changed view: another
table angle, another mounting, other units of a column.  The nominal input follows from the view alone.  On a table of
several axes the outer and the middle axis carry the inner one; the mean attitude of a unit that they turn follows from
their motion.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import lru_cache
from typing import Any

import numpy as np

from imubayes.foundations.campaign_data import Campaign, Run, Table
from imubayes.foundations.earth import earth_rate, table_to_local
from imubayes.procedures import PROCEDURES
from imubayes.procedures.kinematics import about_z, axis_angles, axis_columns, row_path, serial_stimulus


@dataclass(frozen=True)
class CarryingAxes:
    """The nominal motion of the outer and the middle axis in one run, in SI.

    Attributes
    ----------
    angle, rate, span : of both axes, at the middle of a row and swept during it; shape (R, 2).
    links : rotations from the frame of the next axis to that of the outer and of the middle axis, shape (2, 3, 3).
    """

    angle: np.ndarray
    rate: np.ndarray
    span: np.ndarray
    links: np.ndarray

    def at(self, rows: np.ndarray) -> "CarryingAxes":
        """Return the motion of other rows."""
        return replace(self, angle=self.angle[rows], rate=self.rate[rows], span=self.span[rows])

    def repeats(self) -> np.ndarray:
        """Return whether each row but the first repeats the angles of the row before it, shape (R − 1,)."""
        return np.all(np.nan_to_num(np.diff(self.angle, axis=0)) == 0, axis=1)

    def turned(self, inner: tuple[np.ndarray, np.ndarray, np.ndarray], to_local: np.ndarray) -> np.ndarray:
        """Return the rotation from local level to the table, mean over each row, shape (R, 3, 3).

        Parameters
        ----------
        inner : angle, rate and span of the inner axis, shape (R,) each.
        to_local : from the frame of the outer axis at angle 0, shape (3, 3).
        """
        return self._means(inner)[0] @ to_local.T

    def rate_of_table(self, inner: tuple[np.ndarray, np.ndarray, np.ndarray]) -> np.ndarray:
        """Return the rate of the table against the Earth in axes of the table, rad/s, mean over rows, shape (R, 3)."""
        return self._means(inner)[1]

    def _means(self, inner: tuple[np.ndarray, np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        own = (self.angle, self.rate, self.span)
        motion = [np.column_stack([outer, table]) for outer, table in zip(own, inner, strict=True)]
        return _means_of(*(each.tobytes() for each in (*motion, self.links)))


@lru_cache(maxsize=256)
def _means_of(angle: bytes, rate: bytes, span: bytes, links: bytes) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean over each row of the rotation from the frame of the outer axis to the table, and of its rate.

    Most suspected mistakes leave the motion of the axes as it is.
    """
    motion = [np.frombuffer(each).reshape(-1, 3) for each in (angle, rate, span)]
    paths = [row_path(*row) for row in zip(*motion, strict=True)]
    count = [len(weight) for _, weight in paths]
    weight, angles = (np.concatenate(parts) for parts in ([each for _, each in paths], [each for each, _ in paths]))
    speeds = np.repeat(motion[1], count, axis=0)
    stand, turning = np.broadcast_to(np.eye(3), (len(weight), 3, 3)), np.zeros((len(weight), 3))
    for place, link in enumerate([np.eye(3), *np.frombuffer(links).reshape(2, 3, 3)]):
        back = np.swapaxes(about_z(angles[:, place]), 1, 2)
        turning = turning @ link
        turning[:, 2] += speeds[:, place]
        stand, turning = back @ (link.T @ stand), np.einsum("nij,nj->ni", back, turning)
    starts = np.concatenate([[0], np.cumsum(count)[:-1]])
    return (
        np.add.reduceat(stand * weight[:, None, None], starts, axis=0),
        np.add.reduceat(turning * weight[:, None], starts, axis=0),
    )


def outer_axes(run: Run, table: Table) -> CarryingAxes:
    """Return the motion of the outer axes of a run on a table of several axes."""
    rate, span = axis_columns(run, "rate", 0.0), axis_columns(run, "angle_span", 0.0)
    return CarryingAxes(axis_angles(run)[:, :2], rate[:, :2], span[:, :2], table.links)


TEMPERATURES = ("temperature", "converter_temperature")
REFERENCE = ("reference_x", "reference_y", "reference_z")


@dataclass(frozen=True)
class RunView:
    """The nominal set-up of one run, in SI, beside its outputs; of several views of one shape with a first axis.

    Attributes
    ----------
    name, procedure, table, mounting : as in the campaign; no table if rows give directions.
    latitude, gravity : of the site.
    azimuth, elevation : of the axis of the table.
    unknown_level_rate : standard deviation of the level Earth rate about that of the azimuth, rad/s; 0 if it is
        stated.
    body_to_table : shape (3, 3).
    attitude : shape (R, 3, 3), body → local level, if rows give directions; None on a table.
    angle : shape (R,), of the table; NaN for means over whole turns.
    span : shape (R,), swept during a row.
    rate : shape (R,), of the table.
    reference : shape (R, 3), rate of a reference gyro in body axes; None without one.
    time : shape (R,); row numbers if no time was recorded.
    temperatures : name of a recorded temperature → shape (R,), °C.
    observed : shape (R, C), output units.
    samples : shape (R,).
    response : shape (C,), of each channel over that of its nominal scale factor.
    outer : the axes that carry that of the table; None if there are none.
    zero : reading of the angle of the table at its zero, from which `angle` is counted.
    axes : shape (C, 3, 3), of the channels.
    """

    name: str
    procedure: str
    table: str | None
    mounting: str | None
    latitude: float
    gravity: float
    azimuth: float
    elevation: float
    unknown_level_rate: float
    body_to_table: np.ndarray
    attitude: np.ndarray | None
    angle: np.ndarray
    span: np.ndarray
    rate: np.ndarray
    reference: np.ndarray | None
    time: np.ndarray
    temperatures: Mapping[str, np.ndarray]
    observed: np.ndarray
    samples: np.ndarray
    response: np.ndarray
    outer: CarryingAxes | None = None
    zero: float = 0.0
    axes: np.ndarray = field(default_factory=lambda: np.zeros((0, 3, 3)))

    @property
    def rows(self) -> int:
        """Number of rows."""
        return self.samples.shape[-1]

    @property
    def shape(self) -> tuple[int | bool, ...]:
        """What views have in common that can be stacked."""
        fields = self.table, self.mounting, self.attitude, self.reference
        thermometers = (name in self.temperatures for name in TEMPERATURES)
        return (self.rows, *(each is None for each in fields), *thermometers)

    def local_to_body(self, tilted: np.ndarray | None = None) -> np.ndarray:
        """Return the rotation from local level to body axes, mean over the arc of each row, shape (..., R, 3, 3).

        Parameters
        ----------
        tilted : rotation of the axis of the table from where it is said to be, shape (..., 3, 3); None for none.
        """
        if self.attitude is not None:
            stand = np.swapaxes(self.attitude, -2, -1)
            return stand if tilted is None else stand @ tilted[..., None, :, :]
        to_local = _to_local(self.azimuth, self.elevation)
        if self.outer is not None:
            stand = np.swapaxes(self.body_to_table, -2, -1) @ self.outer.turned(
                (self.angle, self.rate, self.span), to_local
            )
            return stand if tilted is None else stand @ tilted[..., None, :, :]
        level = to_local.swapaxes(-2, -1) if tilted is None else to_local.swapaxes(-2, -1) @ tilted
        known = np.isfinite(self.angle)
        angle = np.where(known, self.angle, 0.0)
        short = np.where(known, np.sinc(self.span / (2 * math.pi)), 0.0)
        cos, sin = ((short * each)[..., None] for each in (np.cos(angle), np.sin(angle)))
        x, y, z = (level[..., None, axis, :] for axis in range(3))
        # Axis of the table by axis, so that one product of matrices turns all rows.
        turned = np.stack(np.broadcast_arrays(cos * x + sin * y, cos * y - sin * x, z), axis=-3)
        held = np.swapaxes(self.body_to_table, -2, -1) @ turned.reshape(*turned.shape[:-2], -1)
        return held.reshape(*held.shape[:-1], self.rows, 3).swapaxes(-3, -2)

    def up(self) -> np.ndarray:
        """Return the force at rest in local level, m/s², shape (..., 3)."""
        return np.multiply.outer(self.gravity, [0.0, 0.0, 1.0])

    def earth_rate(self) -> np.ndarray:
        """Return the Earth rate in local level, rad/s, shape (..., 3)."""
        return _mapped(earth_rate, self.latitude)

    def rate_in_body(self, local_to_body: np.ndarray) -> np.ndarray:
        """Return the nominal angular rate in body axes, rad/s, shape (..., R, 3)."""
        if self.reference is not None:
            return self.reference
        earth = in_body(local_to_body, self.earth_rate())
        if self.outer is not None:
            return earth + self.outer.rate_of_table((self.angle, self.rate, self.span)) @ self.body_to_table
        return earth + self.rate[..., None] * self.body_to_table[..., None, 2, :]

    def repeats(self) -> np.ndarray:
        """Return whether each row but the first repeats the position of the row before it, at rest, shape (R − 1,)."""
        still = self.largest_rate() == 0
        if self.attitude is None:
            same = np.nan_to_num(np.diff(self.angle)) == 0
            same = same if self.outer is None else same & self.outer.repeats()
        else:
            same = np.all(self.attitude[1:] == self.attitude[:-1], axis=(1, 2))
        return still[1:] & still[:-1] & same

    def largest_rate(self) -> np.ndarray:
        """Return the magnitude of the rate of the table in each row, rad/s, shape (..., R)."""
        if self.reference is not None:
            return np.linalg.norm(self.reference, axis=-1)
        return np.abs(self.rate) + (0.0 if self.outer is None else np.abs(self.outer.rate).sum(axis=-1))


def in_body(local_to_body: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """Return a vector of local level, (..., 3), in body axes in each row, shape (..., R, 3)."""
    return np.einsum("...rij,...j->...ri", local_to_body, vector)


def changed(view: RunView, **changes: Any) -> RunView:
    """Return a view with other fields, as `dataclasses.replace` does in ten times the time: thousands are tried."""
    found = object.__new__(RunView)
    vars(found).update(vars(view), **changes)
    return found


def stacked(views: Sequence[RunView]) -> RunView:
    """Return views of one shape as one; what all have in common has no axis of its own."""
    found: dict[str, Any] = {}
    for each in fields(RunView):
        values = [getattr(view, each.name) for view in views]
        first = values[0]
        if each.name == "temperatures":
            found[each.name] = {name: _together([value[name] for value in values]) for name in first}
        elif isinstance(first, (np.ndarray, float)):
            found[each.name] = _together(values)
    return changed(views[0], **found)


def _together(values: Sequence[Any]) -> Any:
    return values[0] if len(set(map(id, values))) == 1 else np.stack(values)


def _mapped(function: Callable[..., np.ndarray], *values: float | np.ndarray) -> np.ndarray:
    """Return a function of scalars of one or of several views."""
    several = np.broadcast_arrays(*values)
    found = [function(*each) for each in zip(*(each.ravel().tolist() for each in several), strict=True)]
    return np.reshape(found, (*several[0].shape, *found[0].shape))


def _to_local(azimuth: float | np.ndarray, elevation: float | np.ndarray) -> np.ndarray:
    return _mapped(table_to_local, azimuth, elevation)


def views_of(campaign: Campaign) -> tuple[RunView, ...]:
    """Return the runs whose nominal input is known: those on tables and those in named directions."""
    axes = np.stack([channel.axes for channel in campaign.channels])
    return tuple(_view(campaign, run, axes) for run in campaign.runs if _is_known(campaign, run))


def _is_known(campaign: Campaign, run: Run) -> bool:
    """Whether the nominal input of a run is that of a unit on a table or in a named direction."""
    procedure = PROCEDURES[run.procedure]
    if run.table is not None and campaign.tables[run.table].inner_axis is not None:
        table = campaign.tables[run.table]
        return procedure.kinematics is serial_stimulus and not table.arm and run.mounting is not None and run.rows > 0
    if procedure.injected or procedure.driven or run.tumble is not None or not run.rows:
        return False
    if not procedure.rate_recorded and not all(name in run.covariates for name in REFERENCE):
        return False
    return run.attitude is not None if procedure.by_direction else None not in (run.table, run.mounting)


def _view(campaign: Campaign, run: Run, axes: np.ndarray) -> RunView:
    table = None if run.table is None else campaign.tables[run.table]
    recorded = run.covariates
    serial = None if table is None or table.inner_axis is None else outer_axes(run, table)
    referenced = not PROCEDURES[run.procedure].rate_recorded
    return RunView(
        name=run.name,
        procedure=run.procedure,
        table=run.table,
        mounting=run.mounting,
        latitude=campaign.site.latitude,
        gravity=campaign.site.gravity,
        azimuth=table.azimuth if table else 0.0,
        elevation=table.elevation if table else math.pi / 2,
        unknown_level_rate=_unknown_level_rate(campaign, table),
        body_to_table=np.eye(3) if run.mounting is None else campaign.mountings[run.mounting].body_to_table,
        attitude=run.attitude,
        angle=recorded["table_angle"] if serial is None else axis_angles(run)[:, -1],
        span=recorded["table_angle_span"],
        rate=recorded["table_rate"],
        reference=np.stack([recorded[name] for name in REFERENCE], axis=1) if referenced else None,
        time=recorded.get("time", np.arange(run.rows, dtype=float)),
        temperatures={name: recorded[name] for name in TEMPERATURES if name in recorded},
        observed=run.observed,
        samples=run.samples,
        response=np.ones(len(campaign.channels)),
        outer=serial,
        zero=table.zero_angle if table and serial is None else 0.0,
        axes=axes,
    )


def _unknown_level_rate(campaign: Campaign, table: Table | None) -> float:
    """Return the largest root mean square component of Ω cos L · (sin ψ, cos ψ − 1), all headings ψ being alike."""
    if table is None or table.azimuth_known:
        return 0.0
    return math.sqrt(1.5) * float(earth_rate(campaign.site.latitude)[1])


def feels_the_earth_alone(campaign: Campaign, views: Sequence[RunView]) -> bool:
    """Whether the channels are gyros on tables that stand: plausible biases conceal whatever turns the Earth rate."""
    gyros = all(channel.kind == "gyro" for channel in campaign.channels)
    return gyros and all(view.table is not None and not np.any(view.largest_rate() > 0) for view in views)


def turns_through(view: RunView) -> bool:
    """Whether the directions of a unit that turns are known, so that its outputs are modulated by the Earth rate."""
    angle = view.angle[np.isfinite(view.angle) & (view.rate != 0)]
    return len(angle) > 0 and bool(np.ptp(angle) > math.pi / 2)
