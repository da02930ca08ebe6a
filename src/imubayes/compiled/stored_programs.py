"""Compiled programs in files, and the loading of those that the last process of the same purpose used.

A file holds the executable and the tree of what it returns.  Loading takes half a second of a repeated command, in code
that leaves the interpreter's lock alone, so that a thread does it while the process imports and reads.  Which programs
a command needs is known once its problem is built; a list of the last time stands in for that.  What is not needed this
time costs a moment of another core.
"""

import atexit
import functools
import hashlib
import os
import pickle
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import jax
from jax.experimental.serialize_executable import deserialize_and_load, serialize
from jaxlib.lapack import prepare_lapack_call

from imubayes.foundations.files import replacing

_DIGEST_BYTES = 32


@dataclass(frozen=True)
class StoredProgram:
    """An executable of flat arrays, loaded from a file.

    Attributes
    ----------
    executable : takes and returns flat arrays.
    skeleton : the returned tree, pickled: to unpickle it may import modules, which a thread beside other imports must
        not.
    """

    executable: jax.stages.Compiled
    skeleton: bytes


def read_content(file: Path) -> bytes | None:
    """Return what a file holds behind its digest; None if there is none, or its file is damaged."""
    try:
        content = file.read_bytes()
        os.utime(file)
    except OSError:
        return None
    digest, content = content[:_DIGEST_BYTES], content[_DIGEST_BYTES:]
    return content if hashlib.sha256(content).digest() == digest else None


def read_program(file: Path) -> StoredProgram | None:
    """Return the program in a file; None if there is none, or its file is damaged."""
    content = read_content(file)
    if content is None:
        return None
    serialised, arguments, results, skeleton = pickle.loads(content)
    taken, given = jax.tree.structure(((0,) * arguments, {})), jax.tree.structure((0,) * results)
    _connect_lapack()
    return StoredProgram(deserialize_and_load(serialised, taken, given), skeleton)


def packed_program(executable: jax.stages.Compiled, arguments: int, results: int, skeleton: bytes) -> bytes | None:
    """Return the content of a program's file; None if jaxlib cannot serialise it.

    Parameters
    ----------
    arguments, results : how many arrays it takes and returns.
    """
    try:
        content = pickle.dumps((serialize(executable)[0], arguments, results, skeleton))
    except (ValueError, TypeError, NotImplementedError, pickle.PicklingError, jax.errors.JaxRuntimeError):
        return None
    return hashlib.sha256(content).digest() + content


def make_room(folder: Path, most_bytes: int) -> None:
    """Remove the files used longest ago if all together exceed a size, until they take half of it."""
    with os.scandir(folder) as entries:
        known = [(entry.stat(), entry.path) for entry in entries]
    found = sorted(((stat.st_mtime, stat.st_size, path) for stat, path in known), reverse=True)
    if sum(size for _, size, _ in found) <= most_bytes:
        return
    kept_bytes = 0
    for _, size, path in found:
        kept_bytes += size
        if kept_bytes > most_bytes / 2:
            Path(path).unlink(missing_ok=True)


def write_program(file: Path, content: bytes) -> None:
    """Write a program's file as a whole."""
    with replacing(file) as scratch:
        scratch.write_bytes(content)


@functools.cache
def _connect_lapack() -> None:
    """Hand the compiled code the routines of LAPACK, which lowering does otherwise."""
    prepare_lapack_call("potrf_ffi", "float64")


class Preloading:
    """Loads the programs of a list, in the order in which they were used; at the exit the list is brought up to date.

    Parameters
    ----------
    folder : of the programs.
    purpose : names the list, as the command that is running.
    """

    def __init__(self, folder: Path, purpose: str):
        self._list = folder / f"{purpose}.used"
        self._used: dict[str, None] = {}
        try:
            self._known = self._list.read_text().split()
        except (OSError, UnicodeDecodeError):
            self._known = []
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="preloading")
        self._pending: dict[str, Future[StoredProgram | None]] = {
            name: self._pool.submit(read_program, folder / name) for name in self._known
        }
        atexit.register(self.remember)

    def read(self, file: Path) -> StoredProgram | None:
        """Return the program in a file, as `read_program` does: loaded ahead, or now."""
        self._used[file.name] = None
        ahead = self._pending.pop(file.name, None)
        return read_program(file) if ahead is None or ahead.cancel() else ahead.result()

    def remember(self) -> None:
        """Write the list of the programs used; nothing if it has not changed, or the folder cannot be written."""
        self._pool.shutdown(wait=False, cancel_futures=True)
        if self._used and list(self._used) != self._known:
            with suppress(OSError), replacing(self._list) as scratch:
                scratch.write_text("\n".join(self._used) + "\n")
