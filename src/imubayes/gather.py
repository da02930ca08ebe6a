"""Indexing for compiled code: only what is asked for, no guards."""

import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from imubayes.types import Array, Int


def take(values: Array, places: Int[Array, "..."]) -> Array:
    """Return values[places]; every place must lie within the first axis, and none is counted from its end.

    Square brackets make a compiled program look at every place for one that lies outside or is negative, which costs
    it more than the values themselves.
    """
    return jnp.asarray(values).at[places].get(mode="promise_in_bounds", wrap_negative_indices=False)


def on_device(tree: Any) -> Any:
    """Return a pytree with JAX arrays in place of NumPy's, so that a compiled call does not copy them each time.

    Places are made as short as the compiled gather wants them.
    """
    return jax.device_put(jax.tree.map(lambda one: one.astype(np.int32) if _is_long(one) else one, tree))


def _is_long(leaf: Any) -> bool:
    return isinstance(leaf, np.ndarray | jax.Array) and leaf.dtype == np.int64


def in_batches(function: Callable[[np.ndarray], Array], points: np.ndarray, size: int) -> np.ndarray:
    """Return what a function of `size` points makes of any number of them, (n, P) → (n, …).

    In batches of one size, the last filled up with zeros: the function is compiled once for all who ask.
    """
    count = max(1, math.ceil(len(points) / size))
    whole = np.concatenate([points, np.zeros((count * size - len(points), points.shape[1]))])
    return np.concatenate([np.asarray(function(one)) for one in np.split(whole, count)])[: len(points)]
