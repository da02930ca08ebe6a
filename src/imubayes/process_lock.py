"""Places that one process at a time writes to.

The lock is on an open file: it ends with its process, however that ends, and what is left of the file means nothing.
"""

import fcntl
import os
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from imubayes.errors import InputError, input_error

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
