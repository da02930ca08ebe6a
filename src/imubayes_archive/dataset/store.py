"""The archive: a folder of Parquet files, `unit=<serial>/<date>-<name>-<digest>.parquet`.

The files are the only truth: there is no index that could disagree with them.  Packing adds files and rewrites none; a
file appears as a whole or not at all.  DuckDB, Polars and pandas read the folder as a dataset partitioned by `unit`.
"""

import hashlib
import re
import tomllib
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

from imubayes.campaign.campaign_reader import CAMPAIGN_FILE, inspect_campaign, source_digest
from imubayes.foundations.campaign_data import Campaign
from imubayes.foundations.errors import InputError, Issue, input_error, refuse
from imubayes.foundations.files import replacing
from imubayes.foundations.progress import counted, silent
from imubayes_archive.dataset import campaign_file

_DIGITS = 16
_THREADS = 4
_PATTERN = "unit=*/*.parquet"


@dataclass(frozen=True)
class Refusal:
    """A campaign folder that cannot be used, with the reasons and a digest of what was found there."""

    folder: str
    issues: tuple[Issue, ...]
    digest: str


@dataclass(frozen=True)
class Packed:
    """What packing did.

    Attributes
    ----------
    added : the campaigns written, in order.
    present : how many the archive held already.
    refused : the folders that cannot be used.
    """

    added: tuple[campaign_file.ArchivedCampaign, ...]
    present: int
    refused: tuple[Refusal, ...]


@dataclass(frozen=True)
class Archive:
    """An archive of campaigns, by its folder."""

    folder: Path

    def files(self) -> list[Path]:
        """Return the files of all campaigns, in the order of their paths."""
        return sorted(self.folder.glob(_PATTERN))

    def heads(self) -> list[campaign_file.ArchivedCampaign | InputError]:
        """Return what the metadata of every file say, or why they cannot be read, in the order of `files`."""
        with ThreadPoolExecutor(_THREADS) as pool:
            return list(pool.map(_head_or_error, self.files()))

    def campaigns(self) -> list[campaign_file.ArchivedCampaign]:
        """Return the campaigns, in the order of `files`; raises InputError for files that cannot be read."""
        heads = self.heads()
        refuse(issue for head in heads if isinstance(head, InputError) for issue in head.issues)
        return [head for head in heads if not isinstance(head, InputError)]

    def read(self, campaign: campaign_file.ArchivedCampaign) -> Campaign:
        """Return a campaign; raises InputError for a damaged file."""
        return campaign_file.read_campaign(campaign.file)

    def check(self, progress: Callable[[str], None] | None = None) -> tuple[Issue, ...]:
        """Return what is wrong with the files: content, checksum, name and place."""
        issues: list[Issue] = []
        files = self.files()
        for file in counted(progress or silent, "checking", files):
            try:
                head = campaign_file.read_head(file)
                expected = file_of(self.folder, campaign_file.read_campaign(file))
                if expected != file:
                    issues.append(_misplaced(head, expected))
            except InputError as error:
                issues.extend(error.issues)
        strays = {file for file in self.folder.rglob("*") if file.is_file()} - set(files)
        return (*issues, *(_stray(file) for file in sorted(strays)))


def open_archive(folder: str | Path) -> Archive:
    """Return the archive in a folder; raises InputError if there is none."""
    archive = Archive(Path(folder))
    if not archive.files():
        raise input_error(
            "the folder holds no archive of campaigns",
            str(folder),
            "a folder that `imubayes archive pack` has written",
            "imubayes archive pack FOLDER --out ARCHIVE",
        )
    return archive


def file_of(folder: Path, campaign: Campaign) -> Path:
    """Return the file of a campaign in an archive."""
    name = re.sub(r"[^A-Za-z0-9._-]+", "_", campaign.name)
    stem = "-".join(part for part in (campaign_file.date_of(campaign), name, campaign.digest[:_DIGITS]) if part)
    return folder / f"unit={quote(campaign_file.unit_of(campaign), safe=' ')}" / f"{stem}.parquet"


def campaign_folders(places: Iterable[str | Path]) -> list[Path]:
    """Return the campaign folders at or below some places; raises InputError for a place without any."""
    found: dict[Path, None] = {}
    issues = []
    for place in map(Path, places):
        here = [place] if (place / CAMPAIGN_FILE).is_file() else sorted(f.parent for f in place.rglob(CAMPAIGN_FILE))
        found.update(dict.fromkeys(here))
        if not here:
            what = "there is no campaign below the folder" if place.is_dir() else "there is no such folder"
            allowed = f"a folder with {CAMPAIGN_FILE}, or a folder that contains such folders"
            issues.append(Issue(what, str(place), allowed, "correct the path"))
    refuse(issues)
    return list(found)


def pack(folders: Sequence[Path], out: Path, progress: Callable[[str], None] | None = None) -> Packed:
    """Add campaign folders to an archive.

    Parameters
    ----------
    folders : campaign folders; those that the archive holds, by the digest of their files, are passed over.
    out : the archive, made if there is none.
    progress : called with a short text as the work goes on.
    """
    archive, tell = Archive(out), progress or (lambda text: None)
    known = {file.stem[-_DIGITS:] for file in archive.files()}
    added, refused, present = [], [], 0
    for folder in counted(tell, "packing", folders):
        digest = folder_digest(folder)
        if digest[:_DIGITS] in known:
            present += 1
            continue
        inspection = inspect_campaign(folder)
        if inspection.campaign is None:
            refused.append(Refusal(str(folder), inspection.issues, digest))
            continue
        added.append(campaign_file.read_head(_kept(inspection.campaign, out)))
        known.add(digest[:_DIGITS])
    return Packed(tuple(added), present, tuple(refused))


def pack_campaigns(campaigns: Iterable[Campaign], out: Path) -> Archive:
    """Return an archive to which campaigns in memory were added; those that it holds are passed over."""
    for campaign in campaigns:
        if not file_of(out, campaign).exists():
            _kept(campaign, out)
    return Archive(out)


def _kept(campaign: Campaign, out: Path) -> Path:
    file = file_of(out, campaign)
    with replacing(file, durable=True) as scratch:
        campaign_file.write_campaign(campaign, scratch)
    return file


def folder_digest(folder: Path) -> str:
    """Return the digest of the files of a campaign folder.

    Runs whose files are missing are left out; it is that of the campaign file alone if its runs are not known.
    """
    file = folder / CAMPAIGN_FILE
    try:
        files = [folder / run["file"] for run in tomllib.loads(file.read_text(encoding="utf-8"))["run"]]
        return source_digest([file, *(each for each in files if each.is_file())])
    except (OSError, ValueError, KeyError, TypeError):
        return hashlib.sha256(file.read_bytes()).hexdigest()


def _head_or_error(file: Path) -> campaign_file.ArchivedCampaign | InputError:
    try:
        return campaign_file.read_head(file)
    except InputError as error:
        return error


def _misplaced(head: campaign_file.ArchivedCampaign, expected: Path) -> Issue:
    return Issue(
        f"the file of campaign '{head.name}' of unit '{head.unit}' is missing from its folder",
        str(head.file),
        str(expected),
        "move the file there, or pack the campaign again",
    )


def _stray(file: Path) -> Issue:
    interrupted = file.name.endswith(".part")
    return Issue(
        "an interrupted write has left a file" if interrupted else "the file does not belong to the archive",
        str(file),
        "campaign files alone",
        "remove it; `imubayes archive pack` writes the campaign again" if interrupted else "move it elsewhere",
    )
