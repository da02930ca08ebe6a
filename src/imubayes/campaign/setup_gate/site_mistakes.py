"""Mistakes in the latitude, which show where gyros feel the Earth turn."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from imubayes.campaign.setup_gate.mistakes import Mistake, all_runs
from imubayes.campaign.setup_gate.run_view import RunView
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
        return replace(views[place], latitude=-views[place].latitude)


@dataclass(frozen=True)
class LatitudeValue(Mistake):
    """The latitude is another one; its size is the true latitude, rad."""

    kind: ClassVar[str] = "latitude_value"
    sizes: ClassVar[tuple[float, ...]] = tuple(np.arange(-90, 91, 15) * _DEGREE)
    rarity: ClassVar[float] = 15.0
    by_evidence: ClassVar[bool] = True

    @classmethod
    def suspected(cls, campaign: Campaign, views: Sequence[RunView]) -> Iterator[Mistake]:
        """Yield the one mistake, where gyros sat in several mountings: in few, biases pass for the Earth rate."""
        if _feels_the_earth(campaign, views) and len({view.mounting for view in views}) > 2:
            yield cls(all_runs(range(len(views))))

    def corrected(self, views: Sequence[RunView], place: int, size: float) -> RunView:
        """Return the view at another latitude."""
        return replace(views[place], latitude=float(np.clip(size, -math.pi / 2, math.pi / 2)))


LATITUDE_MISTAKES: tuple[type[Mistake], ...] = (LatitudeSign, LatitudeValue)
