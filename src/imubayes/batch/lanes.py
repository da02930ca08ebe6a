"""Units of one structure side by side: one compiled function for a fixed number of lanes, driven from Python.

Two bound models have the same structure where their arrays have the same shapes and all places in them, which are
integers, are the same: the same runs, channels, parameters and missing readings.  Places are shared by the lanes; only
numbers are stacked.  A chunk that does not fill the lanes is filled up with copies of its last unit.
"""

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import jax
import numpy as np

from imubayes.array_shapes import Array
from imubayes.batch.group_moments import GroupIndex, group_index
from imubayes.gather import on_device
from imubayes.model.bind import Model
from imubayes.model.problem import Problem

LANES = 4
"""Units side by side: with more the arrays leave the cache of a core."""
_DIGITS = 16


def structure_key(problem: Problem) -> str:
    """Return the key of a problem's structure."""
    digest = hashlib.sha256(str(jax.tree.structure(problem)).encode())
    for path, leaf in jax.tree_util.tree_flatten_with_path(problem)[0]:
        array = np.asarray(leaf)
        digest.update(f"{array.dtype}{array.shape}".encode())
        if _is_shared(path, array):
            digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()[:_DIGITS]


def _is_shared(path: tuple, leaf: Any) -> bool:
    """Tell whether all units of a structure have an array in common: places, and the seeds of the Jacobian."""
    return np.asarray(leaf).dtype.kind != "f" or ".sparsity" in jax.tree_util.keystr(path)


Stacked = tuple[Array, ...]
"""The arrays of units in lanes that differ between units, each (LANES, …)."""


@dataclass(frozen=True)
class _Form:
    """How the arrays of a problem are put together: its tree, and which of its leaves all units have in common."""

    tree: Any
    common: tuple[bool, ...]

    def __hash__(self) -> int:
        return self._hash

    @cached_property
    def _hash(self) -> int:
        return hash((self.tree, self.common))

    def problem(self, common: Sequence[Array], own: Sequence[Array]) -> Problem:
        """Return the problem with these arrays."""
        shared, differing = iter(common), iter(own)
        return jax.tree.unflatten(self.tree, [next(shared if same else differing) for same in self.common])


@dataclass(frozen=True)
class LaneStructure:
    """The compiled functions of a structure, by its first problem."""

    problem: Problem
    index: GroupIndex

    @staticmethod
    def of(problem: Problem) -> "LaneStructure | None":
        """Return the structure of a problem; None where its readings cannot be summed up by groups."""
        index = group_index(problem)
        return None if index is None else LaneStructure(problem, on_device(index))

    @cached_property
    def _form(self) -> _Form:
        leaves, tree = jax.tree_util.tree_flatten_with_path(self.problem)
        return _Form(tree, tuple(_is_shared(path, leaf) for path, leaf in leaves))

    @cached_property
    def _common(self) -> Stacked:
        leaves = zip(jax.tree.leaves(self.problem), self._form.common, strict=True)
        return tuple(on_device(leaf) for leaf, same in leaves if same)

    def stacked(self, models: Sequence[Model]) -> Stacked:
        """Return the arrays that differ between units, stacked in lanes."""
        filled = [*models, *[models[-1]] * (LANES - len(models))]
        units = [jax.tree.leaves(model.problem) for model in filled]
        own = [leaves for *leaves, same in zip(*units, self._form.common, strict=True) if not same]
        return tuple(jax.device_put([np.stack([np.asarray(leaf) for leaf in leaves]) for leaves in own]))

    def run(self, function: Callable, varying: Stacked, *arguments: Any) -> Any:
        """Return `function(problem, index, *arguments)` of every lane.

        Parameters
        ----------
        function : of one unit; compiled once for a structure, so it must be the same object every time.
        arguments : arrays with the lanes first.
        """
        return _mapped(function, self._form, varying, self._common, self.index, *arguments)


# Leaves are handed over, not problems: taking a problem apart costs more than a small function of it.
@partial(jax.jit, static_argnums=(0, 1))
def _mapped(
    function: Callable, form: _Form, varying: Stacked, common: Stacked, index: GroupIndex, *arguments: Any
) -> Any:
    def of_unit(own, *given):
        return function(form.problem(common, own), index, *given)

    return jax.vmap(of_unit)(varying, *arguments)


def of_lane(tree: Any, lane: int) -> Any:
    """Return the arrays of one lane."""
    return jax.tree.map(lambda leaf: leaf[lane], tree)
