"""Report of `imubayes archive`: which campaigns were packed, which an archive holds, and its damage."""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from imubayes.display.layout import Report, Sheet, cells
from imubayes.foundations.errors import Issue
from imubayes.foundations.wording import counted
from imubayes_archive.dataset import ArchivedCampaign, Packed


def packed_report(packed: Packed, out: Path) -> Report:
    """Return what packing did."""
    said = f"{counted(len(packed.added), 'campaign')} added to {out}, {packed.present} already in it"
    refused = [str(issue) for refusal in packed.refused for issue in refusal.issues]
    if packed.refused:
        were = "was" if len(packed.refused) == 1 else "were"
        refused.append(f"{counted(len(packed.refused), 'folder')} cannot be used and {were} left out")
    return Report([said], closing=refused)


def packed_json(packed: Packed) -> dict[str, Any]:
    """Return what packing did, for `--json`."""
    refused = [{"folder": each.folder, "issues": [asdict(issue) for issue in each.issues]} for each in packed.refused]
    added = [_entry(each) for each in packed.added]
    return {"format": 1, "added": added, "present": packed.present, "refused": refused}


def list_report(campaigns: Sequence[ArchivedCampaign]) -> Report:
    """Return the campaigns of an archive as a table."""
    ordered = sorted(campaigns, key=lambda each: (each.unit, each.date, each.name))
    rows = [
        cells(each.unit, each.name, each.date or "–", str(each.runs), str(each.rows),
         str(each.channels), each.digest[:16])
        for each in ordered
    ]  # fmt: skip
    units = len({each.unit for each in campaigns})
    head = ("unit", "campaign", "date", "runs", "rows", "channels", "digest")
    said = f"{counted(len(campaigns), 'campaign')} of {counted(units, 'unit')}"
    return Report([said], [Sheet("Campaigns", head, rows, left=(0, 1, 2, 6))])


def list_json(campaigns: Sequence[ArchivedCampaign]) -> dict[str, Any]:
    """Return the campaigns of an archive, for `--json`."""
    return {"format": 1, "campaigns": [_entry(each) for each in campaigns]}


def archive_check(files: int, issues: Sequence[Issue]) -> Report:
    """Return what is wrong with an archive."""
    said = f"{counted(files, 'campaign')} checked: " + (counted(len(issues), "problem") if issues else "all intact")
    return Report([said], closing=[str(issue) for issue in issues])


def check_json(files: int, issues: Sequence[Issue]) -> dict[str, Any]:
    """Return what is wrong with an archive, for `--json`."""
    return {"format": 1, "campaigns": files, "issues": [asdict(issue) for issue in issues]}


def _entry(each: ArchivedCampaign) -> dict[str, Any]:
    return {
        "unit": each.unit, "campaign": each.name, "date": each.date, "file": str(each.file), "digest": each.digest,
        "runs": each.runs, "rows": each.rows, "channels": each.channels, "checksum": each.checksum,
    }  # fmt: skip
