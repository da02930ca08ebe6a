"""Mistakes in units and signs: of channels, and of the columns of rate and angle."""

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from imubayes.campaign.setup_gate.mistakes import (
    Mistake,
    TableSense,
    all_runs,
    has_angles,
    single_runs,
    tables_of,
    wide_first,
)
from imubayes.campaign.setup_gate.nominal_scales import GAINS, SCALE_MISTAKES, NominalScale, driven
from imubayes.campaign.setup_gate.run_view import RunView, changed
from imubayes.campaign_data import Campaign

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
_MOST_TURNS = 4
"""Angles of more turns are in no other unit; multiples of 15 degrees in turns would all be one angle."""
_SAME_FACTOR = 0.02


@dataclass(frozen=True)
class ChannelGain(Mistake):
    """Channels respond with a factor: another sign, or another unit (`units`)."""

    channels: tuple[str, ...]
    places: tuple[int, ...]
    offsets: tuple[float, ...]
    factor: float
    units: str
    kind: ClassVar[str] = "channel_unit"

    @property
    def unlikelihood(self) -> float:
        """A unit or a sign is that of a channel in all runs, a unit that of all channels of a kind."""
        single = len(self.channels) == 1
        if self.scope.section == "run":
            return (30.0 if single else 15.0) if self.units else 15.0
        return (8.0 if single else 2.0) if self.units else (0.0 if single else 8.0)

    @classmethod
    def suspected(cls, campaign: Campaign, views: Sequence[RunView]) -> Iterator[Mistake]:
        """Yield every channel and all of a kind, in all runs or one."""
        for kind, gains in GAINS.items():
            places = [k for k, channel in enumerate(campaign.channels) if channel.kind == kind]
            groups = [(k,) for k in places] + ([tuple(places)] if len(places) > 1 else [])
            factors = {"": -1.0} | gains
            scopes = [all_runs(range(len(views))), *single_runs(views, False)]
            for scope, group in itertools.product(scopes, groups):
                channels = [campaign.channels[k] for k in group]
                if not all(driven(campaign, channel, [views[k] for k in scope.runs]) for channel in channels):
                    continue
                names, offsets = tuple(c.name for c in channels), tuple(c.offset for c in channels)
                for units, factor in factors.items():
                    yield cls(scope, names, group, offsets, factor, units)

    def like(self, other: Mistake) -> bool:
        """Return whether another mistake is the sense of the table in the run: alike for the one gyro that turns."""
        return not self.units and isinstance(other, TableSense) and other.scope == self.scope

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

    @classmethod
    def suspected(cls, campaign: Campaign, views: Sequence[RunView]) -> Iterator[Mistake]:
        """Yield every unit for every table and run that turns."""
        turning = [scope for scope in tables_of(views) if any(np.any(views[k].rate) for k in scope.runs)]
        runs = [scope for scope in single_runs(views) if np.any(views[scope.runs[0]].rate)]
        for scope, unit in itertools.product(wide_first(turning, runs), RATE_UNITS):
            yield cls(scope, unit)

    def like(self, other: Mistake) -> bool:
        """Return whether another mistake is a gain of gyros in the same turning runs that does the same.

        Only the Earth rate, biases and the lever arms of accelerometers tell the two, all of them loosely.  A gain of
        one gyro is alike where it alone sees the rate.
        """
        if isinstance(other, NominalScale):
            return self.scope.section == "table" and other.of_gyros
        if not isinstance(other, ChannelGain):
            return False
        same = self.scope.section == "table" if other.scope.section == "campaign" else other.scope == self.scope
        return same and abs(other.factor / RATE_UNITS[self.unit] - 1) < _SAME_FACTOR

    def corrected(self, views: Sequence[RunView], place: int, size: float) -> RunView:
        """Return the run with the rate converted."""
        return changed(views[place], rate=views[place].rate * RATE_UNITS[self.unit])


@dataclass(frozen=True)
class AngleUnit(Mistake):
    """The angle column is in another unit."""

    unit: str
    kind: ClassVar[str] = "angle_unit"

    @classmethod
    def suspected(cls, campaign: Campaign, views: Sequence[RunView]) -> Iterator[Mistake]:
        """Yield every unit for every table and run at several angles."""
        several = [k for k, view in enumerate(views) if has_angles(view) and np.nanmax(np.abs(view.angle)) > 0]
        tables = [scope for scope in tables_of(views) if set(scope.runs) & set(several)]
        runs = [scope for scope in single_runs(views) if scope.runs[0] in several]
        for scope, unit in itertools.product(wide_first(tables, runs), ANGLE_UNITS):
            largest = max(float(np.nanmax(np.abs(views[k].angle + views[k].zero), initial=0.0)) for k in scope.runs)
            if largest * ANGLE_UNITS[unit] < _MOST_TURNS * 2 * math.pi:
                yield cls(scope, unit)

    def corrected(self, views: Sequence[RunView], place: int, size: float) -> RunView:
        """Return the run with the angles converted."""
        factor, view = ANGLE_UNITS[self.unit], views[place]
        return changed(view, angle=(view.angle + view.zero) * factor - view.zero, span=view.span * factor)


UNIT_MISTAKES: tuple[type[Mistake], ...] = (ChannelGain, RateUnit, AngleUnit, *SCALE_MISTAKES)
