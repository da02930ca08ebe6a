"""Mistakes of whole files: a run of another unit."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from imubayes.campaign.setup_gate.equipment_mistakes import RIVALLED, Concealed, Mistake, Scope, single_runs
from imubayes.campaign.setup_gate.setup_view import RunView
from imubayes.foundations.campaign_data import Campaign
from imubayes.foundations.wrong_records import WrongRecord


@dataclass(frozen=True)
class OtherUnit(Mistake):
    """A run is of another unit: its sensors have errors of their own, all channels at once.

    Nothing in the record of the run is to be corrected, so that its view stays as it is.  Its errors are independent of
    those of the other runs.
    """

    kind: ClassVar[str] = "other_unit"
    concealed: ClassVar[Concealed] = Concealed.BY_INPUTS
    of_doubted_runs: ClassVar[bool] = True

    @classmethod
    def scopes(cls, campaign: Campaign, views: Sequence[RunView]) -> Sequence[Scope]:
        """Return each run whose input is stated, where others tell what the unit is like.

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

    def corrected(self, views: Sequence[RunView], place: int, size: float) -> RunView:
        """Return the run as it is."""
        return views[place]
