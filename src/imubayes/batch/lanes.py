"""Units of one structure side by side: one compiled function for a fixed number of lanes, driven from Python.

Two bound models have the same structure where their arrays have the same shapes and all places in them, which are
integers, are the same: the same runs, channels, parameters and missing readings.  Places are shared by the lanes; only
numbers are stacked.  A chunk that does not fill the lanes is filled up with copies of its last unit.
"""

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from imubayes.batch.group_moments import GroupIndex, group_index
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


@dataclass(frozen=True)
class LaneStructure:
    """The compiled functions of a structure, by its first problem."""

    problem: Problem
    index: GroupIndex

    @staticmethod
    def of(problem: Problem) -> "LaneStructure | None":
        """Return the structure of a problem; None where its readings cannot be summed up by groups."""
        index = group_index(problem)
        return None if index is None else LaneStructure(problem, index)

    @cached_property
    def _mask(self) -> Problem:
        return jax.tree_util.tree_map_with_path(_is_shared, self.problem)

    @cached_property
    def shared(self) -> Problem:
        """The arrays that all units have in common; None elsewhere."""
        return eqx.partition(self.problem, self._mask)[0]

    def stacked(self, models: Sequence[Model]) -> Problem:
        """Return the arrays that differ between units, stacked in lanes (LANES, …)."""
        filled = [*models, *[models[-1]] * (LANES - len(models))]
        own = [eqx.partition(model.problem, self._mask)[1] for model in filled]
        return jax.tree.map(lambda *leaves: jnp.stack([jnp.asarray(leaf) for leaf in leaves]), *own)

    def run(self, function: Callable, varying: Problem, *arguments: Any) -> Any:
        """Return `function(problem, index, *arguments)` of every lane.

        Parameters
        ----------
        function : of one unit; compiled once for a structure, so it must be the same object every time.
        arguments : arrays with the lanes first.
        """
        return _mapped(function, varying, self.shared, self.index, *arguments)


@eqx.filter_jit
def _mapped(function: Callable, varying: Problem, shared: Problem, index: GroupIndex, *arguments: Any) -> Any:
    def of_unit(varying, *given):
        return function(eqx.combine(shared, varying), index, *given)

    return jax.vmap(of_unit)(varying, *arguments)


def of_lane(tree: Any, lane: int) -> Any:
    """Return the arrays of one lane."""
    return jax.tree.map(lambda leaf: leaf[lane], tree)
