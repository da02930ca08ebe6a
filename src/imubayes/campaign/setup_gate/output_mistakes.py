"""Mistakes in the outputs: channels exchanged, one channel in one run off by one value, or that of anything else.

An offset is that of a readout whose zero was changed, or of a sensor that came up with another bias.  Without it among
the mistakes a run with one output that is off becomes one of another unit.  Outputs of anything else are the open value
of a channel in a run: those of a sensor that is stuck, or the copy of another column.
"""

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from imubayes.campaign.setup_gate.equipment_mistakes import Concealed, Mistake, Scope, all_runs, single_runs
from imubayes.campaign.setup_gate.reading_mistakes import driven
from imubayes.campaign.setup_gate.setup_view import RunView, changed
from imubayes.foundations.campaign_data import Campaign, Channel
from imubayes.foundations.wrong_records import OPEN, WrongRecord

_DEGREE = math.pi / 180


@dataclass(frozen=True)
class ChannelsExchanged(Mistake):
    """Channels are exchanged: channel `order[i]` is in the column of channel `places[i]`."""

    places: tuple[int, ...]
    order: tuple[int, ...]
    kind: ClassVar[str] = "axes_exchanged"
    concealed: ClassVar[Concealed] = Concealed.BY_ONE_INPUT

    @property
    def unlikelihood(self) -> float:
        """Cables are exchanged for all runs, or columns in one file."""
        return 10.0 if self.scope.section == "run" else 0.0

    @classmethod
    def suspected(cls, campaign: Campaign, views: Sequence[RunView]) -> Iterator[Mistake]:
        """Yield every pair and, of three channels of a kind, both cycles; in all runs or one."""
        for places in places_of_kinds(campaign):
            orders = [((a, b), (b, a)) for a, b in itertools.combinations(places, 2)]
            orders += [((a, b, c), turned) for a, b, c in itertools.combinations(places, 3)
                       for turned in ((b, c, a), (c, a, b))]  # fmt: skip
            scopes = [all_runs(range(len(views))), *single_runs(views, False)]
            for scope, (before, after) in itertools.product(scopes, orders):
                yield cls(scope, before, after)

    def corrected(self, views: Sequence[RunView], place: int, size: float) -> RunView:
        """Return the run with the columns in order."""
        observed = views[place].observed.copy()
        observed[:, list(self.order)] = views[place].observed[:, list(self.places)]
        return changed(views[place], observed=observed)


@dataclass(frozen=True)
class KindsExchanged(ChannelsExchanged):
    """A gyro and an accelerometer are exchanged: gross, since their outputs have inputs of different units.

    Both have an input.  Without one, outputs of either kind are a bias and noise of the other.
    """

    concealed: ClassVar[Concealed] = Concealed.NEVER

    @classmethod
    def suspected(cls, campaign: Campaign, views: Sequence[RunView]) -> Iterator[Mistake]:
        """Yield every pair, in all runs or one."""
        scopes = [all_runs(range(len(views))), *single_runs(views, False)]
        for scope in scopes:
            here = [views[place] for place in scope.runs]
            moved = (
                [k for k in kind if driven(campaign, campaign.channels[k], here)] for kind in places_of_kinds(campaign)
            )
            for a, b in itertools.product(*moved):
                yield cls(scope, (a, b), (b, a))


def places_of_kinds(campaign: Campaign) -> tuple[list[int], list[int]]:
    """Return the places of the gyros and of the accelerometers."""
    gyros, accelerometers = (
        [k for k, channel in enumerate(campaign.channels) if channel.kind == kind] for kind in ("gyro", "accelerometer")
    )
    return gyros, accelerometers


def _single_outputs(campaign: Campaign, views: Sequence[RunView]) -> Iterator[tuple[Scope, int]]:
    """Yield each run with each of several channels in it, if other runs determine what its outputs are."""
    channels = [k for k, each in enumerate(campaign.channels) if each.kind != "angle"]
    if len(channels) < 2 or len(views) < 3:
        return
    for scope, k in itertools.product(single_runs(views, tables_only=False), channels):
        if np.isfinite(views[scope.runs[0]].observed[:, k]).any():
            yield scope, k


@dataclass(frozen=True)
class ChannelOffset(Mistake):
    """The outputs of a channel, in a run or in all, are off by a size, as a ratio to the largest output.

    In all runs the stated offset of the channel is another one.

    Attributes
    ----------
    place : of the channel.
    largest : of its outputs about their offset, output units.
    """

    channel: str
    place: int
    largest: float
    kind: ClassVar[str] = "output_offset"
    estimated: ClassVar[bool] = True
    rarity: ClassVar[float] = OPEN
    sizes: ClassVar[tuple[float, ...]] = (-1.0, -0.5, 0.0, 0.5, 1.0)

    @property
    def variant(self) -> str:
        """The channel."""
        return self.channel

    @classmethod
    def suspected(cls, campaign: Campaign, views: Sequence[RunView]) -> Iterator[Mistake]:
        """Yield the channels whose outputs do not lie about their offset, and every one in every run."""
        places = [k for k, each in enumerate(campaign.channels) if each.kind != "angle" and _is_off(views, k, each)]
        every = [(all_runs(range(len(views))), k) for k in places]
        for scope, k in (*every, *_single_outputs(campaign, views)):
            channel = campaign.channels[k]
            largest = max(np.nanmax(np.abs(view.observed[:, k] - channel.offset), initial=0.0) for view in views)
            if largest > 0:
                yield cls(scope, channel.name, k, float(largest))

    def stops(self, size: float) -> bool:
        """Return whether it is one of a run: a poor unit may have the bias that an unstated offset would be."""
        return self.scope.section == "run"

    def wrong_record(self, campaign: Campaign, size: float, sd: float) -> WrongRecord | None:
        """Return what the outputs of the channel in the run agree with, added to them."""
        if self.scope.section != "run":
            return None
        channel = campaign.channels[self.place]
        return WrongRecord(
            run=self.scope.name, form="output_offset", quantity=channel.name, unit=channel.output_unit, recorded=0.0,
            agreeing=(-size * self.largest,), sd=(sd * self.largest,) if sd else (), kind=channel.kind,
        )  # fmt: skip

    def corrected(self, views: Sequence[RunView], place: int, size: float) -> RunView:
        """Return the run with the outputs less their error."""
        observed = views[place].observed.copy()
        observed[:, self.place] -= size * self.largest
        return changed(views[place], observed=observed)


@dataclass(frozen=True)
class OffsetsMissing(Mistake):
    """The outputs of all channels in a run were recorded less their offsets: signed counts beside unsigned ones."""

    offsets: tuple[float, ...]
    kind: ClassVar[str] = "output_offset"
    rarity: ClassVar[float] = OPEN

    @property
    def variant(self) -> str:
        """All channels."""
        return "all"

    @classmethod
    def suspected(cls, campaign: Campaign, views: Sequence[RunView]) -> Iterator[Mistake]:
        """Yield every run of several, if channels have an offset."""
        offsets = tuple(channel.offset for channel in campaign.channels)
        if any(offsets) and len(views) > 1:
            yield from (cls(scope, offsets) for scope in single_runs(views, tables_only=False))

    def wrong_record(self, campaign: Campaign, size: float, sd: float) -> WrongRecord | None:
        """Return the offsets, added to the outputs."""
        return WrongRecord(
            run=self.scope.name, form="output_offset", quantity="outputs", unit=campaign.channels[0].output_unit,
            recorded=0.0, agreeing=self.offsets,
        )  # fmt: skip

    def corrected(self, views: Sequence[RunView], place: int, size: float) -> RunView:
        """Return the run with the offsets."""
        return changed(views[place], observed=views[place].observed + np.array(self.offsets))


_LEAST_BIAS = {"gyro": 5 * _DEGREE, "accelerometer": 15.0}
"""Median output about the offset from which an offset is doubted: rad/s, and m/s², above that of a unit at rest."""


def _is_off(views: Sequence[RunView], place: int, channel: Channel) -> bool:
    """Whether the outputs of a channel lie farther about its stated offset than a bias lets them."""
    outputs = np.concatenate([view.observed[:, place] for view in views]) - channel.offset
    outputs = outputs[np.isfinite(outputs)]
    if not len(outputs):
        return False
    middle = abs(float(np.median(outputs)))
    return middle > _LEAST_BIAS[channel.kind] * channel.scale_si


_RANGE = 1e3
"""Largest output over the errors of a plausible unit: what an output is worth that may be anything."""


@dataclass(frozen=True)
class ChannelApart(Mistake):
    """The outputs of a channel in a run are those of anything else, and show nothing."""

    channel: str
    place: int
    rows: int
    kind: ClassVar[str] = "outputs_apart"

    @property
    def variant(self) -> str:
        """The channel."""
        return self.channel

    @property
    def unlikelihood(self) -> float:
        """Every output is any within the range."""
        return 2 * math.log(_RANGE) * self.rows

    @classmethod
    def suspected(cls, campaign: Campaign, views: Sequence[RunView]) -> Iterator[Mistake]:
        """Yield every channel of several in every run, if other runs determine what its outputs are."""
        for scope, k in _single_outputs(campaign, views):
            rows = int(np.isfinite(views[scope.runs[0]].observed[:, k]).sum())
            yield cls(scope, campaign.channels[k].name, k, rows)

    def corrected(self, views: Sequence[RunView], place: int, size: float) -> RunView:
        """Return the run without the outputs."""
        observed = views[place].observed.copy()
        observed[:, self.place] = np.nan
        return changed(views[place], observed=observed)


def repeats(campaign: Campaign, run: int, channel: int) -> str:
    """Return the name of the channel whose outputs a channel repeats in a run, and its own if they hold one value.

    Empty if they do neither.
    """
    outputs = campaign.runs[run].observed
    own = outputs[:, channel]
    reach = np.nanmax(np.abs(own), initial=0.0)
    if np.ptp(own[np.isfinite(own)]) <= _ALIKE * reach:
        return campaign.channels[channel].name
    others = [k for k in range(outputs.shape[1]) if k != channel]
    alike = [k for k in others if np.nanmax(np.abs(outputs[:, k] - own), initial=0.0) <= _ALIKE * reach]
    return campaign.channels[alike[0]].name if alike else ""


_ALIKE = 1e-5
"""Relative difference of outputs that are one value, or one column twice."""
