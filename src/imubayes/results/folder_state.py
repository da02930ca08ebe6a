"""Contents of a result folder: names of its files, whether it can take a result, and the faults of one."""

import json
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from imubayes.foundations.errors import input_error
from imubayes.foundations.files import only_writer
from imubayes.inference.checkpoint import steps_in
from imubayes.results.folder_files import CHECKPOINT, FIT, POSTERIOR, SUMMARY, complete


@contextmanager
def claimed(folder: Path | None, resume: bool = False, replace: bool = False) -> Iterator[None]:
    """Hold a folder for a result until the block ends; without a folder there is nothing to hold.

    Raises
    ------
    InputError
        as for `claim`, and if another process writes to it.
    """
    if folder is None:
        yield
        return
    claim(folder, resume, replace)
    made = [place for place in (folder, *folder.parents) if not place.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    try:
        with only_writer(folder):
            claim(folder, resume, replace)  # as it is now, after whoever held it
            yield
    finally:
        with suppress(OSError):  # nothing was written
            for place in made:
                place.rmdir()


def claim(folder: Path, resume: bool = False, replace: bool = False) -> None:
    """Make sure that a folder can take a result, before anything is computed.

    Raises
    ------
    InputError
        if it holds files but no result, a sampling that was interrupted and is not to be resumed, or a sampled
        result that is not to be replaced; if an interrupted change cannot be completed.
    """
    complete(folder)
    if folder.is_dir():
        held = [file.name for file in folder.iterdir() if not file.name.startswith(".")]
        if held and not any((folder / name).is_file() for name in (FIT, CHECKPOINT)):
            raise input_error(
                f"the folder holds '{min(held)}' and no result",
                str(folder),
                "a folder that does not exist yet, an empty one, or one with a result, which is replaced",
                "choose another --out",
            )
        if not resume and _interrupted(folder):
            raise input_error(
                "the folder holds a sampling that was interrupted",
                str(folder / CHECKPOINT),
                "the same fit with --resume, which continues it",
                f"add --resume; to start again choose another --out, or remove {folder / CHECKPOINT}",
            )
        if not (resume or replace) and (folder / POSTERIOR).is_file() and _sampled(folder):
            raise input_error(
                "the folder holds a sampled result",
                str(folder),
                "a folder that does not exist yet, an empty one, or a result that was not sampled",
                f"choose another --out, or add --replace (in Python replace=True), which deletes {folder / POSTERIOR}",
            )


@contextmanager
def claimed_new(folder: Path | None, parent: Path | None) -> Iterator[None]:
    """Hold a folder for the model after `parent`; raises InputError if it holds a result."""
    if folder is None:
        yield
        return
    refuse_taken(folder, parent)
    with claimed(folder, resume=True):
        refuse_taken(folder, parent)
        yield


def refuse_taken(folder: Path, parent: Path | None) -> None:
    """Raise InputError if a folder holds a result."""
    complete(folder)
    if (folder / FIT).exists() or (parent is not None and folder.resolve() == parent.resolve()):
        raise input_error(
            "the folder already contains a result",
            str(folder),
            "a folder without a result",
            "choose another --out, or remove the folder",
        )


def _sampled(folder: Path) -> bool:
    """Return whether the result of a folder was sampled; one that cannot be read is taken for sampled."""
    try:
        return json.loads((folder / SUMMARY).read_bytes()).get("sampled") is not False
    except (OSError, ValueError, AttributeError):
        return True


def _interrupted(folder: Path) -> bool:
    """Return whether a folder holds a sampling of which there is no result."""
    checkpoint, summary = folder / CHECKPOINT, folder / SUMMARY
    if not steps_in(checkpoint):
        return False
    return not summary.is_file() or summary.stat().st_mtime_ns < checkpoint.stat().st_mtime_ns
