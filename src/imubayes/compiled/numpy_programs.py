"""Programs of NumPy: what JAX has traced, as the list of its primitives, which is run and not compiled.

Every value of a program has a place.  Calls are inlined; a scan is a loop with a program of its own.  Programs can be
pickled.
"""

import heapq
import itertools
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from jax.extend.core import Jaxpr, JaxprEqn, Literal

from imubayes.compiled.numpy_primitives import MAKERS, SELECTS, SETTINGS, NoNumpyError

_INNER = ("jaxpr", "call_jaxpr", "fun_jaxpr")
_CALLS = frozenset(
    {"jit", "pjit", "closed_call", "core_call", "remat", "checkpoint", "custom_jvp_call", "custom_vjp_call"}
)
_ROUNDS = 8
_SUMS, _SEVERAL = frozenset({"add", "add_any"}), frozenset({"split", "scan"})


Values = dict[int, Any]
"""Place → value."""


class Step:
    """One primitive: `run` takes the arrays at the places `taken`, and gives those at the places `given`.

    Attributes
    ----------
    loop : of a scan.
    """

    __slots__ = ("given", "loop", "name", "run", "settings", "taken")

    def __init__(
        self, name: str, settings: dict[str, Any], taken: Sequence[int], given: Sequence[int], loop: "Loop | None"
    ):
        self.name, self.settings, self.taken, self.given, self.loop = name, settings, tuple(taken), tuple(given), loop
        self.run: Callable[..., Any] = MAKERS[name](settings) if loop is None else loop

    def __reduce__(self) -> tuple[type["Step"], tuple[Any, ...]]:
        return Step, (self.name, self.settings, self.taken, self.given, self.loop)

    def take(self, values: Values) -> None:
        """Add to values what it gives of them."""
        found = self.run(*[values[place] for place in self.taken])
        if self.name in _SEVERAL:
            values.update(zip(self.given, found, strict=True))
        else:
            values[self.given[0]] = found

    def following(self, places: set[int]) -> tuple[int, ...]:
        """Return the places that it gives whose values depend on those at some places."""
        if places.isdisjoint(self.taken):
            return ()
        if self.loop is None:
            return self.given
        given = self.loop.following([place in places for place in self.taken])
        return tuple(place for place, follows in zip(self.given, given, strict=True) if follows)


@dataclass
class NumpyProgram:
    """Steps in order.

    Attributes
    ----------
    inputs, outputs : places of the arguments and results.
    constants : place → value.
    shapes : place → shape and type.
    """

    inputs: list[int] = field(default_factory=list)
    outputs: list[int] = field(default_factory=list)
    constants: dict[int, np.ndarray] = field(default_factory=dict)
    shapes: dict[int, tuple[tuple[int, ...], np.dtype]] = field(default_factory=dict)
    steps: list[Step] = field(default_factory=list)

    def __call__(self, *arrays: Any) -> list[np.ndarray]:
        """Return the results, flat, of arguments, flat."""
        values = self.with_inputs(arrays)
        for step, done in self._schedule:
            step.take(values)
            for place in done:
                del values[place]
        return [np.asarray(values[place]) for place in self.outputs]

    def with_inputs(self, arrays: Iterable[Any]) -> Values:
        """Return the values that are known before the first of the `changing` steps."""
        return {**self._folded, **dict(zip(self.inputs, arrays, strict=True))}

    @cached_property
    def _folded(self) -> Values:
        """The constants, and what follows from them alone."""
        values: Values = dict(self.constants)
        for step in self.steps:
            if all(place in values for place in step.taken):
                step.take(values)
        return values

    @cached_property
    def changing(self) -> list[Step]:
        """The steps that depend on the arguments."""
        return [step for step in self.steps if step.given[0] not in self._folded]

    @cached_property
    def work(self) -> int:
        """The number of values that one run computes."""
        inside = (step.loop.body.work * step.loop.length for step in self.steps if step.loop is not None)
        given = (math.prod(self.shapes[place][0]) for step in self.steps for place in step.given)
        return sum(given) + sum(inside)

    @cached_property
    def _schedule(self) -> list[tuple[Step, list[int]]]:
        return with_ends(self.changing, {*self.outputs, *self._folded, *self.inputs})

    def following(self, places: Iterable[int]) -> set[int]:
        """Return the places whose values depend on those at some places, these included."""
        found = set(places)
        for step in self.steps:
            found.update(step.following(found))
        return found

    def without_unused(self) -> "NumpyProgram":
        """Return the program without the steps that no result needs."""
        needed, kept = set(self.outputs), []
        for step in reversed(self.steps):
            if not needed.isdisjoint(step.given):
                needed.update(step.taken)
                kept.append(step)
        there = needed.union(self.inputs, *(step.given for step in kept))
        constants = {place: value for place, value in self.constants.items() if place in there}
        shapes = {place: shape for place, shape in self.shapes.items() if place in there}
        return NumpyProgram(self.inputs, self.outputs, constants, shapes, kept[::-1])


def with_ends(steps: Sequence[Step], held: set[int]) -> list[tuple[Step, list[int]]]:
    """Return each step with the places that nothing needs after it: memory does not grow with the program.

    Parameters
    ----------
    held : places that are needed to the end.
    """
    last = {place: k for k, step in enumerate(steps) for place in (*step.taken, *step.given)}
    done: list[list[int]] = [[] for _ in steps]
    for place, k in last.items():
        if place not in held:
            done[k].append(place)
    return list(zip(steps, done, strict=True))


@dataclass
class Loop:
    """A scan.

    Attributes
    ----------
    body : of one turn: takes constants, what is carried, and one row of what is passed through row by row.
    constants, carried : how many.
    """

    body: NumpyProgram
    constants: int
    carried: int
    length: int
    backwards: bool

    def __call__(self, *arrays: np.ndarray) -> list[np.ndarray]:
        """Return what is carried at the end, and the rows that the turns give."""
        start = self.constants + self.carried
        fixed, carried, rows = arrays[: self.constants], list(arrays[self.constants : start]), arrays[start:]
        turns: list[list[np.ndarray]] = []
        for k in reversed(range(self.length)) if self.backwards else range(self.length):
            found = self.body(*fixed, *carried, *(row[k] for row in rows))
            carried = found[: self.carried]
            turns.append(found[self.carried :])
        if self.backwards:
            turns.reverse()
        return [*carried, *(np.stack(each) for each in zip(*turns, strict=True))]

    def following(self, taken: Sequence[bool]) -> list[bool]:
        """Return which results depend on the chosen of the arguments."""
        chosen = list(taken)
        while True:
            found = self.body.following(place for place, own in zip(self.body.inputs, chosen, strict=True) if own)
            given = [place in found for place in self.body.outputs]
            carried = range(self.constants, self.constants + self.carried)
            more = [k for k in carried if given[k - self.constants] and not chosen[k]]
            if not more:
                return given
            for k in more:
                chosen[k] = True


class _Lowering:
    """From a traced function to a program."""

    def __init__(self) -> None:
        self.program = NumpyProgram()
        self._places = itertools.count()

    def lowered(self, traced: Any) -> NumpyProgram:
        jaxpr, constants = _opened(traced)
        self.program.inputs = [self._place(var) for var in jaxpr.invars]
        self.program.outputs = self._inlined(jaxpr, constants, self.program.inputs)
        return self.program.without_unused()

    def _place(self, var: Any) -> int:
        place = next(self._places)
        self.program.shapes[place] = (tuple(var.aval.shape), np.dtype(var.aval.dtype))
        return place

    def _constant(self, value: Any, var: Any) -> int:
        place = self._place(var)
        self.program.constants[place] = np.asarray(value, dtype=var.aval.dtype)
        return place

    def _inlined(self, jaxpr: Jaxpr, constants: Sequence[Any], arguments: Sequence[int]) -> list[int]:
        """Add the steps of a function, called with values at places; return the places of its results."""
        known = dict(zip(jaxpr.invars, arguments, strict=True))
        for var, value in zip(jaxpr.constvars, constants, strict=True):
            known[var] = self._constant(value, var)

        def read(atom: Any) -> int:
            return self._constant(atom.val, atom) if isinstance(atom, Literal) else known[atom]

        for equation in jaxpr.eqns:
            taken = [read(atom) for atom in equation.invars]
            known.update(zip(equation.outvars, self._added(equation, taken), strict=True))
        return [read(atom) for atom in jaxpr.outvars]

    def _added(self, equation: JaxprEqn, taken: Sequence[int]) -> list[int]:
        name, settings = equation.primitive.name, equation.params
        if name in _CALLS:
            inner = next(settings[each] for each in _INNER if each in settings)
            return self._inlined(*_opened(inner), taken)
        if name == "scan" and _repeats(equation):
            body, constants = _opened(settings["jaxpr"])
            fixed, carried = taken[: -len(body.outvars)], list(taken[-len(body.outvars) :])
            for _ in range(settings["length"]):
                carried = self._inlined(body, constants, [*fixed, *carried])
            return carried
        given = [self._place(var) for var in equation.outvars]
        loop = _loop_of(equation) if name == "scan" else None
        if loop is None and name not in MAKERS:
            raise NoNumpyError(name)
        looked_at = {key: value for key, value in settings.items() if key in SETTINGS} if loop is None else {}
        self.program.steps.append(Step(name, looked_at, taken, given, loop))
        return given


def _repeats(equation: JaxprEqn) -> bool:
    """Whether a scan is a few rounds that carry something, and nothing goes through it row by row.

    Such rounds stand one after the other in the program, so that what is linear in them is apart.
    """
    body, _ = _opened(equation.params["jaxpr"])
    rows = (*_more_axes(equation.invars, body.invars), *_more_axes(equation.outvars, body.outvars))
    return not any(rows) and len(equation.outvars) > 0 and equation.params["length"] <= _ROUNDS


def _loop_of(equation: JaxprEqn) -> Loop:
    """Return a scan as a loop: what has one axis less inside is passed through row by row."""
    settings = equation.params
    body, _ = _opened(settings["jaxpr"])
    by_row = _more_axes(equation.invars, body.invars)
    carried = _more_axes(equation.outvars, body.outvars).count(False)
    if not settings["length"]:
        raise NoNumpyError("a loop without a turn")
    constants, length = by_row.count(False) - carried, int(settings["length"])
    return Loop(lowered(settings["jaxpr"]), constants, carried, length, bool(settings["reverse"]))


def _opened(traced: Any) -> tuple[Jaxpr, Sequence[Any]]:
    """Return a traced function and its constants."""
    return getattr(traced, "jaxpr", traced), getattr(traced, "consts", ())


def _more_axes(outside: Sequence[Any], inside: Sequence[Any]) -> list[bool]:
    return [len(one.aval.shape) > len(other.aval.shape) for one, other in zip(outside, inside, strict=True)]


def lowered(traced: Any) -> NumpyProgram:
    """Return the program of what `jax.make_jaxpr` gives; NoNumpyError if NumPy lacks a primitive here."""
    return _Lowering().lowered(traced)


class LinearProgram:
    """A program that is linear in its last argument: what does not depend on it is run once.

    In each run the steps are taken that follow from components that are not zero: a coefficient of a sensor passes the
    few operations behind it, and not the whole path.

    Parameters
    ----------
    program : of a function with its directional derivative; the direction is its last argument.
    """

    def __init__(self, program: NumpyProgram):
        self._program, self._direction = program, program.inputs[-1]
        linear = program.following([self._direction])
        self._each = [step for step in program.changing if not linear.isdisjoint(step.given)]
        self._linear = linear
        once = [step for step in program.changing if not linear.issuperset(step.given)]
        needed = {place for step in self._each for place in step.taken}
        held = needed.union(program.outputs, program.with_inputs(program.inputs))
        self._once = [(step, linear.intersection(step.taken), done) for step, done in with_ends(once, held)]
        self._users: dict[int, list[int]] = {}
        for k, step in enumerate(self._each):
            for place in linear.intersection(step.taken):
                self._users.setdefault(place, []).append(k)

    def at(self, *arrays: Any) -> tuple[list[np.ndarray], Callable[[np.ndarray], list[np.ndarray]]]:
        """Return the results at arguments, without the direction, and the map from a direction to the results along it.

        The values of results that depend on the direction are those of direction 0, and the other way round.
        """
        outputs = self._program.outputs
        values = self._program.with_inputs((*arrays, self._zeros(self._direction)))
        for step, at_zero, done in self._once:
            for place in at_zero:  # of a loop that is not linear as a whole
                values[place] = self._zeros(place)
            step.take(values)
            for place in done:
                values.pop(place, None)
        for place in self._linear:
            values.pop(place, None)
        return self._chosen(outputs, values), lambda direction: self._along(values, direction)

    def _chosen(self, places: Sequence[int], values: Values) -> list[np.ndarray]:
        return [np.asarray(values[place]) if place in values else self._zeros(place) for place in places]

    def _zeros(self, place: int) -> np.ndarray:
        shape, dtype = self._program.shapes[place]
        return np.broadcast_to(np.zeros((), dtype=dtype), shape)

    def _along(self, fixed: Values, direction: np.ndarray) -> list[np.ndarray]:
        own: Values = {self._direction: direction}
        waiting = list(self._users.get(self._direction, ()))
        noted = set(waiting)
        heapq.heapify(waiting)
        while waiting:
            step = self._each[heapq.heappop(waiting)]
            for place, value in self._not_zero(step, own, fixed):
                own[place] = value
                for user in self._users.get(place, ()):
                    if user not in noted:
                        noted.add(user)
                        heapq.heappush(waiting, user)
        return self._chosen(self._program.outputs, own)

    def _not_zero(self, step: Step, own: Values, fixed: Values) -> Iterable[tuple[int, Any]]:
        """Return the linear results of a step that are not known to be zero, with their places."""
        if step.name in _SUMS:
            parts = [own[place] for place in step.taken if place in own]
            if len(parts) < len(step.taken):
                return ((step.given[0], parts[0]),)
        results = step.run(*[self._value(place, own, fixed) for place in step.taken])
        pairs = zip(step.given, results if step.name in _SEVERAL else (results,), strict=True)
        return [pair for pair in pairs if pair[0] in self._linear and (step.name not in SELECTS or pair[1].any())]

    def _value(self, place: int, own: Values, fixed: Values) -> Any:
        if place in own:
            return own[place]
        return fixed[place] if place in fixed else self._zeros(place)
