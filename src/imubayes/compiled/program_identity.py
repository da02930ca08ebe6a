"""The identity of a compiled program: a digest of everything that its tracing and its compilation read.

Two calls of one identity trace to the same program.  Arrays that are arguments enter by shape and type, all other parts
of the arguments by value; functions and classes by name, with the sources they stand in.  What cannot be identified
beyond the process has no identity: a closure, a class made at run time, and whatever a user's file defines, as the file
may read others.
"""

import dataclasses
import enum
import functools
import hashlib
import importlib.metadata
import inspect
import os
import platform
import sys
from collections.abc import Callable
from pathlib import Path
from types import FunctionType
from typing import Any

import jax
import numpy as np
from jax._src import config, core

_PACKAGE = Path(__file__).parents[1]
_PLAIN = (type(None), bool, int, float, complex, str, bytes)
_LIBRARIES = ("jax", "jaxlib", "equinox", "optimistix", "lineax", "numpy", "scipy")
_KNOWN = {*_LIBRARIES, "builtins", "functools", "operator", "math", "typing", "enum"}


class NoIdentityError(Exception):
    """A part of the arguments means something in this process only."""


@dataclasses.dataclass(frozen=True)
class Slot:
    """The place of an array argument."""

    number: int
    shape: tuple[int, ...]
    dtype: str
    weak: bool

    @classmethod
    def of(cls, number: int, array: Any) -> "Slot":
        """Return the place of an array among the array arguments."""
        return cls(number, tuple(array.shape), str(array.dtype), bool(getattr(array, "weak_type", False)))


def identity(function: Callable, arguments: Any) -> str:
    """Return the digest of a function called with a tree whose arrays are `Slot`s.

    Raises
    ------
    NoIdentityError
        if another process could mean another program by the same names.
    """
    parts = (_name(function), describe(arguments), _settings(), _surroundings(), _sources())
    return hashlib.sha256(repr(parts).encode()).hexdigest()


def describe(value: Any) -> Any:
    """Return nested tuples of plain values that distinguish `value` from every other; NoIdentityError if none can."""
    kind = type(value)
    if kind in _PLAIN:
        return value
    if kind is Slot:
        return "slot", value.number, value.shape, value.dtype, value.weak
    if kind in (tuple, list):
        return kind.__name__, *map(describe, value)
    if kind is dict:
        return "dict", *sorted((repr(describe(key)), describe(item)) for key, item in _by_text(value))
    if kind in (set, frozenset):
        return kind.__name__, *sorted(repr(describe(item)) for item in value)
    if isinstance(value, enum.Enum):
        return _name(kind), value.name
    if isinstance(value, type | FunctionType):
        return "name", _name(value)
    if isinstance(value, np.dtype):
        return "dtype", value.str
    if kind in (functools.partial, jax.tree_util.Partial):
        return _name(kind), describe(value.func), describe(value.args), describe(value.keywords)
    if isinstance(value, np.ndarray | np.generic | jax.Array):
        return "constant", value.shape, str(value.dtype), np.asarray(value).tobytes()
    return _record(value, kind)


def _record(value: Any, kind: type) -> Any:
    if dataclasses.is_dataclass(kind):
        fields = (field.name for field in dataclasses.fields(value))
        return _name(kind), *((name, describe(getattr(value, name, None))) for name in fields)
    if issubclass(kind, tuple):
        return _name(kind), *map(describe, value)
    raise NoIdentityError(f"a {kind.__qualname__}")


def _by_text(value: dict) -> list[tuple[Any, Any]]:
    return sorted(value.items(), key=lambda item: repr(item[0]))


def _name(thing: Any) -> str:
    """Return module and name of a function or class that another process finds under them, with the same meaning."""
    module, name = thing.__module__, thing.__qualname__
    home = sys.modules.get(module)
    found: Any = home
    for part in name.split("."):
        found = getattr(found, part, None)
    # What is kept has the function in it.
    if found is None or inspect.unwrap(getattr(found, "function", found)) is not inspect.unwrap(thing):
        raise NoIdentityError(f"{module}.{name} is not found by its name")
    top = module.partition(".")[0]
    own = top == "imubayes" and (getattr(home, "__file__", None) or "").startswith(f"{_PACKAGE}{os.sep}")
    if not own and top not in _KNOWN:
        raise NoIdentityError(f"{module}.{name} is defined outside of the package")
    return f"{module}:{name}"


def _settings() -> tuple[str, ...]:
    """Return the settings of JAX that tracing or compiling reads, also those of this thread alone."""
    here = [repr(value) for value in config.trace_context() if not isinstance(value, core.AxisEnv)]
    everywhere = [f"{name}={value!r}" for name, value in sorted(jax.config.values.items()) if "cache" not in name]
    return *here, *everywhere


@functools.cache
def _surroundings() -> tuple[str, ...]:
    """Return versions, flags of the compiler, and the processor that code is compiled for."""
    devices = jax.devices()
    if len(devices) > 1 or devices[0].platform != "cpu":
        raise NoIdentityError("code of several devices, or of an accelerator, is not kept")
    versions = [f"{name} {importlib.metadata.version(name)}" for name in _LIBRARIES]
    flags = [f"{name}={value}" for name, value in sorted(os.environ.items()) if name.startswith(("XLA_", "TF_"))]
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return *versions, *flags, sys.version, devices[0].client.platform_version, str(cores), _processor()


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return f"{platform.node()} {platform.processor()}"  # no list of its instructions: this machine alone
    told = {line for line in lines if line.startswith(("flags", "Features", "model name", "CPU part"))}
    return " ".join((platform.machine(), *sorted(told)))


def _stamps() -> frozenset[tuple[str, int, int]]:
    """Return path, time of change and size of every source of the package."""
    found = set()
    for folder, _, names in os.walk(_PACKAGE):
        for name in names:
            if name.endswith(".py"):
                file = os.path.join(folder, name)
                known = os.stat(file)
                found.add((file, known.st_mtime_ns, known.st_size))
    return frozenset(found)


# Of the sources that this process reads.
_READ = _stamps()


def sources_unchanged() -> bool:
    """Whether the sources are those that this process has read."""
    return _stamps() == _READ


@functools.cache
def _sources() -> str:
    """Return a digest of the sources of the package."""
    digest = hashlib.sha256()
    for place, _, size in sorted(_READ):
        try:
            digest.update(f"{Path(place).relative_to(_PACKAGE)} {size}\n".encode() + Path(place).read_bytes())
        except OSError as error:
            raise NoIdentityError("the sources have changed") from error
    if not sources_unchanged():
        raise NoIdentityError("the sources have changed since this process has read them")
    return digest.hexdigest()
