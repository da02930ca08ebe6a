"""Set-up mistakes of the equipment: what each changes in the nominal set-up of which runs.

Those of units and scale factors are in `reading_mistakes`, those of temperatures in `thermal_mistakes`, those of
whole files in `file_mistakes`; `catalogue` lists all, and `search` tries them.  A mistake is one small class, which
holds all that is known of it but for its words, in `remedies`.  `suspected` lists where in a campaign it may have
been made; `corrected` returns the view of a run as it would be without the mistake.  A mistake with a size, an angle
or a shift, has a grid of sizes, between which the best is found.  Mistakes are listed from the most to the least
usual; of those that explain the outputs equally well, the first is named.  A mistake of an `open_value` holds
whatever a record may say instead.  It rivals every named mistake of the same `record`, which is a point on it.
"""

import itertools
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from enum import Flag, auto
from typing import ClassVar

import numpy as np

from imubayes.campaign.setup_gate.setup_view import RunView, changed
from imubayes.foundations.campaign_data import Campaign
from imubayes.foundations.covariates import COVARIATES
from imubayes.foundations.wrong_records import WrongRecord

_DEGREE = math.pi / 180
RIGHT_ANGLES = math.pi / 2, -math.pi / 2, math.pi
DECISIVE = 25.0
"""Gain in twice the log evidence, less the `unlikelihood` of a mistake, for it to be named: odds of e^12 to 1 outweigh
some thousand suspected mistakes and priors of 1 in 100."""
DOUBTED = 10
"""Runs that agree least with the others, whose temperatures and files are doubted: pairs of them are tried as well."""
RIVALLED = 49.0
"""Gain per channel beyond which a mistake is said, as a warning, although other biases in a run explain the outputs as
well: a bias off by seven plausible standard deviations.  Valid campaigns gained up to 26."""


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


class Concealed(Flag):
    """If plausible errors of a poor unit conceal a mistake, so that it shows in a steady unit only."""

    NEVER = 0
    BY_INPUTS = auto()  # of other directions, levels or runs
    BY_ONE_INPUT = auto()  # the Earth rate alone, or every run turns


@dataclass(frozen=True)
class Mistake(ABC):
    """A suspected mistake in the set-up of some runs.

    `rarity` is −2 times the logarithm of how usual it is, over the most usual mistakes: its evidence has to make up for
    that.  A usual size is taken for the best one if it is within `usual_within` of it and its evidence falls short by
    less than `as_usual`.  `per_radian` is what a size counts like a radian of an angle.  `by_evidence` is whether the
    size of most evidence is the best, not that of least misfit.  The search for it ends if twice the log likelihood
    changes by less than `settled`: a hundredth is a tenth of a standard deviation of the size.

    `gross` is whether it is looked for where the outputs are beyond plausible errors.  `of_doubted_runs` is in how many
    of the runs that agree least with the others it is looked for, and there alone; 0 for all.  A size that is
    `estimated` is refined and has an uncertainty.  One below `least` is not said where plausible errors would explain
    the outputs as well.
    """

    scope: Scope
    kind: ClassVar[str]
    sizes: ClassVar[tuple[float, ...]] = ()
    usual_within: ClassVar[float] = math.inf
    as_usual: ClassVar[float] = 6.0
    open_value: ClassVar[bool] = False
    per_radian: ClassVar[float] = 1.0
    settled: ClassVar[float] = 0.01
    by_evidence: ClassVar[bool] = False
    rarity: ClassVar[float] = 0.0
    gross: ClassVar[bool] = True
    concealed: ClassVar[Concealed] = Concealed.NEVER
    of_doubted_runs: ClassVar[int] = 0
    estimated: ClassVar[bool] = False
    least: ClassVar[float] = 0.0

    @classmethod
    def suspected(cls, campaign: Campaign, views: Sequence[RunView]) -> Iterator["Mistake"]:
        """Yield the mistakes of this kind that may have been made in a campaign; by default one in each scope."""
        return (cls(scope) for scope in cls.scopes(campaign, views))

    @classmethod
    def scopes(cls, campaign: Campaign, views: Sequence[RunView]) -> Sequence[Scope]:
        """Return where the mistake may have been made."""
        return ()

    @abstractmethod
    def corrected(self, views: Sequence[RunView], place: int, size: float) -> RunView:
        """Return the view at a place as it would be without the mistake of that size."""

    def rescaled(self, view: RunView) -> float:
        """Return log |det| of the change of the outputs of a run, for their density; 0 if they only move."""
        return 0.0

    def usual(self, views: Sequence[RunView]) -> tuple[float, ...]:
        """Return the sizes that lead to what benches usually have."""
        return ()

    def possible(self, size: float) -> bool:
        """Return whether there can be a mistake of that size: what lies beyond is the work of something else."""
        return True

    def stops(self, size: float) -> bool:
        """Return whether a mistake of that size is beyond a poor unit; else it is a warning."""
        return True

    def negligible(self, campaign: Campaign, size: float, gain: float) -> bool:
        """Return whether a mistake of that size is not said if plausible errors would explain the outputs as well."""
        return abs(size) < self.least

    def bar(self, campaign: Campaign) -> float:
        """Return the support from which a concealed mistake is said."""
        return DECISIVE

    @property
    def passes_for(self) -> str:
        """What is mistaken for it in a valid set-up, in words."""
        return "a bias that changes from run to run"

    def like(self, other: "Mistake") -> bool:
        """Return whether the outputs do not distinguish another mistake, although of more evidence, from this one.

        This one is named first, unless the other is like it as well.
        """
        return False

    def rivals(self) -> Iterator["Mistake"]:
        """Yield the mistakes that look like this one, and are tried where it explains the outputs."""
        return iter(())

    def removed(self, views: Sequence[RunView], size: float) -> list[RunView]:
        """Return the runs of a campaign without the mistake."""
        found = list(views)
        for place in self.scope.runs:
            found[place] = self.corrected(views, place, size)
        return found

    def grid(self) -> tuple[float, ...]:
        """Return the sizes between which the best one is found; empty if there is none to find."""
        return self.sizes

    @property
    def record(self) -> str:
        """The recorded quantity whose value is open, or has a name; empty if no value is open."""
        return ""

    @property
    def point(self) -> float | None:
        """The size of the open value at which a named mistake is; None if its evidence alone decides."""
        return None

    def named(self, size: float) -> bool:
        """Return whether a size of an open value has a name."""
        return False

    def wrong_record(self, campaign: Campaign, size: float, sd: float) -> WrongRecord | None:
        """Return what is wrong in the record of a run, as the fit and the diagnosis say it; None of a set-up.

        Parameters
        ----------
        size, sd : of the mistake, and its standard deviation; 0 if there is none.
        """
        return None

    @property
    def variant(self) -> str:
        """What distinguishes the mistake from others of its kind and scope that are said beside it."""
        return ""

    @property
    def unlikelihood(self) -> float:
        """−2 times the logarithm of how usual the mistake is where it is suspected."""
        return self.rarity


def tables_of(views: Sequence[RunView]) -> list[Scope]:
    """Return the scope of each table."""
    names = dict.fromkeys(view.table for view in views if view.table is not None)
    return [Scope("table", name, tuple(k for k, v in enumerate(views) if v.table == name)) for name in names]


def mountings_of(views: Sequence[RunView]) -> list[Scope]:
    """Return the scope of each mounting on a table."""
    names = dict.fromkeys(view.mounting for view in views if view.mounting is not None and view.table is not None)
    return [Scope("mounting", name, tuple(k for k, v in enumerate(views) if v.mounting == name)) for name in names]


def single_runs(views: Sequence[RunView], tables_only: bool = True) -> list[Scope]:
    """Return the scope of each run; of those on tables alone."""
    return [Scope("run", v.name, (k,)) for k, v in enumerate(views) if v.table is not None or not tables_only]


def all_runs(places: Sequence[int]) -> Scope:
    """Return the scope of a mistake in the whole campaign."""
    return Scope("campaign", "", tuple(places))


def wide_first(scopes: Sequence[Scope], runs: Sequence[Scope]) -> list[Scope]:
    """Return scopes of several runs, and then the single runs that are not one of them."""
    single = {scope.runs for scope in scopes if len(scope.runs) == 1}
    return [*scopes, *(run for run in runs if run.runs not in single)]


def tables_and_runs(views: Sequence[RunView], concerned: Callable[[RunView], bool] = lambda view: True) -> list[Scope]:
    """Return the scope of each table, and then of each run on one; of those with runs that are concerned."""
    scopes = wide_first(tables_of(views), single_runs(views))
    return [scope for scope in scopes if any(concerned(views[place]) for place in scope.runs)]


def has_angles(view: RunView) -> bool:
    """Whether the angle of the table is known in some rows."""
    return bool(np.isfinite(view.angle).any()) and view.attitude is None


def turns(view: RunView) -> bool:
    """Whether the table turns in some rows."""
    return bool(np.any(view.rate))


@dataclass(frozen=True)
class FilesExchanged(Mistake):
    """The tables of two runs are exchanged; `second` is the name of the second, `other` its place."""

    second: str
    other: int
    kind: ClassVar[str] = "files_exchanged"
    concealed: ClassVar[Concealed] = Concealed.BY_ONE_INPUT

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
        return changed(
            views[place], table=source.table, mounting=source.mounting, azimuth=source.azimuth,
            elevation=source.elevation, body_to_table=source.body_to_table,
        )  # fmt: skip


@dataclass(frozen=True)
class TableSense(Mistake):
    """The table turns against the stated sense; `zero_too` is whether its zero was read in the right one."""

    zero_too: bool = False
    kind: ClassVar[str] = "table_reversed"
    concealed: ClassVar[Concealed] = Concealed.BY_ONE_INPUT

    @property
    def unlikelihood(self) -> float:
        """A table turns the same way in all runs."""
        return 6.0 if self.scope.section == "run" else 0.0

    @property
    def variant(self) -> str:
        """Whether the zero is read in the right sense."""
        return "zero" if self.zero_too else ""

    def like(self, other: Mistake) -> bool:
        """Return whether another mistake is the sign of the one channel that sees the rate in the run."""
        return other.kind == "channel_unit" and other.like(self)

    @classmethod
    def suspected(cls, campaign: Campaign, views: Sequence[RunView]) -> Iterator[Mistake]:
        """Yield every table and every run on one."""
        for scope in tables_and_runs(views):
            yield cls(scope)
            if scope.section == "table" and abs(math.sin(views[scope.runs[0]].zero)) > 0:
                yield cls(scope, True)

    def corrected(self, views: Sequence[RunView], place: int, size: float) -> RunView:
        """Return the run with rate and reading reversed."""
        view = views[place]
        angle = -view.angle if self.zero_too else -view.angle - 2 * view.zero
        return changed(view, rate=-view.rate, angle=angle, span=-view.span)


@dataclass(frozen=True)
class TableZero(Mistake):
    """The zero of the table angle is off."""

    kind: ClassVar[str] = "table_zero"
    concealed: ClassVar[Concealed] = Concealed.BY_ONE_INPUT
    estimated: ClassVar[bool] = True
    least: ClassVar[float] = 4 * _DEGREE  # a loose mounting may be turned about the axis
    usual_within: ClassVar[float] = 3.5 * _DEGREE
    sizes: ClassVar[tuple[float, ...]] = tuple(np.arange(-150, 181, 30) * _DEGREE)

    @classmethod
    def scopes(cls, campaign: Campaign, views: Sequence[RunView]) -> Sequence[Scope]:
        """Return every table and run whose angle is recorded."""
        return tables_and_runs(views, has_angles)

    def usual(self, views: Sequence[RunView]) -> tuple[float, ...]:
        """Return right angles, by which a zero is off most often; a loose mounting does not determine it exactly."""
        return RIGHT_ANGLES

    def like(self, other: Mistake) -> bool:
        """Return whether another mistake is a shift by whole rows: at equal steps it turns the angles as well."""
        return isinstance(other, TimeShift) and other.whole and other.scope.runs == self.scope.runs

    def wrong_record(self, campaign: Campaign, size: float, sd: float) -> WrongRecord | None:
        """Return the angles of a run; a table and a mounting are corrected if they are stated."""
        if self.scope.section != "run":
            return None
        run = next(run for run in campaign.runs if run.name == self.scope.name)
        recorded = float(np.nanmean(campaign.as_read(run, "table_angle"))) / _DEGREE
        return WrongRecord(
            run=run.name, form="offset", quantity=COVARIATES["table_angle"].column, unit="deg", recorded=recorded,
            agreeing=(recorded + size / _DEGREE,), sd=(sd / _DEGREE,) if sd else (),
        )  # fmt: skip

    def corrected(self, views: Sequence[RunView], place: int, size: float) -> RunView:
        """Return the run with the zero moved."""
        return changed(views[place], angle=views[place].angle + size)


@dataclass(frozen=True)
class MountingTurned(TableZero):
    """A mounting is turned about the axis of its tables."""

    kind: ClassVar[str] = "mounting_turned"
    rarity: ClassVar[float] = 8.0

    @classmethod
    def scopes(cls, campaign: Campaign, views: Sequence[RunView]) -> Sequence[Scope]:
        """Return every mounting of several runs."""
        return [scope for scope in mountings_of(views) if len(scope.runs) > 1]


@dataclass(frozen=True)
class TableElevation(Mistake):
    """The elevation of the axis of a table is wrong."""

    kind: ClassVar[str] = "table_elevation"
    concealed: ClassVar[Concealed] = Concealed.BY_INPUTS | Concealed.BY_ONE_INPUT
    estimated: ClassVar[bool] = True
    least: ClassVar[float] = 2 * _DEGREE  # smaller ones pass for errors that the linear model leaves out
    rarity: ClassVar[float] = 2.0
    sizes: ClassVar[tuple[float, ...]] = tuple(np.arange(-180, 180, 30) * _DEGREE)

    @property
    def unlikelihood(self) -> float:
        """A table is not tilted for one run."""
        return 25.0 if self.scope.section == "run" else self.rarity

    @classmethod
    def scopes(cls, campaign: Campaign, views: Sequence[RunView]) -> Sequence[Scope]:
        """Return every table, and every run on one."""
        return tables_and_runs(views)

    def usual(self, views: Sequence[RunView]) -> tuple[float, ...]:
        """Return the sizes to a horizontal, a vertical and the polar axis."""
        view = views[self.scope.runs[0]]
        return tuple(angle - view.elevation for angle in (0.0, math.pi / 2, -math.pi / 2, view.latitude))

    def corrected(self, views: Sequence[RunView], place: int, size: float) -> RunView:
        """Return the run with the axis raised."""
        return changed(views[place], elevation=views[place].elevation + size)


@dataclass(frozen=True)
class TableAzimuth(Mistake):
    """The azimuth of the axis of a table is wrong."""

    kind: ClassVar[str] = "table_azimuth"
    concealed: ClassVar[Concealed] = Concealed.BY_INPUTS | Concealed.BY_ONE_INPUT
    estimated: ClassVar[bool] = True
    least: ClassVar[float] = 25 * _DEGREE  # the Earth rate of a tactical gyro determines no less
    rarity: ClassVar[float] = 4.0
    # The g-sensitivity of a poor gyro moves the best azimuth by three standard deviations.
    as_usual: ClassVar[float] = 12.0
    by_evidence: ClassVar[bool] = True
    sizes: ClassVar[tuple[float, ...]] = tuple(np.arange(-150, 181, 30) * _DEGREE)

    @classmethod
    def scopes(cls, campaign: Campaign, views: Sequence[RunView]) -> Sequence[Scope]:
        """Return every table of a stated azimuth, if there are gyros."""
        known = (each for each in tables_of(views) if campaign.tables[each.name].azimuth_known)
        return tuple(known) if campaign.of_kind("gyro") else ()

    def usual(self, views: Sequence[RunView]) -> tuple[float, ...]:
        """Return the sizes to North, East, South and West."""
        return tuple(angle * _DEGREE - views[self.scope.runs[0]].azimuth for angle in (0.0, 90.0, 180.0, 270.0))

    def corrected(self, views: Sequence[RunView], place: int, size: float) -> RunView:
        """Return the run with the axis turned."""
        return changed(views[place], azimuth=views[place].azimuth + size)


def _is_static(view: RunView) -> bool:
    """Whether no stimulus is between those of two rows: at rest, or on several axes."""
    return view.outer is not None or not (np.any(view.span) or view.reference is not None or np.any(view.rate))


@dataclass(frozen=True)
class TimeShift(Mistake):
    """The outputs are shifted against the columns of the table, by a size in rows; positive if they lag.

    The shift is `whole` between static rows, between which there is no stimulus to interpolate.
    """

    whole: bool
    kind: ClassVar[str] = "time_shift"
    concealed: ClassVar[Concealed] = Concealed.BY_ONE_INPUT
    sizes: ClassVar[tuple[float, ...]] = tuple(np.concatenate([np.arange(-3, 3.1, 0.5), [-5.0, -4.0, 4.0, 5.0]]))

    @classmethod
    def suspected(cls, campaign: Campaign, views: Sequence[RunView]) -> Iterator[Mistake]:
        """Yield every run in which the stimulus varies, and all of them."""
        varying = [k for k, v in enumerate(views) if v.rows > 4 and (np.ptp(v.rate) or np.ptp(v.angle) > 0)]
        if len(varying) > 1:
            yield cls(Scope("campaign", "", tuple(varying)), all(_is_static(views[k]) for k in varying))
        for k in varying:
            yield cls(Scope("run", views[k].name, (k,)), _is_static(views[k]))

    def possible(self, size: float) -> bool:
        """Return whether there is a shift at all: it is reported to half a row, and to a row between static rows."""
        return abs(size) >= (0.5 if self.whole else 0.25)

    def corrected(self, views: Sequence[RunView], place: int, size: float) -> RunView:
        """Return the run with the stimulus of earlier rows; rows that have none are left out."""
        view = views[place]
        size = round(size) if _is_static(view) else size
        row = np.arange(view.rows) - size
        before = np.clip(np.floor(row).astype(int), 0, view.rows - 1)
        after, part = np.minimum(before + 1, view.rows - 1), -size % 1
        outside = (row < 0) | (row > view.rows - 1)

        def at(values: np.ndarray) -> np.ndarray:
            return values[before] * (1 - part) + values[after] * part if part else values[before]

        turned = view.angle[before]
        if part:
            turned = turned + part * np.angle(np.exp(1j * (view.angle[after] - turned)))
        return changed(
            view,
            rate=at(view.rate),
            angle=turned,
            span=at(view.span),
            reference=None if view.reference is None else at(view.reference),
            attitude=None if view.attitude is None else view.attitude[before],
            outer=None if view.outer is None else view.outer.at(before),
            observed=np.where(outside[:, None], np.nan, view.observed),
        )
