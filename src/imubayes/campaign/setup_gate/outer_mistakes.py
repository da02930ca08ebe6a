"""Mistakes in the axes that carry the inner axis of a table of several axes."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from imubayes.campaign.setup_gate.mistakes import RIGHT_ANGLES, Mistake, tables_of
from imubayes.campaign.setup_gate.run_view import RunView, changed
from imubayes.campaign_data import Campaign

OUTER = ("outer", "middle")


@dataclass(frozen=True)
class AxisZero(Mistake):
    """The zero of the outer or of the middle axis of a table is off in all its runs."""

    axis: int
    kind: ClassVar[str] = "axis_zero"
    usual_within: ClassVar[float] = math.radians(3.5)
    sizes: ClassVar[tuple[float, ...]] = tuple(np.radians(np.arange(-150, 181, 30)))

    @property
    def variant(self) -> str:
        """The axis."""
        return OUTER[self.axis]

    @classmethod
    def suspected(cls, campaign: Campaign, views: Sequence[RunView]) -> Iterator[Mistake]:
        """Yield both axes of every table that has them."""
        for scope in tables_of(views):
            if all(views[place].outer is not None for place in scope.runs):
                yield cls(scope, 0)
                if campaign.tables[scope.name].middle_axis is not None:
                    yield cls(scope, 1)

    def usual(self, views: Sequence[RunView]) -> tuple[float, ...]:
        """Return right angles."""
        return RIGHT_ANGLES

    def corrected(self, views: Sequence[RunView], place: int, size: float) -> RunView:
        """Return the run with the zero moved."""
        outer = views[place].outer
        assert outer is not None
        angle = outer.angle.copy()
        angle[:, self.axis] += size
        return changed(views[place], outer=replace(outer, angle=angle))
