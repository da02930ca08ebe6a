"""What `imubayes archive` says: what was packed, what an archive holds, and what is wrong with it."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from imubayes.archive import ArchivedCampaign, Packed
from imubayes.display.report_layout import Report
from imubayes.display.table_layout import Cell, Sheet
from imubayes.errors import Issue


def counted(number: int, noun: str) -> str:
    """Return a number with its noun, in the plural where it has to be."""
    return f"{number} {noun}{'' if number == 1 else 's'}"


def packed_report(packed: Packed, out: Path) -> Report:
    """Return what packing did."""
    said = f"{counted(len(packed.added), 'campaign')} added to {out}, {packed.present} already there"
    refused = [str(issue) for refusal in packed.refused for issue in refusal.issues]
    if packed.refused:
        refused.append(f"{counted(len(packed.refused), 'folder')} cannot be used and {_were(packed)} left out")
    return Report([said], closing=refused)


def _were(packed: Packed) -> str:
    return "was" if len(packed.refused) == 1 else "were"


def packed_json(packed: Packed) -> dict[str, Any]:
    """Return what packing did, for `--json`."""
    refused = [{"folder": each.folder, "issues": [_issue(issue) for issue in each.issues]} for each in packed.refused]
    return {
        "format": 1,
        "added": [_entry(each) for each in packed.added],
        "present": packed.present,
        "refused": refused,
    }


def list_report(campaigns: Sequence[ArchivedCampaign]) -> Report:
    """Return the campaigns of an archive as a table."""
    ordered = sorted(campaigns, key=lambda each: (each.unit, each.date, each.name))
    rows = [
        [Cell(each.unit), Cell(each.name), Cell(each.date or "–"), Cell(str(each.runs)), Cell(str(each.rows)),
         Cell(str(each.channels)), Cell(each.digest[:16])]
        for each in ordered
    ]  # fmt: skip
    units = len({each.unit for each in campaigns})
    head = ("unit", "campaign", "date", "runs", "rows", "channels", "digest")
    said = f"{counted(len(campaigns), 'campaign')} of {counted(units, 'unit')}"
    return Report([said], [Sheet("Campaigns", head, rows, left=(0, 1, 2, 6))])


def list_json(campaigns: Sequence[ArchivedCampaign]) -> dict[str, Any]:
    """Return the campaigns of an archive, for `--json`."""
    return {"format": 1, "campaigns": [_entry(each) for each in campaigns]}


def check_report(files: int, issues: Sequence[Issue]) -> Report:
    """Return what is wrong with an archive."""
    said = f"{counted(files, 'campaign')} checked: " + (counted(len(issues), "problem") if issues else "all intact")
    return Report([said], closing=[str(issue) for issue in issues])


def check_json(files: int, issues: Sequence[Issue]) -> dict[str, Any]:
    """Return what is wrong with an archive, for `--json`."""
    return {"format": 1, "campaigns": files, "issues": [_issue(issue) for issue in issues]}


def _entry(each: ArchivedCampaign) -> dict[str, Any]:
    return {
        "unit": each.unit, "campaign": each.name, "date": each.date, "file": str(each.file), "digest": each.digest,
        "runs": each.runs, "rows": each.rows, "channels": each.channels, "checksum": each.checksum,
    }  # fmt: skip


def _issue(issue: Issue) -> dict[str, Any]:
    return {"what": issue.what, "where": issue.where, "allowed": issue.allowed, "remedy": issue.remedy}
