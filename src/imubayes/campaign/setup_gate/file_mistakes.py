"""Mistakes of a run as a whole: another unit, outputs of another run, or rows of fewer samples than stated."""

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from imubayes.campaign.setup_gate.equipment_mistakes import DOUBTED, RIVALLED, Concealed, Mistake, Scope, single_runs
from imubayes.campaign.setup_gate.setup_view import RunView, changed
from imubayes.foundations.campaign_data import Campaign
from imubayes.foundations.wrong_records import OPEN, WrongRecord


@dataclass(frozen=True)
class OtherUnit(Mistake):
    """A run is of another unit: its sensors have errors of their own, all channels at once.

    Nothing in the record of the run is to be corrected, so that its view stays as it is.  Its errors are independent of
    those of the other runs.
    """

    kind: ClassVar[str] = "other_unit"
    concealed: ClassVar[Concealed] = Concealed.BY_INPUTS
    of_doubted_runs: ClassVar[int] = DOUBTED

    @classmethod
    def scopes(cls, campaign: Campaign, views: Sequence[RunView]) -> Sequence[Scope]:
        """Return each run whose input is stated, if others determine what the unit is like.

        A reference gyro has errors of its own.
        """
        known = [scope for scope in single_runs(views, tables_only=False) if views[scope.runs[0]].reference is None]
        return known if len(known) > 2 else []

    def bar(self, campaign: Campaign) -> float:
        """Return what other biases in a run would gain."""
        return RIVALLED * len(campaign.channels)

    @property
    def passes_for(self) -> str:
        """What another unit is."""
        return "biases and scale factors unlike those of other runs"

    def wrong_record(self, campaign: Campaign, size: float, sd: float) -> WrongRecord | None:
        """Return that the run is of another unit."""
        return WrongRecord(run=self.scope.name, form="unit", quantity="unit", unit="1", recorded=None, agreeing=())

    def rivals(self) -> Iterator[Mistake]:
        """Yield that the rows scatter more than their stated count of samples allows."""
        yield SamplesFewer(self.scope)

    def corrected(self, views: Sequence[RunView], place: int, size: float) -> RunView:
        """Return the run as it is."""
        return views[place]


@dataclass(frozen=True)
class OutputsExchanged(Mistake):
    """The outputs of two runs are exchanged, and the columns of the bench are not; `other` is the place of the second.

    They were joined to the wrong log of the bench.
    """

    second: str
    other: int
    kind: ClassVar[str] = "outputs_exchanged"
    rarity: ClassVar[float] = OPEN

    @classmethod
    def suspected(cls, campaign: Campaign, views: Sequence[RunView]) -> Iterator[Mistake]:
        """Yield every pair of runs of as many rows at other stimuli."""
        for first, second in itertools.combinations(range(len(views)), 2):
            if views[first].rows == views[second].rows and _stimuli_differ(views[first], views[second]):
                yield cls(Scope("run", views[first].name, (first, second)), views[second].name, second)

    def corrected(self, views: Sequence[RunView], place: int, size: float) -> RunView:
        """Return the run with the outputs of the other."""
        source = views[self.scope.runs[0] if place == self.other else self.other]
        return changed(views[place], observed=source.observed)


def _stimuli_differ(one: RunView, other: RunView) -> bool:
    pairs = ((one.angle, other.angle), (one.rate, other.rate), (one.reference, other.reference))
    return any(a is None or b is None or not np.allclose(a, b, equal_nan=True) for a, b in pairs if a is not b)


_FEWER = tuple(math.log(each) for each in (2.0, 5.0, 12.0, 30.0, 75.0, 200.0, 500.0, 1200.0, 3000.0))
_LEAST_FEWER = math.log(8.0)
"""Logarithm of how many times as many samples are doubted: with fewer, the noise of a run is that of another day."""


@dataclass(frozen=True)
class SamplesFewer(Mistake):
    """The rows of a run are means of fewer samples than stated; the size is the logarithm of the ratio.

    Means that scatter more than their count allows look like those of another unit, of which it is a rival.
    """

    kind: ClassVar[str] = "samples_unlike"
    by_evidence: ClassVar[bool] = True
    rarity: ClassVar[float] = OPEN
    gross: ClassVar[bool] = False
    sizes: ClassVar[tuple[float, ...]] = _FEWER

    def possible(self, size: float) -> bool:
        """Return whether the count is beyond what another noise in the run explains, and within those tried."""
        return _LEAST_FEWER < size < _FEWER[-1]

    def stops(self, size: float) -> bool:
        """Return that a fit goes on: it estimates the noise."""
        return False

    def bar(self, campaign: Campaign) -> float:
        """Return what a noise of the run of its own would gain."""
        return RIVALLED

    def wrong_record(self, campaign: Campaign, size: float, sd: float) -> WrongRecord | None:
        """Return the count that agrees."""
        stated = float(np.median(next(run.samples for run in campaign.runs if run.name == self.scope.name)))
        return WrongRecord(
            run=self.scope.name, form="samples", quantity="samples", unit="1", recorded=stated,
            agreeing=(stated * math.exp(-size),),
        )  # fmt: skip

    def corrected(self, views: Sequence[RunView], place: int, size: float) -> RunView:
        """Return the run with fewer samples in each row."""
        return changed(views[place], samples=views[place].samples * math.exp(-size))
