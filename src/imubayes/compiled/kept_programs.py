"""Compiled programs kept between processes, so that a repeated command neither traces nor lowers them again.

JAX keeps compiled code by a digest of the lowered program, so every process traces and lowers anew what it has compiled
before, which takes several times as long as running it.  `kept` finds the executable by what the program is made of
(`program_identity`), before anything is traced.  Whatever has no identity, and every call from within another trace,
takes the ordinary way of `equinox.filter_jit`.

A kept program cannot be differentiated or batched: only outermost functions are kept.
"""

import functools
import os
import pickle
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import equinox as eqx
import jax
from jax._src import config, core
from jax.experimental.compilation_cache.compilation_cache import reset_cache

from imubayes.compiled import stored_programs as store
from imubayes.compiled.program_arguments import Arguments, filled, is_slot, slotted
from imubayes.compiled.program_identity import NoIdentityError, identity, sources_unchanged

SWITCH = "IMUBAYES_KEEP_PROGRAMS"
"""Environment variable; at 0 every process traces its programs anew."""
MOST_BYTES = 300_000_000
"""Size of the folder above which the programs used longest ago are removed: some thousand, of one fit some hundred."""

_NOT_OPTIMISED = {"xla_backend_optimization_level": 0}


@dataclass(frozen=True)
class _Program:
    """An executable of flat arrays, and what surrounds its results.

    Attributes
    ----------
    skeleton : the returned tree with a `Slot` for each array.
    file : where it was read from; None if it was compiled by this process.
    """

    executable: jax.stages.Compiled
    skeleton: Any
    file: Path | None = None

    @functools.cached_property
    def _returned(self) -> tuple[list[Any], Any]:
        return jax.tree.flatten(self.skeleton, is_leaf=is_slot)

    def __call__(self, arrays: list[Any]) -> Any:
        results = self.executable(*arrays)
        leaves, tree = self._returned
        return tree.unflatten([results[leaf.number] if is_slot(leaf) else leaf for leaf in leaves])


class _Folder:
    """Where programs are kept: none until `keep_programs` names one; and those that are loaded ahead."""

    place: Path | None = None
    preloading: store.Preloading | None = None


_programs: dict[Any, _Program | None] = {}
_ahead: dict[Any, Future[_Program | None]] = {}
_threads = ThreadPoolExecutor(1, thread_name_prefix="compiling")


def keep_programs(folder: Path | None, purpose: str = "") -> None:
    """Keep programs in a folder that belongs to the user alone, unless the environment says otherwise.

    Parameters
    ----------
    purpose : the command that is running: what it used the last time is loaded ahead; nothing if it is empty.
    """
    _Folder.place = None if os.environ.get(SWITCH) == "0" else folder
    if purpose and _Folder.place is not None:
        _Folder.preloading = store.Preloading(_Folder.place, purpose)


def programs_folder() -> Path | None:
    """Return the folder in which programs are kept; None if they are not."""
    return _Folder.place


def forget_programs() -> None:
    """Release the programs that this process has loaded."""
    _programs.clear()


def kept[**P, R](function: Callable[P, R], briefly: Callable[..., bool] | None = None) -> Callable[P, R]:
    """Return a function compiled as by `equinox.filter_jit`, whose programs outlast the process.

    Parameters
    ----------
    function : of a module, not a closure; what it returns depends on its arguments and the package's sources alone.
    briefly : whether a program for such arguments takes less time for all that it will do than to optimise it would.
    """
    return cast(Callable[P, R], _Kept(function, briefly))


class _Kept:
    """A function whose programs are kept; an object, as compiled functions are, which take NumPy arrays for JAX's."""

    def __init__(self, function: Callable, briefly: Callable[..., bool] | None):
        self.function, self.briefly, self.ordinary = function, briefly, eqx.filter_jit(function)

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        if _Folder.place is None or not core.trace_state_clean() or jax.config.jax_disable_jit:
            return self.ordinary(*args, **kwargs)
        given = Arguments.of(args, kwargs)
        key = (self.function, given.kinds, config.trace_context())
        if key not in _programs:
            ahead = _ahead.pop(key, None)
            made = (
                _found_or_made(self.function, given, self._options(*args, **kwargs))
                if ahead is None
                else ahead.result()
            )
            _programs[key] = made
        program = _programs[key]
        if program is None:
            return self.ordinary(*args, **kwargs)
        return _result(key, program, given.arrays, lambda: self(*args, **kwargs))

    def _options(self, *args: Any, **kwargs: Any) -> dict[str, int]:
        """Return those of the compiler."""
        return _NOT_OPTIMISED if self.briefly is not None and self.briefly(*args, **kwargs) else {}

    def ahead(self, *args: Any) -> None:
        """Compile the program of a call in a thread, unless it is kept."""
        if _Folder.place is None or not core.trace_state_clean() or jax.config.jax_disable_jit:
            return
        given = Arguments.of(args, {})
        key = (self.function, given.kinds, config.trace_context())
        if key in _programs or key in _ahead:
            return
        with suppress(NoIdentityError):
            if not (_Folder.place / identity(self.function, given.slotted())).exists():
                _ahead[key] = _threads.submit(_found_or_made, self.function, given, self._options(*args))


def compile_ahead(function: Callable, *args: Any) -> None:
    """Compile a kept function for such arguments while the process goes on; a call of it then waits for the rest.

    The compiler works without the interpreter's lock, so that two programs take little longer than one.
    """
    cast(_Kept, function).ahead(*args)


def run_bound(key: tuple, function: Callable, arrays: list[Any], arguments: Callable[[], tuple]) -> Any:
    """Return what a function gives, by a program that was kept or that this process has compiled.

    Parameters
    ----------
    key : by which the process finds the program, for less than it costs to take the arguments apart: it distinguishes
        the arguments from all others, but for the values of their arrays.
    function : as for `kept`.
    arrays : all arrays of the arguments, in the order of their leaves.
    arguments : gives the arguments themselves, the first time.
    """
    if key not in _programs:
        given = Arguments.of(arguments(), {})
        found = _found_or_made(function, given) if _Folder.place is not None else None
        _programs[key] = found or _compiled(function, given.slotted(), arrays, to_be_kept=False)
    program = _programs[key]
    assert program is not None
    return _result(key, program, arrays, lambda: run_bound(key, function, arrays, arguments))


def _result(key: Any, program: _Program, arrays: list[Any], again: Callable[[], Any]) -> Any:
    try:
        return program(arrays)
    except jax.errors.JaxRuntimeError:
        if program.file is None:
            raise
        program.file.unlink(missing_ok=True)  # code that this processor or jaxlib does not run after all
        del _programs[key]
        return again()


def _found_or_made(function: Callable, given: Arguments, options: dict[str, int] | None = None) -> _Program | None:
    """Return the program of a function, from the folder or compiled now; None if it cannot be kept."""
    assert _Folder.place is not None
    arguments = given.slotted()
    try:
        file = _Folder.place / identity(function, arguments)
    except NoIdentityError:
        return None
    stored = (_Folder.preloading.read if _Folder.preloading is not None else store.read_program)(file)
    if stored is not None:
        return _Program(stored.executable, pickle.loads(stored.skeleton), file)
    program = _compiled(function, arguments, given.arrays, options=options)
    if program is not None:
        _write(file, program, len(given.arrays))
    return program


def _compiled(
    function: Callable,
    arguments: Any,
    arrays: list[Any],
    to_be_kept: bool = True,
    options: dict[str, int] | None = None,
) -> _Program | None:
    """Return a function compiled for arguments with `Slot`s in the place of arrays.

    None if it calls back and is to be kept.
    """
    returned: list[Any] = []

    def flat(*arrays):
        args, kwargs = filled(arguments, arrays)
        leaves, tree = jax.tree.flatten(function(*args, **kwargs))
        returned.append(slotted(leaves, tree))
        return tuple(leaf for leaf in leaves if eqx.is_array(leaf))

    flat.__name__ = flat.__qualname__ = function.__name__
    lowered = jax.jit(flat).lower(*arrays)
    if not to_be_kept:
        return _Program(lowered.compile(), returned[-1])
    executable = _without_cache(lowered, options)
    made = cast(Any, executable)._executable.unsafe_call
    if made.has_host_callbacks or made.ordered_effects or made.has_unordered_effects:
        return None
    return _Program(executable, returned[-1])


def _without_cache(lowered: jax.stages.Lowered, options: dict[str, int] | None) -> jax.stages.Compiled:
    """Compile, and do not take the code from JAX's cache: jaxlib cannot serialise what it has loaded from there."""
    with config.enable_compilation_cache(False):
        reset_cache()  # JAX asks once whether it has a cache
        try:
            return lowered.compile(compiler_options=options or None)
        finally:
            reset_cache()


def _write(file: Path, program: _Program, arguments: int) -> None:
    """Keep a program, if jaxlib can and the sources are still those that it was made of."""
    results = sum(map(is_slot, jax.tree.leaves(program.skeleton, is_leaf=is_slot)))
    try:
        skeleton = pickle.dumps(program.skeleton)
    except (TypeError, AttributeError, pickle.PicklingError):
        return  # compiled by each process
    content = store.packed_program(program.executable, arguments, results, skeleton)
    if content is None or not sources_unchanged():
        return
    with suppress(OSError):
        store.make_room(file.parent, MOST_BYTES)
        store.write_program(file, content)
