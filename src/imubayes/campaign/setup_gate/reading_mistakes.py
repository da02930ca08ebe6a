"""Set-up mistakes in units, signs, scale factors, table rates and the latitude.

Units and signs may be wrong for channels and for the columns of rate and angle.  A wrong latitude shows where gyros
feel the Earth turn.

Nominal scale factors, and rates of a table, may be wrong by a factor that is no unit's.  An input that is too small
everywhere is imitated by a response that is: the accelerometer on an axis raised to 60° reads half of what it would on
a horizontal one, as one of half the nominal scale factor does.  The errors of the outputs stay as large as they are, so
that a smaller scale factor gains nothing over another input but what the outputs determine.
"""

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from imubayes.campaign.setup_gate.equipment_mistakes import (
    DECISIVE,
    RIVALLED,
    Concealed,
    Mistake,
    Scope,
    TableSense,
    all_runs,
    has_angles,
    single_runs,
    tables_and_runs,
    tables_of,
    turns,
)
from imubayes.campaign.setup_gate.setup_view import RunView, changed, feels_the_earth_alone, turns_through
from imubayes.foundations.campaign_data import Campaign, Channel
from imubayes.foundations.covariates import COVARIATES
from imubayes.foundations.wrong_records import (
    ANGLE_UNITS,
    GAINS,
    NAMED_SCALE,
    OPEN,
    OPEN_SCALE,
    RATE_UNITS,
    SCALE_OF_KIND,
    WrongRecord,
)

_DEGREE = math.pi / 180


def _feels_the_earth(campaign: Campaign, views: Sequence[RunView]) -> bool:
    return bool(campaign.of_kind("gyro")) and any(view.reference is None for view in views)


DECISIVE_LATITUDE = 8.0
"""Support from which the sign of the latitude is named if several gyros show it: a single suspected mistake.  Up to
`DECISIVE` it is a warning."""
LEAST_LATITUDE = math.radians(15.0)


@dataclass(frozen=True)
class LatitudeSign(Mistake):
    """The latitude has the wrong sign."""

    kind: ClassVar[str] = "latitude_sign"
    gross: ClassVar[bool] = False
    concealed: ClassVar[Concealed] = Concealed.BY_INPUTS | Concealed.BY_ONE_INPUT

    @classmethod
    def scopes(cls, campaign: Campaign, views: Sequence[RunView]) -> Sequence[Scope]:
        """Return the whole campaign, if there are gyros."""
        return [all_runs(range(len(views)))] if _feels_the_earth(campaign, views) and campaign.site.latitude else []

    def corrected(self, views: Sequence[RunView], place: int, size: float) -> RunView:
        """Return the view on the other hemisphere."""
        return changed(views[place], latitude=-views[place].latitude)

    def bar(self, campaign: Campaign) -> float:
        """Return less than usual if several gyros show it."""
        return DECISIVE_LATITUDE if len(campaign.of_kind("gyro")) > 1 else DECISIVE


@dataclass(frozen=True)
class LatitudeValue(Mistake):
    """The latitude is another one; its size is the true latitude, rad."""

    north: bool
    kind: ClassVar[str] = "latitude_value"
    gross: ClassVar[bool] = False
    concealed: ClassVar[Concealed] = Concealed.BY_INPUTS | Concealed.BY_ONE_INPUT
    estimated: ClassVar[bool] = True
    rarity: ClassVar[float] = 15.0
    sizes: ClassVar[tuple[float, ...]] = tuple(np.arange(-90, 91, 15) * _DEGREE)

    @property
    def variant(self) -> str:
        """The hemisphere: a gyro that turns about the vertical does not determine it."""
        return "north" if self.north else "south"

    @classmethod
    def suspected(cls, campaign: Campaign, views: Sequence[RunView]) -> Iterator[Mistake]:
        """Yield both hemispheres if gyros turned or sat in several mountings: else biases pass for Earth rate."""
        turned = feels_the_earth_alone(campaign, views) or any(turns_through(view) for view in views)
        if _feels_the_earth(campaign, views) and (turned or len({view.mounting for view in views}) > 2):
            for north in (True, False):
                yield cls(all_runs(range(len(views))), north)

    def corrected(self, views: Sequence[RunView], place: int, size: float) -> RunView:
        """Return the view at another latitude of the hemisphere."""
        low, high = (0.0, math.pi / 2) if self.north else (-math.pi / 2, 0.0)
        return changed(views[place], latitude=float(np.clip(size, low, high)))

    def possible(self, size: float) -> bool:
        """Return whether the latitude exists: outputs beyond the poles show more than the Earth rate."""
        return abs(size) <= math.pi / 2

    def negligible(self, campaign: Campaign, size: float, gain: float) -> bool:
        """Return whether it is near the stated one, and not by far better.

        What a linear model leaves out moved a valid one by 9 degrees.
        """
        near = abs(size - campaign.site.latitude) < LEAST_LATITUDE
        return near and gain < RIVALLED * len(campaign.channels)


_LOGARITHMS = tuple(np.arange(-3.0, 2.6, 0.25).tolist())  # factors of 0.05 to 12
ORDINARY_SCALE = 0.1
"""Deviation from the nominal scale factor up to which it may be that of a poor unit rather than a mistake."""

_LEAST_CHANGE = 5 * _DEGREE / 3600  # rad/s, a third of the Earth rate
_LEAST_INPUT = {"gyro": 0.5 * _DEGREE, "accelerometer": 0.5}  # rad/s and m/s²


def driven(campaign: Campaign, channel: Channel, views: Sequence[RunView]) -> bool:
    """Whether a channel has an input from which its scale factor shows.

    Without one a large factor would only make the errors of the channel small.  If all feel the Earth rate alone,
    that is the input, if it changes: a constant one is no other than a bias.
    """
    felt = []
    for view in views:
        stand = view.local_to_body()
        inputs = view.rate_in_body(stand) if channel.kind == "gyro" else stand[:, :, 2] * view.gravity
        felt.append(inputs @ channel.axes[0])
    along = np.concatenate(felt)
    if feels_the_earth_alone(campaign, views):
        return bool(np.ptp(along) > _LEAST_CHANGE)
    return bool(np.abs(along).max(initial=0.0) > _LEAST_INPUT[channel.kind])


def _groups(
    campaign: Campaign, kind: str, concerned: Callable[[Channel], bool] = lambda channel: True
) -> list[tuple[int, ...]]:
    """Return the place of each channel of a kind that is concerned, those of all that are, and those of the kind.

    A channel without input shows the unit of its bias.
    """
    every = [k for k, channel in enumerate(campaign.channels) if channel.kind == kind]
    places = [k for k in every if concerned(campaign.channels[k])]
    together = dict.fromkeys([tuple(places), tuple(every)]) if places else {}
    return [*((k,) for k in places), *(each for each in together if len(each) > 1)]


def scale_of(channels: Sequence[str]) -> str:
    """Return what the scale factor of channels is called as a record."""
    return f"scale of {', '.join(channels)}"


def output_factor(
    campaign: Campaign, scope: Scope, places: Sequence[int], factor: float, sd: float, about: float | None = None
) -> WrongRecord | None:
    """Return that the outputs of one channel in a run agree times a factor; None of other scopes.

    Parameters
    ----------
    about : what the factor leaves as it is, output units; None is the offset of the channel.
    """
    if scope.section != "run" or len(places) != 1:
        return None
    channel = campaign.channels[places[0]]
    return WrongRecord(
        run=scope.name, form="output_factor", quantity=channel.name, unit="1", recorded=1.0, agreeing=(factor,),
        sd=(sd,) if sd else (), kind=channel.kind, about=channel.offset if about is None else about,
    )  # fmt: skip


def rate_factor(scope: Scope, factor: float, sd: float, covariate: str = "table_rate") -> WrongRecord | None:
    """Return that rates of a run, of its table or its reference gyro, agree times a factor; None of other scopes."""
    if scope.section != "run":
        return None
    return WrongRecord(
        run=scope.name, form="factor", quantity=COVARIATES[covariate].column, unit="1", recorded=1.0,
        agreeing=(factor,), sd=(sd,) if sd else (),
    )  # fmt: skip


@dataclass(frozen=True)
class _Factor(Mistake):
    rarity: ClassVar[float] = OPEN
    sizes: ClassVar[tuple[float, ...]] = _LOGARITHMS
    usual_within: ClassVar[float] = 0.1
    open_value: ClassVar[bool] = True

    def possible(self, size: float) -> bool:
        """Return whether the factor is within the range of those tried: at its end there is no estimate."""
        return _LOGARITHMS[0] < size < _LOGARITHMS[-1]

    def stops(self, size: float) -> bool:
        """Return whether the factor is beyond that of a poor unit."""
        return abs(math.expm1(size)) > ORDINARY_SCALE


@dataclass(frozen=True)
class NominalScale(_Factor):
    """The scale factor of channels is the nominal one times a factor, in all runs or one; the size is its logarithm."""

    channels: tuple[str, ...]
    places: tuple[int, ...]
    of_gyros: bool
    kind: ClassVar[str] = "channel_unit"
    concealed: ClassVar[Concealed] = Concealed.BY_ONE_INPUT

    @property
    def unlikelihood(self) -> float:
        """A scale factor is that of all runs."""
        return self.rarity if self.scope.section == "campaign" else OPEN_SCALE

    def negligible(self, campaign: Campaign, size: float, gain: float) -> bool:
        """Return whether a poor unit may have that scale factor."""
        return not self.stops(size)

    @property
    def record(self) -> str:
        """The scale factor of these channels."""
        return scale_of(self.channels)

    def units(self, size: float) -> str:
        """Return the mistaken unit of the outputs, if the factor is that of one."""
        return next((name for name, factor in self._gains.items() if math.log(factor) == size), "")

    def named(self, size: float) -> bool:
        """Return whether the factor is that of a mistaken unit."""
        return bool(self.units(size))

    @property
    def _gains(self) -> dict[str, float]:
        return GAINS["gyro" if self.of_gyros else "accelerometer"]

    def usual(self, views: Sequence[RunView]) -> tuple[float, ...]:
        """Return the factors of mistaken units."""
        return tuple(math.log(factor) for factor in self._gains.values())

    @classmethod
    def suspected(cls, campaign: Campaign, views: Sequence[RunView]) -> Iterator[Mistake]:
        """Yield every channel that has an input, and all of a kind, in all runs or one."""
        single = [] if feels_the_earth_alone(campaign, views) or len(views) < 3 else single_runs(views, False)
        for scope, kind in itertools.product((all_runs(range(len(views))), *single), ("gyro", "accelerometer")):
            here = [views[place] for place in scope.runs]
            for group in _groups(campaign, kind, lambda channel, here=here: driven(campaign, channel, here)):
                names = tuple(campaign.channels[k].name for k in group)
                yield cls(scope, names, group, kind == "gyro")

    def like(self, other: Mistake) -> bool:
        """Return whether another mistake is a factor of the rates that makes the same of the same gyros."""
        alone = len(self.places) == 1 and other.kind == "table_rate" and other.scope == self.scope
        return self.of_gyros and (alone or isinstance(other, TableRates))

    def wrong_record(self, campaign: Campaign, size: float, sd: float) -> WrongRecord | None:
        """Return the factor on the outputs of one channel in a run."""
        return output_factor(campaign, self.scope, self.places, math.exp(-size), sd * math.exp(-size))

    def corrected(self, views: Sequence[RunView], place: int, size: float) -> RunView:
        """Return the run with the response of the channels."""
        response = np.array(views[place].response)
        response[list(self.places)] *= math.exp(size)
        return changed(views[place], response=response)


@dataclass(frozen=True)
class TableRates(_Factor):
    """The rates of a table are the recorded ones times a factor; the size is its logarithm."""

    kind: ClassVar[str] = "rate_unit"

    @classmethod
    def scopes(cls, campaign: Campaign, views: Sequence[RunView]) -> Sequence[Scope]:
        """Return every table that turns."""
        return [scope for scope in tables_of(views) if any(turns(views[k]) for k in scope.runs)]

    def like(self, other: Mistake) -> bool:
        """Return whether another mistake is the nominal scale factor of gyros, which only the Earth rate determines."""
        return isinstance(other, NominalScale) and other.of_gyros

    def corrected(self, views: Sequence[RunView], place: int, size: float) -> RunView:
        """Return the run with its rates multiplied."""
        return changed(views[place], rate=views[place].rate * math.exp(size))


RATES = "table rate"
"""The rates of a table as a record."""
_MOST_TURNS = 4
"""Angles of more turns are in no other unit; multiples of 15 degrees in turns would all be one angle."""
_SAME_FACTOR = 0.02


def _least_driven(scope: Scope, views: Sequence[RunView], channels: Sequence[Channel]) -> int:
    """Return how many of some channels need an input to show their unit: in one of several runs biases show it."""
    return 1 if scope.section == "run" and len(views) > 1 else min(2, len(channels))


@dataclass(frozen=True)
class ChannelGain(Mistake):
    """Channels respond with a factor: another sign, or another unit (`units`).

    The factor leaves the `offsets` as they are: those of the channels where the scale factor is wrong, zero where the
    column is in another unit.
    """

    channels: tuple[str, ...]
    places: tuple[int, ...]
    offsets: tuple[float, ...]
    factor: float
    units: str
    kind: ClassVar[str] = "channel_unit"
    concealed: ClassVar[Concealed] = Concealed.BY_ONE_INPUT

    @property
    def record(self) -> str:
        """The scale factor of the channels; a reversed sign has no factor."""
        return scale_of(self.channels) if self.units else ""

    @property
    def point(self) -> float:
        """The logarithm of the factor."""
        return math.log(abs(self.factor))

    @property
    def unlikelihood(self) -> float:
        """A unit or a sign is that of a channel in all runs, a unit that of all channels of a kind."""
        single = len(self.channels) == 1
        if self.scope.section == "run":
            return NAMED_SCALE if self.units and single else SCALE_OF_KIND
        return (8.0 if single else 2.0) if self.units else (0.0 if single else 8.0)

    @classmethod
    def suspected(cls, campaign: Campaign, views: Sequence[RunView]) -> Iterator[Mistake]:
        """Yield every channel and all of a kind, in all runs or one."""
        for kind, gains in GAINS.items():
            factors = {"": -1.0} | gains
            scopes = [all_runs(range(len(views))), *single_runs(views, False)]
            tumbled = feels_the_earth_alone(campaign, views)
            for scope, group in itertools.product(scopes, _groups(campaign, kind)):
                channels = [campaign.channels[k] for k in group]
                # Of tumbles the other runs determine the biases, which a constant input passes for in one.
                here = views if tumbled else [views[k] for k in scope.runs]
                told = sum(driven(campaign, channel, here) for channel in channels)
                if told < _least_driven(scope, views, channels):
                    continue
                names, offsets = tuple(c.name for c in channels), tuple(c.offset for c in channels)
                counts = np.unique(np.concatenate([views[k].samples for k in scope.runs]))
                summed = {"sums instead of means": float(counts[0])} if len(counts) == 1 and counts[0] > 1 else {}
                about = dict.fromkeys([offsets, (0.0,) * len(group)] if scope.section == "run" else [offsets])
                for (units, factor), fixed in itertools.product((factors | summed).items(), about):
                    yield cls(scope, names, group, fixed, factor, units)

    def like(self, other: Mistake) -> bool:
        """Return whether another mistake is the sense of the table in the run, alike for the one gyro that turns.

        The same factor of the rates is alike as well.
        """
        if isinstance(other, RateUnit):
            return other.like(self)
        return not self.units and isinstance(other, TableSense) and other.scope == self.scope

    def wrong_record(self, campaign: Campaign, size: float, sd: float) -> WrongRecord | None:
        """Return the factor on the outputs of one channel in a run."""
        return output_factor(campaign, self.scope, self.places, 1 / self.factor, 0.0, self.offsets[0])

    def corrected(self, views: Sequence[RunView], place: int, size: float) -> RunView:
        """Return the run with the outputs divided by the factor."""
        observed, at = views[place].observed.copy(), list(self.places)
        observed[:, at] = self.offsets + (observed[:, at] - self.offsets) / self.factor
        return changed(views[place], observed=observed)

    def rescaled(self, view: RunView) -> float:
        """Return the number of outputs divided by the factor, times its logarithm."""
        return float(np.isfinite(view.observed[:, list(self.places)]).sum() * np.log(abs(self.factor)))


@dataclass(frozen=True)
class RateUnit(Mistake):
    """The rate column is in another unit."""

    unit: str
    kind: ClassVar[str] = "rate_unit"

    @property
    def record(self) -> str:
        """The rates of a table."""
        return RATES

    @property
    def point(self) -> float:
        """The logarithm of the unit in deg/s."""
        return math.log(RATE_UNITS[self.unit])

    @classmethod
    def suspected(cls, campaign: Campaign, views: Sequence[RunView]) -> Iterator[Mistake]:
        """Yield every unit for every table and run that turns."""
        for scope, unit in itertools.product(tables_and_runs(views, turns), RATE_UNITS):
            yield cls(scope, unit)

    def like(self, other: Mistake) -> bool:
        """Return whether another mistake is a gain of gyros in the same turning runs that does the same.

        Only the Earth rate, biases and the lever arms of accelerometers distinguish the two, all of them loosely.  A
        gain of one gyro is alike if it alone sees the rate.
        """
        if isinstance(other, NominalScale):
            return self.scope.section == "table" and other.of_gyros
        if not isinstance(other, ChannelGain):
            return False
        same = self.scope.section == "table" if other.scope.section == "campaign" else other.scope == self.scope
        return same and abs(other.factor / RATE_UNITS[self.unit] - 1) < _SAME_FACTOR

    def wrong_record(self, campaign: Campaign, size: float, sd: float) -> WrongRecord | None:
        """Return the factor on the rates of a run."""
        return rate_factor(self.scope, RATE_UNITS[self.unit], 0.0)

    def corrected(self, views: Sequence[RunView], place: int, size: float) -> RunView:
        """Return the run with the rate converted."""
        return changed(views[place], rate=views[place].rate * RATE_UNITS[self.unit])


@dataclass(frozen=True)
class AngleUnit(Mistake):
    """The angle column is in another unit."""

    unit: str
    kind: ClassVar[str] = "angle_unit"
    concealed: ClassVar[Concealed] = Concealed.BY_ONE_INPUT

    @classmethod
    def suspected(cls, campaign: Campaign, views: Sequence[RunView]) -> Iterator[Mistake]:
        """Yield every unit for every table and run at several angles."""
        scopes = tables_and_runs(views, lambda view: has_angles(view) and bool(np.nanmax(np.abs(view.angle)) > 0))
        for scope, unit in itertools.product(scopes, ANGLE_UNITS):
            largest = max(float(np.nanmax(np.abs(views[k].angle + views[k].zero), initial=0.0)) for k in scope.runs)
            if largest * ANGLE_UNITS[unit] < _MOST_TURNS * 2 * math.pi:
                yield cls(scope, unit)

    def corrected(self, views: Sequence[RunView], place: int, size: float) -> RunView:
        """Return the run with the angles converted."""
        factor, view = ANGLE_UNITS[self.unit], views[place]
        return changed(view, angle=(view.angle + view.zero) * factor - view.zero, span=view.span * factor)
