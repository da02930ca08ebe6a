"""The manifest of a result folder: which files belong together, and the one check that they still do.

Files are written beside their places and renamed one by one; the manifest, with size and SHA-256 of each, is renamed
last and commits them.  A folder that was left in between holds files that its manifest does not list as they are, and
is refused.  Commands that go on from a result add their files to the manifest in the same way: what is not listed is
not of this result.
"""

import hashlib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, ValidationError

from imubayes.atomic_files import interrupted, replacing_files, write_text
from imubayes.errors import InputError, Issue, input_error
from imubayes.json_record import Record
from imubayes.process_lock import only_writer
from imubayes.results.record_files import AGAIN, damaged
from imubayes.results.record_names import BY_OTHER_COMMANDS, MANIFEST, PAGE, POSTERIOR, RESIDUALS, SUMMARY, missing

# Seconds that a file waits to be added: another one is added in less, a fit takes longer.
_PATIENCE = 5.0


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
    selection : the highest of the models of a history is the selected one; 0 where it never was.
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
        """Tell whether a file was written with the fit."""
        return any(file.name == name for file in self.fit)


def checked(folder: Path) -> Manifest:
    """Return the manifest of a result folder whose fit is whole, every file as it was written.

    Sizes are compared every time, digests once in a process for a file that has not changed.

    Raises
    ------
    InputError
        where there is no result, or one that is truncated, altered, mixed, or older than manifests.
    """
    issues = missing(folder)
    if issues:
        raise InputError(issues)
    manifest = _read(folder)
    issues = [issue for file in manifest.fit if (issue := _fault(folder, file, AGAIN)) is not None]
    if issues:
        raise InputError(issues)
    return manifest


def added(folder: Path, name: str) -> Path | None:
    """Return a file that another command made of the fit; None where there is none.

    Raises
    ------
    InputError
        as for `checked`, and where such a file is there that is altered or of another fit.
    """
    manifest, file = checked(folder), folder / name
    listed = next((each for each in manifest.added if each.name == name), None)
    remedy = f"run `imubayes {BY_OTHER_COMMANDS.get(name, 'fit')}` again, or remove the file"
    if listed is None:
        if not file.exists():
            return None
        raise input_error(f"{name} is not of this result", str(file), f"the files that {MANIFEST} lists", remedy)
    issue = _fault(folder, listed, remedy)
    if issue is not None:
        raise InputError(issue)
    return file


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
    identity : of the fit it was made of; that in the folder where empty.

    Raises
    ------
    InputError
        where there is no whole result, or another one by now.
    """
    with only_writer(folder, _PATIENCE):
        manifest = same_fit(folder, identity)
        with replacing_files(folder, MANIFEST) as scratch:
            write_text(scratch / name, text)
            files = (*(each for each in manifest.added if each.name != name), _kept(scratch / name))
            write_text(scratch / MANIFEST, manifest.model_copy(update={"added": files}).json_text())


def mark_selected(folder: Path, selection: int) -> None:
    """Keep the number of the selection that made this the selected model of its history."""
    with only_writer(folder, _PATIENCE):
        manifest = checked(folder)
        with replacing_files(folder, MANIFEST) as scratch:
            write_text(scratch / MANIFEST, manifest.model_copy(update={"selection": selection}).json_text())


def same_fit(folder: Path, identity: str) -> Manifest:
    """Return the manifest; raises InputError where the folder holds another fit than the one that was read."""
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
        what = (
            "its writing was interrupted" if interrupted(folder) else "an earlier version made it, or it is not whole"
        )
        raise input_error(
            f"the result folder has no {MANIFEST}: {what}", str(file), "a folder as `imubayes fit` writes it", AGAIN
        )
    try:
        return Manifest.model_validate_json(file.read_bytes())
    except (OSError, ValidationError) as error:
        raise InputError(damaged(file, error)) from error


def _fault(folder: Path, listed: KeptFile, remedy: str) -> Issue | None:
    """Return what is wrong with a listed file; None where it is as listed."""
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
    if interrupted(folder):
        what = f"the writing of this result was interrupted, its files do not belong together: {what}"
    return Issue(what, str(file), f"the file that {folder / MANIFEST} lists", remedy)


def _kept(file: Path) -> KeptFile:
    content = file.read_bytes()
    return KeptFile(name=file.name, size=len(content), sha256=hashlib.sha256(content).hexdigest())


@lru_cache(maxsize=4096)
def _sha256(file: Path, state: tuple[int, int, int]) -> str:
    """Return the digest of a file; `state` is its inode, size and time, by which a change is noticed."""
    with file.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _names(folder: Path) -> Iterable[str]:
    """Return the names of all files that tell of an earlier result, whole or not."""
    known = (SUMMARY, RESIDUALS, POSTERIOR, PAGE, *BY_OTHER_COMMANDS)
    try:
        manifest = _read(folder)
    except InputError:
        return known
    return (*known, *(file.name for file in (*manifest.fit, *manifest.added)))
