"""Nominal scale factors, and rates of a table, that are wrong by a factor that is no unit's.

An input that is too small everywhere is imitated by a response that is: the accelerometer on an axis raised to 60°
reads half of what it would on a horizontal one, as one of half the nominal scale factor does.  The errors of the
outputs stay as large as they are, so that a smaller scale factor gains nothing over another input but what the outputs
tell.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from imubayes.campaign.setup_gate.mistakes import Mistake, all_runs, tables_of
from imubayes.campaign.setup_gate.run_view import RunView, changed, feels_the_earth_alone
from imubayes.campaign_data import Campaign, Channel

_DEGREE = math.pi / 180
GAINS = {
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
_LOGARITHMS = tuple(np.arange(-3.0, 2.6, 0.25).tolist())  # factors of 0.05 to 12
ORDINARY_SCALE = 0.1
"""Deviation from the nominal scale factor up to which it may be that of a poor unit rather than a mistake."""

_LEAST_CHANGE = 5 * _DEGREE / 3600  # rad/s, a third of the Earth rate
_LEAST_INPUT = {"gyro": 0.5 * _DEGREE, "accelerometer": 0.5}  # rad/s and m/s²


def driven(campaign: Campaign, channel: Channel, views: Sequence[RunView]) -> bool:
    """Whether a channel has an input from which its scale factor shows.

    Without one a large factor would only make the errors of the channel small.  Where all feel the Earth rate alone,
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


@dataclass(frozen=True)
class _Factor(Mistake):
    rarity: ClassVar[float] = 8.0
    sizes: ClassVar[tuple[float, ...]] = _LOGARITHMS
    usual_within: ClassVar[float] = 0.1

    def possible(self, size: float) -> bool:
        """Return whether a channel that responds so responds at all."""
        return abs(size) < 1.2 * abs(_LOGARITHMS[0])

    def stops(self, size: float) -> bool:
        """Return whether the factor is beyond that of a poor unit."""
        return abs(math.expm1(size)) > ORDINARY_SCALE


@dataclass(frozen=True)
class NominalScale(_Factor):
    """The scale factor of channels is the nominal one times a factor, in all runs; the size is its logarithm."""

    channels: tuple[str, ...]
    places: tuple[int, ...]
    of_gyros: bool
    kind: ClassVar[str] = "channel_unit"

    def units(self, size: float) -> str:
        """Return the mistaken unit of the outputs, if the factor is that of one."""
        return next((name for name, factor in self._gains.items() if math.log(factor) == size), "")

    @property
    def _gains(self) -> dict[str, float]:
        return GAINS["gyro" if self.of_gyros else "accelerometer"]

    def usual(self, views: Sequence[RunView]) -> tuple[float, ...]:
        """Return the factors of mistaken units."""
        return tuple(math.log(factor) for factor in self._gains.values())

    @classmethod
    def suspected(cls, campaign: Campaign, views: Sequence[RunView]) -> Iterator[Mistake]:
        """Yield every channel that has an input, and all of a kind."""
        for kind in ("gyro", "accelerometer"):
            places = [
                k for k, each in enumerate(campaign.channels) if each.kind == kind and driven(campaign, each, views)
            ]
            for group in [(k,) for k in places] + ([tuple(places)] if len(places) > 1 else []):
                yield cls(
                    all_runs(range(len(views))), tuple(campaign.channels[k].name for k in group), group, kind == "gyro"
                )

    def like(self, other: Mistake) -> bool:
        """Return whether another mistake is a factor of the rates that makes the same of the same gyros."""
        return self.of_gyros and isinstance(other, TableRates)

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
    def suspected(cls, campaign: Campaign, views: Sequence[RunView]) -> Iterator[Mistake]:
        """Yield every table that turns."""
        for scope in tables_of(views):
            if any(np.any(views[k].rate) for k in scope.runs):
                yield cls(scope)

    def like(self, other: Mistake) -> bool:
        """Return whether another mistake is the nominal scale factor of gyros, which only the Earth rate tells."""
        return isinstance(other, NominalScale) and other.of_gyros

    def corrected(self, views: Sequence[RunView], place: int, size: float) -> RunView:
        """Return the run with its rates multiplied."""
        return changed(views[place], rate=views[place].rate * math.exp(size))


SCALE_MISTAKES: tuple[type[Mistake], ...] = (NominalScale, TableRates)
