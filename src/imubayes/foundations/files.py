"""Files and folders that appear as a whole or not at all, and places that one process at a time writes to.

What is written stands beside its place first and is then renamed.

A place is locked through an open file: the lock ends with its process, however that ends, and what is left of the file
means nothing.
"""

import fcntl
import glob
import json
import os
import re
import shutil
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

from imubayes.foundations.errors import InputError, input_error

_WRITING = ".writing-"


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
    """Return a free name beside a place; what a process that died left there is removed."""
    scratch = place.with_name(f".{place.name}.{os.getpid()}.part")
    leftover = re.compile(rf"\.{re.escape(place.name)}\.(\d+)\.part")
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

    The file named `last` commits the change: before it is put in place, all others are on the disk.

    Parameters
    ----------
    last : name of the file that is put in place last.
    without : gives the names of files that are removed before that, unless they are written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for left in folder.glob(f"{_WRITING}*"):  # by a process that died: the caller holds the folder
        remove(left)
    scratch = folder / f"{_WRITING}{os.getpid()}"
    scratch.mkdir()
    try:
        yield scratch
        written = sorted(scratch.iterdir())
        for file in written:
            _synchronise(file)
        for file in written:
            if file.name != last:
                os.replace(file, folder / file.name)
        for name in set(without()) - {file.name for file in written}:
            (folder / name).unlink(missing_ok=True)
        _synchronise(folder)
        os.replace(scratch / last, folder / last)
        _synchronise(folder)
    finally:
        shutil.rmtree(scratch, ignore_errors=True)


def interrupted(folder: Path) -> bool:
    """Tell whether a process died, or is at work, while it wrote files of a folder."""
    return any(folder.glob(f"{_WRITING}*"))


def refuse_existing(file: Path, but: Callable[[bytes], bool] = lambda content: False) -> None:
    """Raise InputError where a file or folder exists, except a file whose content may be replaced."""
    if not file.exists() or (file.is_file() and but(file.read_bytes())):
        return
    raise input_error(
        f"'{file.name}' is there already",
        str(file),
        "a file that does not exist yet",
        "choose another name, or remove it first",
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
        where another process, or another thread of this one, holds it.
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
            stream.truncate(0)
            stream.write(f"{os.getpid()}\n")
            stream.flush()
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
