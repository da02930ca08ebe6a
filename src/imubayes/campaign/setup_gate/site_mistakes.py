"""Mistakes in the latitude, which show where gyros feel the Earth turn."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from imubayes.campaign.setup_gate.mistakes import Mistake, all_runs
from imubayes.campaign.setup_gate.run_view import RunView, changed, feels_the_earth_alone, turns_through
from imubayes.campaign_data import Campaign

_DEGREE = math.pi / 180


def _feels_the_earth(campaign: Campaign, views: Sequence[RunView]) -> bool:
    return any(channel.kind == "gyro" for channel in campaign.channels) and any(v.reference is None for v in views)


@dataclass(frozen=True)
class LatitudeSign(Mistake):
    """The latitude has the wrong sign."""

    kind: ClassVar[str] = "latitude_sign"

    @classmethod
    def suspected(cls, campaign: Campaign, views: Sequence[RunView]) -> Iterator[Mistake]:
        """Yield the one mistake, where there are gyros."""
        if _feels_the_earth(campaign, views) and campaign.site.latitude:
            yield cls(all_runs(range(len(views))))

    def corrected(self, views: Sequence[RunView], place: int, size: float) -> RunView:
        """Return the view on the other hemisphere."""
        return changed(views[place], latitude=-views[place].latitude)


@dataclass(frozen=True)
class LatitudeValue(Mistake):
    """The latitude is another one; its size is the true latitude, rad."""

    north: bool
    kind: ClassVar[str] = "latitude_value"
    rarity: ClassVar[float] = 15.0
    sizes: ClassVar[tuple[float, ...]] = tuple(np.arange(-90, 91, 15) * _DEGREE)

    @property
    def variant(self) -> str:
        """The hemisphere: a gyro that turns about the vertical does not tell it."""
        return "north" if self.north else "south"

    @classmethod
    def suspected(cls, campaign: Campaign, views: Sequence[RunView]) -> Iterator[Mistake]:
        """Yield both hemispheres where gyros turned or sat in several mountings: else biases pass for Earth rate."""
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


LATITUDE_MISTAKES: tuple[type[Mistake], ...] = (LatitudeSign, LatitudeValue)
