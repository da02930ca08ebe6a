"""The registry of set-up mistakes: what each changes in the nominal set-up of which runs.

A mistake is one small class.  `suspected` lists where in a campaign it may have been made; `corrected` returns the view
of a run as it would be without the mistake.  A mistake with a size, an angle or a shift, has a grid of sizes, between
which the best is found.  Mistakes are listed from the most to the least usual; of those that explain the outputs
equally well, the first is named.
"""

import itertools
import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from imubayes.campaign.setup_gate.run_view import RunView
from imubayes.campaign_data import Campaign, Channel

_DEGREE = math.pi / 180
RATE_UNITS = {
    "rpm": 6.0, "rev/s": 360.0, "rad/s": 1 / _DEGREE, "deg/min": 1 / 60, "deg/h": 1 / 3600, "mdeg/s": 1e-3,
    "rad/h": 1 / _DEGREE / 3600,
}  # fmt: skip
"""Units of rate in deg/s."""
ANGLE_UNITS = {
    "rad": 1 / _DEGREE, "gon": 0.9, "turns": 360.0, "arcmin": 1 / 60, "arcsec": 1 / 3600, "mrad": 1e-3 / _DEGREE,
}  # fmt: skip
"""Units of angle in degrees."""
_GAINS = {
    "gyro": {
        "rad/s for deg/s": 1 / _DEGREE, "deg/s for rad/s": _DEGREE, "deg/h for deg/s": 3600.0,
        "deg/s for deg/h": 1 / 3600, "deg/h for rad/s": 3600.0 * _DEGREE, "rpm for deg/s": 1 / 6, "deg/s for rpm": 6.0,
        "mdeg/s for deg/s": 1000.0, "deg/s for mdeg/s": 1e-3,
    },
    "accelerometer": {
        "m/s² for g": 9.80665, "g for m/s²": 1 / 9.80665, "mg for g": 1000.0, "g for mg": 1e-3,
        "ft/s² for g": 32.174, "mg for m/s²": 1000 / 9.80665, "cm/s² for m/s²": 100.0,
    },
}  # fmt: skip
"""Mistaken units of an output, and the factor by which it is too large."""


@dataclass(frozen=True)
class Scope:
    """Where a mistake is suspected.

    Attributes
    ----------
    section : ``table``, ``mounting`` or ``channel`` of the campaign, ``run``, or ``campaign`` for all of it.
    name : of that member.
    runs : places of the views concerned.
    """

    section: str
    name: str
    runs: tuple[int, ...]


@dataclass(frozen=True)
class Mistake(ABC):
    """A suspected mistake in the set-up of some runs."""

    scope: Scope
    kind: ClassVar[str]
    sizes: ClassVar[tuple[float, ...]] = ()

    @classmethod
    @abstractmethod
    def suspected(cls, campaign: Campaign, views: Sequence[RunView]) -> Iterator["Mistake"]:
        """Yield the mistakes of this kind that may have been made in a campaign."""

    @abstractmethod
    def corrected(self, views: Sequence[RunView], place: int, size: float) -> RunView:
        """Return the view at a place as it would be without the mistake of that size."""

    def rescaled(self, view: RunView) -> float:
        """Return log |det| of the change of the outputs of a run, for their density; 0 where they only move."""
        return 0.0


MISTAKES: list[type[Mistake]] = []
"""Every kind of mistake, from the most to the least usual."""


def register[Kind: type[Mistake]](kind: Kind) -> Kind:
    """Add a kind of mistake to the registry."""
    MISTAKES.append(kind)
    return kind


def _tables(views: Sequence[RunView]) -> list[Scope]:
    names = dict.fromkeys(view.table for view in views if view.table is not None)
    return [Scope("table", name, tuple(k for k, v in enumerate(views) if v.table == name)) for name in names]


def _mountings(views: Sequence[RunView]) -> list[Scope]:
    names = dict.fromkeys(view.mounting for view in views if view.mounting is not None and view.table is not None)
    return [Scope("mounting", name, tuple(k for k, v in enumerate(views) if v.mounting == name)) for name in names]


def _runs(views: Sequence[RunView], tables_only: bool = True) -> list[Scope]:
    return [Scope("run", v.name, (k,)) for k, v in enumerate(views) if v.table is not None or not tables_only]


def _whole(views: Sequence[RunView]) -> Scope:
    return Scope("campaign", "", tuple(range(len(views))))


def _wide_first(scopes: Sequence[Scope], runs: Sequence[Scope]) -> list[Scope]:
    """Return scopes of several runs, and then the single runs that are not one of them."""
    single = {scope.runs for scope in scopes if len(scope.runs) == 1}
    return [*scopes, *(run for run in runs if run.runs not in single)]


def _still(view: RunView) -> bool:
    """Whether the angle of the table is known in some rows."""
    return bool(np.isfinite(view.angle).any()) and view.attitude is None


@register
@dataclass(frozen=True)
class LatitudeSign(Mistake):
    """The latitude has the wrong sign."""

    kind: ClassVar[str] = "latitude_sign"

    @classmethod
    def suspected(cls, campaign: Campaign, views: Sequence[RunView]) -> Iterator[Mistake]:
        """Yield the one mistake, where there are gyros."""
        if any(channel.kind == "gyro" for channel in campaign.channels) and campaign.site.latitude:
            yield cls(_whole(views))

    def corrected(self, views: Sequence[RunView], place: int, size: float) -> RunView:
        """Return the view on the other hemisphere."""
        return replace(views[place], latitude=-views[place].latitude)


@register
@dataclass(frozen=True)
class FilesExchanged(Mistake):
    """The tables of two runs are exchanged; `second` is the name of the second, `other` its place."""

    second: str
    other: int
    kind: ClassVar[str] = "files_exchanged"

    @classmethod
    def suspected(cls, campaign: Campaign, views: Sequence[RunView]) -> Iterator[Mistake]:
        """Yield every pair of runs that differ in table or mounting."""
        for first, second in itertools.combinations(range(len(views)), 2):
            a, b = views[first], views[second]
            differ = (a.table, a.mounting) != (b.table, b.mounting)
            if differ and a.table is not None and b.table is not None:
                yield cls(Scope("run", a.name, (first, second)), b.name, second)

    def corrected(self, views: Sequence[RunView], place: int, size: float) -> RunView:
        """Return the run on the table and in the mounting of the other."""
        source = views[self.scope.runs[0] if place == self.other else self.other]
        return replace(
            views[place], table=source.table, mounting=source.mounting, azimuth=source.azimuth,
            elevation=source.elevation, body_to_table=source.body_to_table,
        )  # fmt: skip


@register
@dataclass(frozen=True)
class MountingMislabelled(Mistake):
    """A run was made in `actual`, another mounting of the campaign."""

    actual: str
    matrix: np.ndarray
    kind: ClassVar[str] = "mounting_mislabelled"

    @classmethod
    def suspected(cls, campaign: Campaign, views: Sequence[RunView]) -> Iterator[Mistake]:
        """Yield every other mounting of every run, and of all runs of a mounting."""
        for scope in _wide_first(_mountings(views), _runs(views)):
            for name, mounting in campaign.mountings.items():
                if name != views[scope.runs[0]].mounting:
                    yield cls(scope, name, mounting.body_to_table)

    def corrected(self, views: Sequence[RunView], place: int, size: float) -> RunView:
        """Return the run in its actual mounting."""
        return replace(views[place], mounting=self.actual, body_to_table=self.matrix)


@register
@dataclass(frozen=True)
class TableSense(Mistake):
    """The table turns against the stated sense."""

    kind: ClassVar[str] = "table_reversed"

    @classmethod
    def suspected(cls, campaign: Campaign, views: Sequence[RunView]) -> Iterator[Mistake]:
        """Yield every table and every run on one."""
        for scope in _wide_first(_tables(views), _runs(views)):
            yield cls(scope)

    def corrected(self, views: Sequence[RunView], place: int, size: float) -> RunView:
        """Return the run with rate and angle reversed."""
        view = views[place]
        return replace(view, rate=-view.rate, angle=-view.angle, span=-view.span)


@register
@dataclass(frozen=True)
class TableZero(Mistake):
    """The zero of the table angle is off."""

    kind: ClassVar[str] = "table_zero"
    sizes: ClassVar[tuple[float, ...]] = tuple(np.arange(-150, 181, 30) * _DEGREE)

    @classmethod
    def suspected(cls, campaign: Campaign, views: Sequence[RunView]) -> Iterator[Mistake]:
        """Yield every table and run whose angle is recorded."""
        tables = [scope for scope in _tables(views) if any(_still(views[k]) for k in scope.runs)]
        for scope in _wide_first(tables, [run for run in _runs(views) if _still(views[run.runs[0]])]):
            yield cls(scope)

    def corrected(self, views: Sequence[RunView], place: int, size: float) -> RunView:
        """Return the run with the zero moved."""
        return replace(views[place], angle=views[place].angle + size)


@register
@dataclass(frozen=True)
class MountingTurned(TableZero):
    """A mounting is turned about the axis of its tables."""

    kind: ClassVar[str] = "mounting_turned"

    @classmethod
    def suspected(cls, campaign: Campaign, views: Sequence[RunView]) -> Iterator[Mistake]:
        """Yield every mounting of several runs."""
        for scope in _mountings(views):
            if len(scope.runs) > 1:
                yield cls(scope)


@register
@dataclass(frozen=True)
class TableElevation(Mistake):
    """The elevation of the axis of a table is wrong."""

    kind: ClassVar[str] = "table_elevation"
    sizes: ClassVar[tuple[float, ...]] = tuple(np.arange(-180, 180, 30) * _DEGREE)

    @classmethod
    def suspected(cls, campaign: Campaign, views: Sequence[RunView]) -> Iterator[Mistake]:
        """Yield every table, and every run on one."""
        for scope in _wide_first(_tables(views), _runs(views)):
            yield cls(scope)

    def corrected(self, views: Sequence[RunView], place: int, size: float) -> RunView:
        """Return the run with the axis raised."""
        return replace(views[place], elevation=views[place].elevation + size)


@register
@dataclass(frozen=True)
class TableAzimuth(Mistake):
    """The azimuth of the axis of a table is wrong."""

    kind: ClassVar[str] = "table_azimuth"
    sizes: ClassVar[tuple[float, ...]] = tuple(np.arange(-150, 181, 30) * _DEGREE)

    @classmethod
    def suspected(cls, campaign: Campaign, views: Sequence[RunView]) -> Iterator[Mistake]:
        """Yield every table, where there are gyros."""
        if any(channel.kind == "gyro" for channel in campaign.channels):
            for scope in _tables(views):
                yield cls(scope)

    def corrected(self, views: Sequence[RunView], place: int, size: float) -> RunView:
        """Return the run with the axis turned."""
        return replace(views[place], azimuth=views[place].azimuth + size)


@register
@dataclass(frozen=True)
class ChannelsExchanged(Mistake):
    """Channels of one kind are exchanged: channel `order[i]` is in the column of channel `places[i]`."""

    places: tuple[int, ...]
    order: tuple[int, ...]
    kind: ClassVar[str] = "axes_exchanged"

    @classmethod
    def suspected(cls, campaign: Campaign, views: Sequence[RunView]) -> Iterator[Mistake]:
        """Yield every pair and, of three channels, both cycles; in all runs or one."""
        for kind in ("gyro", "accelerometer"):
            places = [k for k, channel in enumerate(campaign.channels) if channel.kind == kind]
            orders = [((a, b), (b, a)) for a, b in itertools.combinations(places, 2)]
            orders += [((a, b, c), turned) for a, b, c in itertools.combinations(places, 3)
                       for turned in ((b, c, a), (c, a, b))]  # fmt: skip
            for scope, (before, after) in itertools.product([_whole(views), *_runs(views, False)], orders):
                yield cls(scope, before, after)

    def corrected(self, views: Sequence[RunView], place: int, size: float) -> RunView:
        """Return the run with the columns in order."""
        observed = views[place].observed.copy()
        observed[:, list(self.order)] = views[place].observed[:, list(self.places)]
        return replace(views[place], observed=observed)


_LEAST_INPUT = {"gyro": 0.5 * _DEGREE, "accelerometer": 0.5}  # rad/s and m/s²


def _driven(channel: Channel, views: Sequence[RunView]) -> bool:
    """Whether a channel has an input from which its scale factor shows.

    Without one a large factor would only make the errors of the channel small.
    """
    for view in views:
        stand = view.local_to_body()
        felt = view.rate_in_body(stand) if channel.kind == "gyro" else stand[:, :, 2] * view.gravity
        if np.abs(felt @ channel.axes[0]).max() > _LEAST_INPUT[channel.kind]:
            return True
    return False


@register
@dataclass(frozen=True)
class ChannelGain(Mistake):
    """Channels respond with a factor: another sign, or another unit (`units`)."""

    channels: tuple[str, ...]
    places: tuple[int, ...]
    offsets: tuple[float, ...]
    factor: float
    units: str
    kind: ClassVar[str] = "channel_unit"

    @classmethod
    def suspected(cls, campaign: Campaign, views: Sequence[RunView]) -> Iterator[Mistake]:
        """Yield every channel and all of a kind, in all runs or one."""
        for kind, gains in _GAINS.items():
            places = [k for k, channel in enumerate(campaign.channels) if channel.kind == kind]
            groups = [(k,) for k in places] + ([tuple(places)] if len(places) > 1 else [])
            factors = {"": -1.0} | gains
            for scope, group in itertools.product([_whole(views), *_runs(views, False)], groups):
                channels = [campaign.channels[k] for k in group]
                if not all(_driven(channel, [views[k] for k in scope.runs]) for channel in channels):
                    continue
                names, offsets = tuple(c.name for c in channels), tuple(c.offset for c in channels)
                for units, factor in factors.items():
                    yield cls(scope, names, group, offsets, factor, units)

    def corrected(self, views: Sequence[RunView], place: int, size: float) -> RunView:
        """Return the run with the outputs divided by the factor."""
        observed, at = views[place].observed.copy(), list(self.places)
        observed[:, at] = self.offsets + (observed[:, at] - self.offsets) / self.factor
        return replace(views[place], observed=observed)

    def rescaled(self, view: RunView) -> float:
        """Return the number of outputs divided by the factor, times its logarithm."""
        return float(np.isfinite(view.observed[:, list(self.places)]).sum() * np.log(abs(self.factor)))


@register
@dataclass(frozen=True)
class RateUnit(Mistake):
    """The rate column is in another unit."""

    unit: str
    kind: ClassVar[str] = "rate_unit"

    @classmethod
    def suspected(cls, campaign: Campaign, views: Sequence[RunView]) -> Iterator[Mistake]:
        """Yield every unit for every table and run that turns."""
        turning = [scope for scope in _tables(views) if any(np.any(views[k].rate) for k in scope.runs)]
        runs = [scope for scope in _runs(views) if np.any(views[scope.runs[0]].rate)]
        for scope, unit in itertools.product(_wide_first(turning, runs), RATE_UNITS):
            yield cls(scope, unit)

    def corrected(self, views: Sequence[RunView], place: int, size: float) -> RunView:
        """Return the run with the rate converted."""
        return replace(views[place], rate=views[place].rate * RATE_UNITS[self.unit])


@register
@dataclass(frozen=True)
class AngleUnit(Mistake):
    """The angle column is in another unit."""

    unit: str
    kind: ClassVar[str] = "angle_unit"

    @classmethod
    def suspected(cls, campaign: Campaign, views: Sequence[RunView]) -> Iterator[Mistake]:
        """Yield every unit for every table and run at several angles."""
        several = [k for k, view in enumerate(views) if _still(view) and np.nanmax(np.abs(view.angle)) > 0]
        tables = [scope for scope in _tables(views) if set(scope.runs) & set(several)]
        runs = [scope for scope in _runs(views) if scope.runs[0] in several]
        for scope, unit in itertools.product(_wide_first(tables, runs), ANGLE_UNITS):
            yield cls(scope, unit)

    def corrected(self, views: Sequence[RunView], place: int, size: float) -> RunView:
        """Return the run with the angles converted."""
        factor = ANGLE_UNITS[self.unit]
        return replace(views[place], angle=views[place].angle * factor, span=views[place].span * factor)


@register
@dataclass(frozen=True)
class TimeShift(Mistake):
    """The outputs are shifted against the columns of the table, by a size in rows; positive where they lag."""

    kind: ClassVar[str] = "time_shift"
    sizes: ClassVar[tuple[float, ...]] = tuple(np.concatenate([np.arange(-3, 3.1, 0.5), [-5.0, -4.0, 4.0, 5.0]]))

    @classmethod
    def suspected(cls, campaign: Campaign, views: Sequence[RunView]) -> Iterator[Mistake]:
        """Yield every run in which the stimulus varies, and all of them."""
        varying = [k for k, v in enumerate(views) if v.rows > 4 and (np.ptp(v.rate) or np.ptp(v.angle) > 0)]
        if len(varying) > 1:
            yield cls(Scope("campaign", "", tuple(varying)))
        for k in varying:
            yield cls(Scope("run", views[k].name, (k,)))

    def corrected(self, views: Sequence[RunView], place: int, size: float) -> RunView:
        """Return the run with the stimulus of earlier rows; rows that have none are left out."""
        view = views[place]
        # Between static rows there is no stimulus to interpolate.
        size = size if np.any(view.span) or view.reference is not None or np.any(view.rate) else round(size)
        row = np.arange(view.rows) - size
        before = np.clip(np.floor(row).astype(int), 0, view.rows - 1)
        after = np.clip(before + 1, 0, view.rows - 1)
        part = row - before
        outside = (row < 0) | (row > view.rows - 1)

        def at(values: np.ndarray) -> np.ndarray:
            weight = part.reshape(-1, *[1] * (values.ndim - 1))
            mixed = values[before] * (1 - weight) + values[after] * weight
            return np.where(part.reshape(weight.shape) == 0, values[before], mixed)

        turned = view.angle[before] + part * np.angle(np.exp(1j * (view.angle[after] - view.angle[before])))
        return replace(
            view,
            rate=at(view.rate),
            angle=np.where(part == 0, view.angle[before], turned),
            span=at(view.span),
            reference=None if view.reference is None else at(view.reference),
            attitude=None if view.attitude is None else view.attitude[before],
            observed=np.where(outside[:, None], np.nan, view.observed),
        )


@register
@dataclass(frozen=True)
class MountingWrong(Mistake):
    """The matrix of a mounting is wrong: transposed, or another of the 24 orientations of the unit."""

    matrix: np.ndarray
    transposed: bool
    kind: ClassVar[str] = "mounting_wrong"

    @classmethod
    def suspected(cls, campaign: Campaign, views: Sequence[RunView]) -> Iterator[Mistake]:
        """Yield the transpose and the other orientations for every mounting and every run."""
        for scope in _wide_first(_mountings(views), _runs(views)):
            matrix = views[scope.runs[0]].body_to_table
            if not np.allclose(matrix, matrix.T, atol=1e-6):
                yield cls(scope, matrix.T, True)
            for turn in ORIENTATIONS[1:]:
                yield cls(scope, turn @ matrix, False)

    def corrected(self, views: Sequence[RunView], place: int, size: float) -> RunView:
        """Return the run in the other orientation."""
        return replace(views[place], body_to_table=self.matrix)


def _orientations() -> list[np.ndarray]:
    found = []
    for order, signs in itertools.product(itertools.permutations(range(3)), itertools.product((1.0, -1.0), repeat=3)):
        matrix = np.eye(3)[list(order)] * np.array(signs)[:, None]
        if np.linalg.det(matrix) > 0:
            found.append(matrix)
    return found


ORIENTATIONS = _orientations()
"""The 24 rotations that map the axes of a cube onto each other, the identity first."""
