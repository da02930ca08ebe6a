"""A rate of the table that is wrong by a factor in one run, as that of another range or of a slipping drive."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from imubayes.campaign.setup_gate.mistakes import Mistake, single_runs
from imubayes.campaign.setup_gate.run_view import RunView, changed
from imubayes.campaign_data import Campaign


@dataclass(frozen=True)
class RateFactor(Mistake):
    """The rates of one run are to be multiplied by 1 + size; the other runs that turn tell by how much."""

    kind: ClassVar[str] = "table_rate"
    rarity: ClassVar[float] = 8.0
    sizes: ClassVar[tuple[float, ...]] = tuple(np.linspace(-0.2, 0.2, 9).tolist())

    @classmethod
    def suspected(cls, campaign: Campaign, views: Sequence[RunView]) -> Iterator[Mistake]:
        """Yield every run that turns, where there are several: a scale factor is known by the rate alone."""
        turning = [scope for scope in single_runs(views) if np.any(views[scope.runs[0]].rate)]
        if len(turning) > 1 and any(channel.kind == "gyro" for channel in campaign.channels):
            for scope in turning:
                yield cls(scope)

    def possible(self, size: float) -> bool:
        """Return whether there can be such a factor: larger ones are another unit."""
        return abs(size) < 1.5 * self.sizes[-1]

    def corrected(self, views: Sequence[RunView], place: int, size: float) -> RunView:
        """Return the run with its rates multiplied."""
        return changed(views[place], rate=views[place].rate * (1 + size))
