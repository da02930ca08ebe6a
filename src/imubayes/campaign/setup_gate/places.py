"""Where a campaign says what it says: the places that remedies name."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from imubayes.campaign.setup_gate.equipment_mistakes import Mistake
from imubayes.campaign.toml_documents import Ledger
from imubayes.foundations.campaign_data import Campaign


@dataclass(frozen=True)
class Places:
    """Where a campaign says what it says.

    Attributes
    ----------
    ledger : of the campaign file; without lines if there is none.
    tables : run → its table, for messages.
    files : run → its file, as the campaign states it.
    """

    campaign: Campaign
    ledger: Ledger
    tables: Mapping[str, str] = field(default_factory=dict)
    files: Mapping[str, str] = field(default_factory=dict)

    def table(self, run: str) -> str:
        """Return where the table of a run is."""
        return self.tables.get(run, str(self.ledger.file))

    def file(self, run: str) -> str:
        """Return the file of a run as the campaign states it."""
        return self.files.get(run, self.ledger.file.name)

    def line(self, section: str, name: str, key: str) -> str:
        """Return file, line and key of an entry of the campaign."""
        members = {
            "run": [run.name for run in self.campaign.runs],
            "channel": [channel.name for channel in self.campaign.channels],
            "table": [*self.campaign.tables],
            "mounting": [*self.campaign.mountings],
        }
        return self.ledger.where(section, members[section].index(name), key)

    def site(self, key: str) -> str:
        """Return file, line and key of an entry of the site."""
        return self.ledger.where("site", key)

    def zero(self, table: str) -> float:
        """Return the stated reading of the angle at the zero of a table, deg."""
        found = self.campaign.tables.get(table)
        return 0.0 if found is None else math.degrees(found.zero_angle)

    def column(self, mistake: Mistake, column: str) -> str:
        """Return where a column of the runs concerned stands."""
        if mistake.scope.section == "run":
            return f"{self.table(mistake.scope.name)}, column '{column}'"
        return f"{self.ledger.file}, column '{column}' of the runs"


def subject_of(mistake: Mistake) -> str:
    """Return in words which runs a mistake is in."""
    scope = mistake.scope
    if scope.section == "run":
        return f"in run '{scope.name}'"
    if scope.section == "campaign":
        return "in all runs"
    return f"in all runs on table '{scope.name}'" if scope.section == "table" else f"in all runs in '{scope.name}'"
