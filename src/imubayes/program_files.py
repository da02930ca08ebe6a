"""Files of compiled programs: the executable, and the tree of what it returns."""

import functools
import hashlib
import os
import pickle
from dataclasses import dataclass
from pathlib import Path

import jax
from jax.experimental.serialize_executable import deserialize_and_load, serialize
from jaxlib.lapack import prepare_lapack_call

from imubayes.atomic_files import replacing

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


def read_program(file: Path) -> StoredProgram | None:
    """Return the program in a file; None where there is none, or its file is damaged."""
    try:
        content = file.read_bytes()
        os.utime(file)
    except OSError:
        return None
    digest, content = content[:_DIGEST_BYTES], content[_DIGEST_BYTES:]
    if hashlib.sha256(content).digest() != digest:
        return None
    serialised, arguments, results, skeleton = pickle.loads(content)
    taken, given = jax.tree.structure(((0,) * arguments, {})), jax.tree.structure((0,) * results)
    _connect_lapack()
    return StoredProgram(deserialize_and_load(serialised, taken, given), skeleton)


def packed_program(executable: jax.stages.Compiled, arguments: int, results: int, skeleton: bytes) -> bytes | None:
    """Return the content of a program's file; None where jaxlib cannot serialise it.

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
    """Remove the files used longest ago where all together exceed a size, until they take half of it."""
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
