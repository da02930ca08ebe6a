"""The campaigns of a batch: the files of an archive, or campaign folders, by the digest of their content.

A campaign is known by the first digits of the SHA-256 of the files it was recorded in, which an archive has in the
names of its files: what is done already is told without opening one.
"""

import datetime
import hashlib
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import unquote

from imubayes.archive.campaign_file import date_of, read_campaign, unit_of
from imubayes.archive.store import Archive, campaign_folders, folder_digest
from imubayes.batch.posterior_table import UnitIdentity
from imubayes.campaign import load_campaign
from imubayes.campaign_data import Campaign
from imubayes.errors import input_error

DIGITS = 16
"""Digits of a digest that identify a campaign."""


@dataclass(frozen=True)
class UnitSource:
    """Where a campaign is: a file of an archive or a folder; `digest` has `DIGITS` digits."""

    digest: str
    unit: str
    name: str
    path: str
    archived: bool

    def read(self) -> Campaign:
        """Return the campaign; raises InputError where it cannot be used."""
        return read_campaign(Path(self.path)) if self.archived else load_campaign(self.path)

    def fingerprint(self) -> str:
        """Return a digest of what stands there now, whatever it is; empty where it is gone."""
        path = Path(self.path)
        try:
            return hashlib.sha256(path.read_bytes()).hexdigest()[:DIGITS] if self.archived else folder_digest(path)
        except OSError:
            return ""


def sources_of(place: str | Path) -> list[UnitSource]:
    """Return the campaigns of an archive, or in and below a folder, each once, ordered by unit.

    Raises
    ------
    InputError
        where there is none.
    """
    files = Archive(Path(place)).files()
    found = _archived(files) if files else _folders(place)
    return sorted({source.digest: source for source in reversed(list(found))}.values(), key=_order)


def _order(source: UnitSource) -> tuple[str, str]:
    return source.unit, source.path


def _archived(files: Sequence[Path]) -> Iterator[UnitSource]:
    for file in files:
        name, digest = file.stem[: -DIGITS - 1], file.stem[-DIGITS:]
        yield UnitSource(digest, unquote(file.parent.name.removeprefix("unit=")), name, str(file), True)


def _folders(place: str | Path) -> Iterator[UnitSource]:
    try:
        folders = campaign_folders([place])
    except OSError as error:
        raise input_error(
            f"the folder cannot be read: {error.strerror}", str(place), "a readable folder", "correct its permissions"
        ) from error
    for folder in folders:
        yield UnitSource(folder_digest(folder)[:DIGITS], folder.name, folder.name, str(folder), False)


def identity_of(campaign: Campaign, source: UnitSource, structure: str = "") -> UnitIdentity:
    """Return which campaign it is, on which equipment and where."""
    return UnitIdentity(
        unit=unit_of(campaign),
        campaign=campaign.name,
        digest=source.digest,
        file=source.path,
        date=_date(date_of(campaign)),
        structure=structure,
        tables=tuple(sorted({run.table for run in campaign.runs if run.table})),
        mountings=tuple(sorted({run.mounting for run in campaign.runs if run.mounting})),
        procedures=tuple(sorted({run.procedure for run in campaign.runs})),
        latitude=math.degrees(campaign.site.latitude),
        height=campaign.site.height,
        gravity=campaign.site.gravity,
    )


def unread(source: UnitSource) -> UnitIdentity:
    """Return what is known of a campaign that cannot be read."""
    return UnitIdentity(source.unit, source.name, source.digest, source.path)


def _date(text: str) -> datetime.date | None:
    try:
        return datetime.date.fromisoformat(text)
    except ValueError:
        return None
