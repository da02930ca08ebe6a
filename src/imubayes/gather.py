"""Unchecked indexing, transfer to the device and fixed-size batches for compiled functions."""

import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from imubayes.array_shapes import Array, Int


def take(values: Array, places: Int[Array, "..."]) -> Array:
    """Return values[places]; all indices must be non-negative and within the first axis.

    Plain indexing compiles to bounds and sign checks that cost more than the gather itself.
    """
    return jnp.asarray(values).at[places].get(mode="promise_in_bounds", wrap_negative_indices=False)


def on_device(tree: Any) -> Any:
    """Return a pytree with its arrays on the device, so that calls of a compiled function do not copy them again.

    Indices become int32, as the compiled gather uses them.
    """
    return jax.device_put(jax.tree.map(_shorten, tree))


def _shorten(leaf: Any) -> Any:
    is_long = isinstance(leaf, np.ndarray | jax.Array) and leaf.dtype == np.int64
    return leaf.astype(np.int32) if is_long else leaf


def in_batches(function: Callable[[np.ndarray], Array], points: np.ndarray, size: int) -> np.ndarray:
    """Apply a function of `size` points to any number of points, (n, P) → (n, …).

    All batches have one size, the last padded with zeros, so that the function is compiled only once.
    """
    count = max(1, math.ceil(len(points) / size))
    padded = np.concatenate([points, np.zeros((count * size - len(points), points.shape[1]))])
    return np.concatenate([np.asarray(function(batch)) for batch in np.split(padded, count)])[: len(points)]
