"""Files of a result folder: names, typed records, effect files that come along, and the manifest.

A file that is missing from a folder or cannot be read is reported as such.

The manifest says which files belong together, with size and SHA-256 of each, and is the one check that they still do.
Files are written beside their places, committed together with their manifest by one renaming, and then put in place; a
process that is killed leaves the old result or the new one, which the next process that reads or writes completes.
Commands that go on from a result add their files to the manifest in the same way: what is not listed is not of this
result.
"""

import hashlib
import json
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, ValidationError

from imubayes.campaign.campaign_reader import CAMPAIGN_FILE
from imubayes.foundations.errors import InputError, Issue, closest_first, input_error, refuse
from imubayes.foundations.files import PATIENCE, changing, complete_change, only_writer, replacing_files, write_text
from imubayes.foundations.records import Record
from imubayes.model.model_file import read_model
from imubayes.model.trusted_files import trust_files

AGAIN = "run `imubayes fit` again with this folder as --out and --replace"


# Faults of a damaged record that are listed.
_MOST_FAULTS = 3


def damaged(file: Path, reason: object, key: str = "") -> Issue:
    """Return the issue of a file that is there but cannot be read."""
    detail = " ".join(str(reason).split())[:200]
    where = f"{file}, key {key}" if key else str(file)
    return Issue(f"{file.name} cannot be read: {detail}", where, "a complete file, as the fit wrote it", AGAIN)


def read_record[Kept: Record](file: Path, record: type[Kept], absent: Issue | None = None) -> Kept:
    """Read a JSON file of a result folder as its typed record.

    Raises
    ------
    InputError
        with its first faults if it cannot be read; `absent` if there is no such file.
    """
    if absent is not None and not file.is_file():
        raise InputError(absent)
    try:
        return record.model_validate_json(file.read_bytes())
    except OSError as error:
        raise InputError(damaged(file, error)) from error
    except ValidationError as error:
        faults = error.errors()[:_MOST_FAULTS]
        issues = [damaged(file, fault["msg"], ".".join(map(str, fault["loc"]))) for fault in faults]
        raise InputError(issues) from error


SUMMARY = "summary.json"
FIT = "fit.json"  # its mode, with the hashes of data and model
MODEL = "model.toml"  # as it was fitted
RESIDUALS = "residuals.parquet"
POSTERIOR = "posterior.nc"
CHECKPOINT = "checkpoint.h5"
MANIFEST = "manifest.json"  # commits the others, with their hashes
HISTORY = "history.json"  # what was tried on the way to this model
CHANGE, ADDED_VARIABLE = "change.json", "added_variable.parquet"
DIAGNOSIS, BUDGETS, CAUSES = "diagnosis.json", "budgets.json", "causes.json"
"""Made of a finished fit, by other commands."""
PAGE, FIGURES = "compare.html", "figures"
CAPTIONS = "captions.json"
"""In `FIGURES`: the captions of what a comparison drew, by file name."""
DIAGNOSIS_PICTURE, NOISE_PICTURE = "diagnosis.png", "recorded_noise.png"
BY_OTHER_COMMANDS = {DIAGNOSIS: "diagnose", BUDGETS: "report", CAUSES: "compare"}
"""File that is made of a finished fit → the command that makes it."""
_NEEDED = (SUMMARY, RESIDUALS)


def complete(folder: Path) -> None:
    """Complete a change of a result folder that was committed and then interrupted; raises InputError if not."""
    complete_change(folder, MANIFEST)


def missing(folder: Path) -> list[Issue]:
    """Return what keeps a folder from being a result, before any of its files is read."""
    allowed = "a result folder with " + ", ".join(_NEEDED)
    if not folder.exists():
        parent = folder.parent if folder.parent.is_dir() else Path()
        near = sorted(path.parent.name for path in parent.glob(f"*/{SUMMARY}"))
        listed = f"{allowed}; in the same place: {closest_first(folder.name, near)}" if near else allowed
        remedy = "give the folder that a fit wrote (--out)"
        return [Issue("there is no such result folder", str(folder), listed, remedy)]
    if not folder.is_dir():
        return [Issue("this is a file, not a result folder", str(folder), allowed, "name the folder that contains it")]
    if (folder / CAMPAIGN_FILE).is_file() and not (folder / SUMMARY).is_file():
        remedy = "give the folder that a fit of this campaign wrote (--out)"
        return [Issue("this is a campaign folder, not a result folder", str(folder), allowed, remedy)]
    if _only_begun(folder):
        return [Issue("there is no result yet", str(folder / SUMMARY), allowed, way_back(folder))]
    absent = [name for name in _NEEDED if not (folder / name).is_file()]
    return [Issue(f"the result folder has no {name}", str(folder / name), allowed, AGAIN) for name in absent]


def way_back(folder: Path) -> str:
    """Return what to do if a folder holds no result."""
    if _only_begun(folder):
        return "its sampling was interrupted: run the same `imubayes fit` again with --resume"
    return "correct the path, or run the fit again"


def _only_begun(folder: Path) -> bool:
    return (folder / CHECKPOINT).is_file() and not (folder / SUMMARY).is_file()


def trust(place: str | Path) -> tuple[Path, ...]:
    """Remember the effect files of a result folder or a model file, or one such file, as trusted; return them.

    Effect files are code.  They run if the user names their model.  Effect files that come with a result run only if
    they are trusted; a file that was changed has to be trusted again.

    Parameters
    ----------
    place : result folder, model file or effect file.

    Raises
    ------
    InputError
        if they cannot be read.

    Examples
    --------
    >>> import imubayes
    >>> imubayes.trust("models/start.toml")  # it has no effect files
    ()
    """
    place = Path(place)
    if place.is_dir():
        complete(place)
    model = place / MODEL if place.is_dir() else place
    files = (place,) if place.suffix == ".py" else tuple(map(Path, read_model(model).files))
    trust_files(files)
    return files


class KeptFile(Record):
    """A file of a result folder: its name, size in bytes and SHA-256."""

    name: Annotated[str, Field(pattern=r"^[^/\\]*[^/\\.][^/\\]*$")]
    size: int
    sha256: str


class Manifest(Record):
    """The contents of `manifest.json`.

    Attributes
    ----------
    fit : files written with the fit.
    added : files that other commands made of it.
    selection : the highest of the models of a history is the selected one; 0 if it never was.
    """

    format: Literal[1] = 1
    fit: tuple[KeptFile, ...]
    added: tuple[KeptFile, ...] = ()
    selection: int = 0

    @property
    def identity(self) -> str:
        """What identifies the fit: a hash of the digests of its files."""
        return hashlib.sha256("\0".join(f"{file.name} {file.sha256}" for file in self.fit).encode()).hexdigest()

    def holds(self, name: str) -> bool:
        """Return whether a file was written with the fit."""
        return any(file.name == name for file in self.fit)


def checked(folder: Path) -> Manifest:
    """Return the manifest of a result folder whose fit is whole, every file as it was written.

    A change that was committed and then interrupted is completed first.  Sizes are compared every time, digests once in
    a process for a file that has not changed.

    Raises
    ------
    InputError
        if there is no result, or one that is truncated, altered, mixed, or older than manifests.
    """
    return _settled(folder, lambda manifest: _faults(folder, manifest.fit, AGAIN))


def _settled(folder: Path, faults: Callable[[Manifest], list[Issue]]) -> Manifest:
    """Return the manifest of a result without faults; raises InputError with the faults of one that nobody replaces.

    A process that puts files in place while they are looked at leaves another manifest, and is looked at again.
    """
    before = None
    while True:
        complete(folder)
        issues = missing(folder)
        refuse(issues)
        manifest = _read(folder)
        issues = faults(manifest)
        if not issues:
            return manifest
        if manifest == before and not changing(folder):
            raise InputError(issues)
        before = manifest


def added(folder: Path, name: str) -> Path | None:
    """Return a file that another command made of the fit; None if there is none.

    Raises
    ------
    InputError
        as for `checked`, and if such a file is there that is altered or of another fit.
    """
    file = folder / name
    remedy = f"run `imubayes {BY_OTHER_COMMANDS.get(name, 'fit')}` again, or remove the file"

    def faults(manifest: Manifest) -> list[Issue]:
        listed = [each for each in manifest.added if each.name == name]
        found = _faults(folder, manifest.fit, AGAIN) or _faults(folder, listed, remedy)
        if not found and not listed and file.exists():
            allowed = f"the files that {MANIFEST} lists"
            found = [Issue(f"{name} is not of this result", str(file), allowed, remedy)]
        return found

    manifest = _settled(folder, faults)
    return file if any(each.name == name for each in manifest.added) else None


@contextmanager
def replacing_result(folder: Path, selection: int) -> Iterator[Path]:
    """Give a scratch folder whose files become the result in `folder`, instead of the one that is there, if any."""
    with only_writer(folder), replacing_files(folder, MANIFEST, lambda: _names(folder)) as scratch:
        yield scratch
        files = tuple(map(_kept, sorted(scratch.iterdir())))
        write_text(scratch / MANIFEST, Manifest(fit=files, selection=selection).json_text())


def add_to(folder: Path, name: str, text: str, identity: str = "") -> None:
    """Write a file made of the fit in a folder and list it.

    Parameters
    ----------
    identity : of the fit it was made of; that in the folder if empty.

    Raises
    ------
    InputError
        if there is no whole result, or another one by now.
    """
    with only_writer(folder, PATIENCE):
        manifest = same_fit(folder, identity)
        with replacing_files(folder, MANIFEST) as scratch:
            write_text(scratch / name, text)
            files = (*(each for each in manifest.added if each.name != name), _kept(scratch / name))
            write_text(scratch / MANIFEST, manifest.model_copy(update={"added": files}).json_text())


def mark_selected(folder: Path, selection: int) -> None:
    """Keep the number of the selection that made this the selected model of its history."""
    with only_writer(folder, PATIENCE):
        manifest = checked(folder)
        with replacing_files(folder, MANIFEST) as scratch:
            write_text(scratch / MANIFEST, manifest.model_copy(update={"selection": selection}).json_text())


def same_fit(folder: Path, identity: str) -> Manifest:
    """Return the manifest; raises InputError if the folder holds another fit than the one that was read."""
    manifest = checked(folder)
    if identity and manifest.identity != identity:
        raise input_error(
            "the result was replaced since it was read",
            str(folder),
            "a result that stays while a command works with it",
            "run the command again",
        )
    return manifest


def _read(folder: Path) -> Manifest:
    file = folder / MANIFEST
    if not file.is_file():
        what = f"the result folder has no {MANIFEST}: an earlier version made it, or it is incomplete"
        raise input_error(what, str(file), "a folder as `imubayes fit` writes it", AGAIN)
    try:
        return Manifest.model_validate_json(file.read_bytes())
    except (OSError, ValidationError) as error:
        raise InputError(damaged(file, error)) from error


def _faults(folder: Path, listed: Iterable[KeptFile], remedy: str) -> list[Issue]:
    return [issue for file in listed if (issue := _fault(folder, file, remedy)) is not None]


def _fault(folder: Path, listed: KeptFile, remedy: str) -> Issue | None:
    """Return what is wrong with a listed file; None if it is as listed."""
    file = folder / listed.name
    try:
        found = file.stat()
        if found.st_size == listed.size:
            same = _sha256(file, (found.st_ino, found.st_size, found.st_mtime_ns)) == listed.sha256
            what = "" if same else f"{listed.name} was altered since it was written"
        else:
            what = f"{listed.name} has {found.st_size} bytes, not the {listed.size} that were written"
    except FileNotFoundError:
        what = f"{listed.name} is missing"
    if not what:
        return None
    return Issue(what, str(file), f"the file that {folder / MANIFEST} lists", remedy)


def _kept(file: Path) -> KeptFile:
    content = file.read_bytes()
    return KeptFile(name=file.name, size=len(content), sha256=hashlib.sha256(content).hexdigest())


def seal(folder: Path, *names: str) -> None:
    """Write a manifest of files of a folder that is written once, all of them if none is named."""
    files = [folder / name for name in names] or sorted(file for file in folder.iterdir() if file.name != MANIFEST)
    write_text(folder / MANIFEST, Manifest(fit=tuple(map(_kept, files))).json_text())


def unbroken(folder: Path, remedy: str) -> Path:
    """Return a sealed folder.

    Raises
    ------
    InputError
        if a file is missing, truncated or altered, or the folder has no manifest.
    """
    file = folder / MANIFEST
    if not file.is_file():
        what = f"the folder has no {MANIFEST}: an earlier version made it, or it is incomplete"
        raise input_error(what, str(file), "a folder with a manifest of its files", remedy)
    try:
        listed = Manifest.model_validate_json(file.read_bytes()).fit
    except (OSError, ValidationError) as error:
        raise input_error(f"{MANIFEST} cannot be read", str(file), "a manifest as it was written", remedy) from error
    refuse(_faults(folder, listed, remedy))
    return folder


@lru_cache(maxsize=4096)
def _sha256(file: Path, state: tuple[int, int, int]) -> str:
    """Return the digest of a file; `state` is its inode, size and time, by which a change is noticed."""
    with file.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def pictures_compared(folder: Path) -> tuple[str, ...]:
    """Return the names of the files in `FIGURES` that the last comparison of a result drew."""
    try:
        captions = json.loads((folder / FIGURES / CAPTIONS).read_bytes())
    except (OSError, ValueError):
        return ()
    names = captions if isinstance(captions, dict) else ()
    return tuple(name for name in names if Path(name).name == name and name.endswith(".png"))


def _names(folder: Path) -> Iterable[str]:
    """Return the names of all files that belong to an earlier result, whole or not."""
    pictures = (CAPTIONS, DIAGNOSIS_PICTURE, NOISE_PICTURE, *pictures_compared(folder))
    drawn = (f"{FIGURES}/{name}" for name in pictures)
    known = (SUMMARY, RESIDUALS, POSTERIOR, PAGE, *BY_OTHER_COMMANDS, *drawn)
    try:
        manifest = _read(folder)
    except InputError:
        return known
    return (*known, *(file.name for file in (*manifest.fit, *manifest.added)))
