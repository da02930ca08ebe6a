"""Arguments of a program, taken apart: their arrays, and what else a program depends on.

A model has some hundred leaves, and is handed to some hundred calls of a fit.  It cannot change, so it is taken apart
once.
"""

import itertools
import weakref
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax

from imubayes.compiled.program_identity import Slot


class Kinds:
    """What a program depends on: the tree, shape and type of each array, and all of any other leaf."""

    __slots__ = ("_compared", "_hash")

    def __init__(self, tree: Any, leaves: list[Any]):
        self._compared = (tree, tuple(map(_kind_of, leaves)))
        self._hash = hash(self._compared)

    def __hash__(self) -> int:
        return self._hash

    def __eq__(self, other: object) -> bool:
        return self is other or (isinstance(other, Kinds) and self._compared == other._compared)


@dataclass(frozen=True)
class _Leaves:
    kinds: Kinds
    arrays: tuple[Any, ...]


_modules: dict[int, tuple[weakref.ref, _Leaves]] = {}


@dataclass(frozen=True)
class Arguments:
    """The arguments of a call.

    Attributes
    ----------
    kinds : by which a program for such arguments is found; distinguishes them from all others but for the values of
        arrays.
    arrays : all arrays, in the order of the leaves.
    """

    args: tuple[Any, ...]
    kwargs: Mapping[str, Any]
    kinds: tuple[Kinds, ...]
    arrays: list[Any]

    @staticmethod
    def of(args: tuple[Any, ...], kwargs: Mapping[str, Any]) -> "Arguments":
        """Return arguments, taken apart."""
        parts = [_part(argument) for argument in (*args, kwargs)]
        arrays = list(itertools.chain.from_iterable(part.arrays for part in parts))
        return Arguments(args, kwargs, tuple(part.kinds for part in parts), arrays)

    def slotted(self) -> Any:
        """Return the pair of args and kwargs with a `Slot` for each array."""
        leaves, tree = jax.tree.flatten((self.args, self.kwargs))
        return slotted(leaves, tree)


def slotted(leaves: list[Any], tree: Any) -> Any:
    """Return a tree with a `Slot` for each array."""
    number = itertools.count()
    return tree.unflatten([Slot.of(next(number), leaf) if eqx.is_array(leaf) else leaf for leaf in leaves])


def is_slot(leaf: Any) -> bool:
    """Return whether a leaf stands for an array."""
    return isinstance(leaf, Slot)


def filled(skeleton: Any, arrays: Any) -> Any:
    """Return a tree with arrays for its slots."""
    return jax.tree.map(lambda leaf: arrays[leaf.number] if is_slot(leaf) else leaf, skeleton, is_leaf=is_slot)


def _part(argument: Any) -> _Leaves:
    if not isinstance(argument, eqx.Module):
        return _taken_apart(argument)
    place = id(argument)
    if place in _modules and _modules[place][0]() is argument:
        return _modules[place][1]
    part = _taken_apart(argument)
    _modules[place] = weakref.ref(argument, lambda gone: _forget(place, gone)), part
    return part


def _forget(place: int, gone: weakref.ref) -> None:
    if place in _modules and _modules[place][0] is gone:  # not another object in the same place
        del _modules[place]


def _taken_apart(argument: Any) -> _Leaves:
    leaves, tree = jax.tree.flatten(argument)
    return _Leaves(Kinds(tree, leaves), tuple(leaf for leaf in leaves if eqx.is_array(leaf)))


def _kind_of(leaf: Any) -> Any:
    if eqx.is_array(leaf):
        return leaf.shape, leaf.dtype, getattr(leaf, "weak_type", False)
    return type(leaf), leaf
