"""Functions of JAX that NumPy evaluates: traced, and not compiled.

A signal path has some thousand elementwise operations.  XLA takes seconds to compile it, and several times that with
its derivatives, but NumPy 10 ms to pass it once for some hundred rows.  So what is evaluated a few times is traced and
run by NumPy; what is evaluated thousands of times, as the density of a sampler, or for ten thousands of rows, is
compiled (`kept_programs`).
Measured on `data/hidden-gyro` with the whole catalogue (5 600 operations, 58 directions), in CPU seconds: 12 to compile
it, against 1 to trace it and 0.2 in NumPy, to 1e-15 the same.

Derivatives are those of JAX, which are traced with the function.  A traced program outlasts the process, as compiled
ones do, by the identity of everything that its tracing reads.  A function with primitives that NumPy lacks here is
compiled.
"""

import functools
import hashlib
import pickle
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import equinox as eqx
import jax
import numpy as np
from jax._src import config, core

from imubayes.compiled import kept_programs as compiled
from imubayes.compiled import stored_programs as store
from imubayes.compiled.numpy_primitives import NoNumpyError
from imubayes.compiled.numpy_programs import LinearProgram, NumpyProgram, lowered
from imubayes.compiled.program_arguments import Arguments, filled, is_slot, slotted
from imubayes.compiled.program_identity import NoIdentityError, identity, sources_unchanged

MOST_STEPS = 200_000
"""Steps of all programs that a process holds, about 1 kB each: the signal paths of some dozen models."""


@dataclass(frozen=True)
class _TracedFunction:
    """A traced function.

    Attributes
    ----------
    skeleton : the returned tree with a `Slot` for each array.
    """

    program: NumpyProgram
    skeleton: Any

    @functools.cached_property
    def linear(self) -> LinearProgram:
        """The program as one that is linear in its last argument."""
        return LinearProgram(self.program)

    def filled(self, results: list[np.ndarray]) -> Any:
        """Return the tree with the results in it."""
        return filled(self.skeleton, results)


MOST_VALUES = 40_000_000
"""Values computed in one run above which a function is compiled: NumPy takes a tenth of a second, and a derivative
holds as much as a third of them."""

_programs: dict[Any, _TracedFunction | None] = {}


def in_numpy[**P, R](function: Callable[P, R], most_values: int | None = None) -> Callable[P, R]:
    """Return a function of JAX that NumPy evaluates; if it cannot, and in a trace of another, as `kept` does.

    Parameters
    ----------
    function : of a module, not a closure; what it returns depends on its arguments and the package's sources alone.
    most_values : computed in one run, above which it is compiled; `MOST_VALUES` if None.
    """
    return cast(Callable[P, R], _InNumpy(function, most_values))


class _InNumpy:
    def __init__(self, function: Callable, most_values: int | None):
        self.function, self.otherwise, self.most_values = function, compiled.kept(function), most_values

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        if not core.trace_state_clean():
            return self.otherwise(*args, **kwargs)
        given = Arguments.of(args, kwargs)
        found = _traced(self.function, False, given, self.most_values)
        if found is None:
            return self.otherwise(*args, **kwargs)
        with np.errstate(all="ignore"):
            return found.filled(found.program(*map(np.asarray, given.arrays)))


Pushed = tuple[np.ndarray, Callable[[np.ndarray], np.ndarray]]


def linearised_in_numpy(function: Callable[..., Any], *arguments: Any) -> Pushed | None:
    """Return f(x) and the map v → ∂f/∂x·v, x the last argument; None if NumPy cannot evaluate it.

    Parameters
    ----------
    function : of a module, as for `in_numpy`; takes a vector last and returns one array.
    """
    given = Arguments.of(arguments, {})
    found = _traced(function, True, given)
    if found is None:
        return None
    with np.errstate(all="ignore"):
        (value, _), push = found.linear.at(*map(np.asarray, given.arrays))

    def pushed(direction: np.ndarray) -> np.ndarray:
        with np.errstate(all="ignore"):
            return push(direction)[1]

    return value, pushed


def _traced(
    function: Callable, with_derivative: bool, given: Arguments, most_values: int | None = None
) -> _TracedFunction | None:
    """Return the program of a function for arguments like these; None if NumPy cannot evaluate it."""
    key = (function, with_derivative, given.kinds, config.trace_context())
    if key in _programs:
        _programs[key] = _programs.pop(key)  # used last
        return _programs[key]
    found = _found_or_traced(function, with_derivative, given.slotted())
    most = MOST_VALUES if most_values is None else most_values
    found = None if found is None or found.program.work > most else found
    _programs[key] = found
    held = [0 if each is None else len(each.program.steps) for each in _programs.values()]
    for other, total in zip(list(_programs), sum(held) - np.cumsum([0, *held[:-1]]), strict=True):
        if total > MOST_STEPS and other != key:
            del _programs[other]
    return found


def _found_or_traced(function: Callable, with_derivative: bool, arguments: Any) -> _TracedFunction | None:
    folder = compiled.programs_folder()
    try:
        name = identity(function, ("derivative" if with_derivative else "value", arguments))
    except NoIdentityError:
        folder, name = None, ""
    stored = None if folder is None else _read(folder / name)
    if stored is not None:
        return stored
    try:
        made = _trace(function, with_derivative, arguments)
    except NoNumpyError:
        return None
    if folder is not None:
        _write(folder / name, made)
    return made


def _trace(function: Callable, with_derivative: bool, arguments: Any) -> _TracedFunction:
    slots = [leaf for leaf in jax.tree.leaves(arguments, is_leaf=is_slot) if is_slot(leaf)]
    returned: list[Any] = []

    def flat(*arrays):
        args, kwargs = filled(arguments, arrays)
        if with_derivative:
            found = jax.jvp(lambda last: function(*args[:-1], last), args[-1:], arrays[-1:])
        else:
            found = function(*args, **kwargs)
        leaves, tree = jax.tree.flatten(found)
        returned.append(slotted(leaves, tree))
        return tuple(leaf for leaf in leaves if eqx.is_array(leaf))

    like = [jax.ShapeDtypeStruct(slot.shape, slot.dtype, weak_type=slot.weak) for slot in slots]
    return _TracedFunction(lowered(jax.make_jaxpr(flat)(*like, *like[-1:] if with_derivative else ())), returned[-1])


def _read(file: Path) -> _TracedFunction | None:
    content = store.read_content(file)
    return None if content is None else pickle.loads(content)


def _write(file: Path, program: _TracedFunction) -> None:
    """Keep a program, if the sources are still those that it was made of."""
    try:
        content = pickle.dumps(_TracedFunction(program.program, program.skeleton))
    except (TypeError, AttributeError, pickle.PicklingError):
        return
    if sources_unchanged():
        with suppress(OSError):
            store.make_room(file.parent, compiled.MOST_BYTES)
            store.write_program(file, hashlib.sha256(content).digest() + content)
