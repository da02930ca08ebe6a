"""Files and folders that appear as a whole or not at all, and places that one process at a time writes to.

Files are written beside their place first and then renamed; files that belong together are committed by one
renaming of them all.

A place is locked through an open file: the lock ends with its process, however that ends, and what is left of the file
means nothing.
"""

import errno
import fcntl
import glob
import json
import os
import re
import shutil
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any

from imubayes.foundations.errors import InputError, Issue, input_error

_WRITING, _COMMITTED, _REMOVED = ".writing-", ".committed", ".removed"
PATIENCE = 5.0
"""Seconds to wait for a process that adds a file: it takes less, a fit longer."""


@contextmanager
def replacing(file: Path, durable: bool = False) -> Iterator[Path]:
    """Give a scratch file beside `file` that replaces it when the block ends; after an error nothing has changed.

    Parameters
    ----------
    durable : whether to force the content to the disk, so that a power failure leaves the old or the new file.
    """
    file.parent.mkdir(parents=True, exist_ok=True)
    scratch = _scratch_of(file)
    try:
        yield scratch
        if durable:
            _synchronise(scratch)
        os.replace(scratch, file)
        if durable:
            _synchronise(file.parent)
    finally:
        scratch.unlink(missing_ok=True)


def _scratch_of(place: Path) -> Path:
    """Return a free name beside a place, of this thread; what a process that died left there is removed."""
    scratch = place.with_name(f".{place.name}.{os.getpid()}.{threading.get_ident()}.part")
    leftover = re.compile(rf"\.{re.escape(place.name)}\.(\d+)(?:\.\d+)?\.part")
    for found in place.parent.glob(f".{glob.escape(place.name)}.*.part"):
        by = leftover.fullmatch(found.name)
        if by is not None and (found == scratch or not _alive(int(by.group(1)))):
            remove(found)
    return scratch


def _alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:  # of another user
        return True
    return True


def remove(path: Path) -> None:
    """Remove a file or a folder with all that is in it."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)


def _synchronise(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def write_text(file: Path, text: str) -> None:
    """Write a text file; folders above it are made."""
    with replacing(file) as scratch:
        scratch.write_text(text, encoding="utf-8")


def write_json(file: Path, value: Any) -> None:
    """Write a JSON file; raises ValueError for a non-finite number."""
    write_text(file, json.dumps(value, indent=1, ensure_ascii=False, allow_nan=False) + "\n")


@contextmanager
def new_folder(folder: Path, durable: bool = False) -> Iterator[Path]:
    """Give a scratch folder beside `folder` that takes its place when the block ends; after an error nothing is left.

    `folder` must not exist, or be empty.

    Parameters
    ----------
    durable : whether to force the content to the disk, so that a power failure leaves the whole folder or none.
    """
    folder.parent.mkdir(parents=True, exist_ok=True)
    scratch = _scratch_of(folder)
    scratch.mkdir()
    try:
        yield scratch
        if durable:
            for place in (*scratch.iterdir(), scratch):
                _synchronise(place)
        os.rename(scratch, folder)
        if durable:
            _synchronise(folder.parent)
    finally:
        shutil.rmtree(scratch, ignore_errors=True)


@contextmanager
def replacing_files(folder: Path, last: str, without: Callable[[], Iterable[str]] = tuple) -> Iterator[Path]:
    """Give a scratch folder whose files replace those of `folder` when the block ends; its other files stay.

    Once all of them are on the disk, the scratch folder gets the name of a change that is committed.  A process that
    dies before that leaves the old files, one that dies after it the new ones: `complete_change` puts them in place.
    The caller holds the folder.

    Parameters
    ----------
    last : name of the file that is put in place last.
    without : gives the names of files that are removed, unless they are written.
    """
    complete_change(folder, last)
    folder.mkdir(parents=True, exist_ok=True)
    for left in folder.glob(f"{_WRITING}*"):  # by a process that died
        remove(left)
    scratch = folder / f"{_WRITING}{os.getpid()}"
    scratch.mkdir()
    try:
        yield scratch
        removed = sorted(set(without()) - {file.name for file in scratch.iterdir()})
        (scratch / _REMOVED).write_text("\0".join(removed), encoding="utf-8")
        for place in (*scratch.iterdir(), scratch):
            _synchronise(place)
        os.rename(scratch, folder / _COMMITTED)
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
    _synchronise(folder)
    complete_change(folder, last)


def complete_change(folder: Path, last: str) -> None:
    """Put in place the files of a change that a process has committed and not completed, by `last` after the others.

    Without such a change nothing is done.  A process that is at work is waited for.

    Raises
    ------
    InputError
        if that process does not end, this one may not write, or something else is in the way.
    """
    committed, until = folder / _COMMITTED, time.monotonic() + PATIENCE
    while _is_change(committed):
        try:
            with only_writer(folder):
                _put_in_place(committed, last)
        except (InputError, OSError) as error:
            if time.monotonic() < until:
                time.sleep(_PAUSE)
            elif isinstance(error, InputError):
                raise
            else:
                raise _incomplete(folder, error) from error


def changing(folder: Path) -> bool:
    """Return whether the files of a committed change are being put in place, or wait for it."""
    return (folder / _COMMITTED).exists()


def _is_change(committed: Path) -> bool:
    """Return whether there is a change; a link, which would move the files of another place, is refused."""
    if committed.is_symlink() or committed.is_file():
        raise input_error(
            f"{committed.name} is not a folder: no process of imubayes made it",
            str(committed),
            "a folder with the files of a change, or nothing",
            "remove it",
        )
    return committed.is_dir()


def _incomplete(folder: Path, error: OSError) -> InputError:
    target = Path(error.filename2 or error.filename or folder)
    if error.errno in (errno.EISDIR, errno.ENOTEMPTY, errno.EEXIST, errno.ENOTDIR):
        return input_error(
            "the last change of this folder was interrupted and cannot be completed: a folder is in the way",
            str(target),
            "a file, or nothing",
            "move that folder elsewhere; the change is kept until then",
        )
    return input_error(
        f"the last change of this folder was interrupted and cannot be completed: {error.strerror or error}",
        str(target),
        "a folder that this process may write to",
        "run the command as a user who may write there; the change is kept until then",
    )


def _put_in_place(committed: Path, last: str) -> None:
    """Rename the files of a committed change; what a process that died has renamed already is passed over."""
    folder, listed = committed.parent, committed / _REMOVED
    written = sorted((file for file in committed.glob("*") if file != listed), key=lambda file: file.name == last)
    for file in written:
        if file.name == last:
            _synchronise(folder)
        os.replace(file, folder / file.name)
    names = listed.read_text(encoding="utf-8", errors="replace").split("\0") if listed.is_file() else ()
    for place in (folder / name for name in names if name):
        # A folder may come from elsewhere: nothing outside of it is removed.
        with suppress(OSError):  # it is no file, or lies in a folder of another user
            if place.parent.resolve().is_relative_to(folder.resolve()):
                place.unlink(missing_ok=True)
    _synchronise(folder)
    shutil.rmtree(committed)


def not_utf8(file: Path) -> Issue:
    """Return the issue of a file that is not UTF-8 text, with the first line that is not."""
    place = str(file)
    with file.open("rb") as stream:
        for number, line in enumerate(stream, start=1):
            try:
                line.decode("utf-8")
            except UnicodeDecodeError:
                place = f"{file}:{number}"
                break
    return Issue(
        "the line contains a character that is not UTF-8 text",
        place,
        "UTF-8; an editor may have saved the file as Latin-1, Windows-1252 or UTF-16",
        "save the file again with the encoding UTF-8",
    )


def refuse_existing(file: Path, but: Callable[[bytes], bool] = lambda content: False) -> None:
    """Raise InputError if a file or folder exists, except a file whose content may be replaced."""
    if not file.exists() or (file.is_file() and but(file.read_bytes())):
        return
    raise input_error(
        f"'{file.name}' is there already",
        str(file),
        "a file that does not exist yet",
        "choose another name, or remove it first",
    )


def refuse_occupied(out: Path) -> None:
    """Raise an `InputError` if the folder is not empty, or is a file."""
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise input_error(
            f"'{out}' exists and is not an empty folder",
            str(out),
            "a folder that does not exist yet, or an empty one",
            "choose another name, or remove the folder first",
        )


_LOCK = ".lock"
_PAUSE = 0.05
_held: set[tuple[Path, int]] = set()


@contextmanager
def only_writer(place: Path, patience: float = 0.0) -> Iterator[None]:
    """Hold a folder, or a file to be written, for writing; what holds it already may hold it again.

    Parameters
    ----------
    patience : seconds to wait for another one to end.

    Raises
    ------
    InputError
        if another process, or another thread of this one, holds it.
    """
    file = place / _LOCK if place.is_dir() else place.with_name(f".{place.name}{_LOCK}")
    key = (file.resolve(), threading.get_ident())
    if key in _held:
        yield
        return
    file.parent.mkdir(parents=True, exist_ok=True)
    stream = _locked(file, place, time.monotonic() + patience)
    _held.add(key)
    try:
        yield
    finally:
        _held.discard(key)
        file.unlink(missing_ok=True)
        stream.close()


def remove_abandoned(folder: Path) -> None:
    """Remove a folder that holds nothing but the lock of a process that was killed before it wrote a file."""
    with suppress(OSError, InputError):
        if [file.name for file in folder.iterdir()] == [_LOCK]:
            with only_writer(folder):  # whose holder is gone: the lock is removed
                pass
            folder.rmdir()


def _locked(file: Path, place: Path, until: float) -> IO[str]:
    while True:
        stream = file.open("a+", encoding="ascii")
        try:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            refusal = _refusal(stream, place, error)
            stream.close()
            if not isinstance(error, BlockingIOError) or time.monotonic() >= until:
                raise refusal from error
            time.sleep(_PAUSE)
            continue
        if _still_there(file, stream):
            with suppress(OSError):  # the disk is full: no message says who holds the place
                stream.truncate(0)
                os.write(stream.fileno(), f"{os.getpid()}\n".encode())
            return stream
        stream.close()  # its holder has removed it meanwhile


def _still_there(file: Path, stream: IO[str]) -> bool:
    try:
        return os.path.samestat(file.stat(), os.fstat(stream.fileno()))
    except FileNotFoundError:
        return False


def _refusal(stream: IO[str], place: Path, error: OSError) -> InputError:
    if not isinstance(error, BlockingIOError):
        return input_error(
            f"it cannot be locked: {error.strerror}",
            str(place),
            "a place on a file system with locks",
            "choose another --out",
        )
    stream.seek(0)
    holder = stream.read().strip()
    return input_error(
        f"another process is writing here{f' (process {holder})' if holder else ''}",
        str(place),
        "one process at a time",
        "wait until it has ended, or choose another --out",
    )
