"""The primitives of JAX that effects and the signal path are made of, each as what NumPy computes for it.

A maker takes the settings of one use of a primitive, and returns the function of its arrays.  Results agree with those
of compiled code to rounding.  An operation that is not listed, such as loops of unknown length and callbacks, is left
to the compiler.
"""

import math
import operator
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from jax.lax import GatherScatterMode
from scipy import special

from imubayes.foundations.tail_probabilities import error_complement

Numbers = Any
"""An array, or the number that NumPy makes of one without axes."""

_COPIED = 8192
"""Values up to which a copy takes less time than a view of other strides."""

Maker = Callable[[Mapping[str, Any]], Callable[..., Any]]


class NoNumpyError(Exception):
    """NumPy has no function here for a primitive, or for this use of it."""


def _plain(function: Callable[..., Any]) -> Maker:
    """Return the maker of a primitive without settings that matter."""
    return lambda settings: function


def _quotient(one: Numbers, other: Numbers) -> Numbers:
    """Return one / other; of integers rounded towards 0."""
    if np.issubdtype(one.dtype, np.integer):
        rest = np.fmod(one, other)
        return (one - rest) // other
    return np.divide(one, other)


def _whole_power(settings: Mapping[str, Any]) -> Callable[..., Any]:
    power = settings["y"]

    def raised(x: Numbers) -> Numbers:
        found = x if abs(power) >= 1 else np.ones_like(x)
        for _ in range(abs(power) - 1):
            found = found * x
        return 1 / found if power < 0 else found

    return raised


def _broadcast(settings: Mapping[str, Any]) -> Callable[..., Any]:
    shape, places = tuple(settings["shape"]), tuple(settings["broadcast_dimensions"])

    small = math.prod(shape) <= _COPIED

    def broadcast(x: Numbers, *sizes: Any) -> Numbers:
        own = [1] * len(shape)
        for place, size in zip(places, x.shape, strict=True):
            own[place] = size
        if not small:
            return np.broadcast_to(x.reshape(own), shape)
        found = np.empty(shape, x.dtype)
        found[...] = x.reshape(own)
        return found

    return broadcast


def _slice(settings: Mapping[str, Any]) -> Callable[..., Any]:
    starts, ends = settings["start_indices"], settings["limit_indices"]
    steps = settings["strides"] or (1,) * len(starts)
    return operator.itemgetter(tuple(map(slice, starts, ends, steps)))


def _split(settings: Mapping[str, Any]) -> Callable[..., Any]:
    ends, axis = np.cumsum(settings["sizes"])[:-1].tolist(), settings["axis"]
    return lambda x: np.split(x, ends, axis)


def _select(which: Numbers, *cases: Numbers) -> Numbers:
    if which.dtype == np.bool_:
        return np.where(which, cases[1], cases[0])
    return np.choose(which, cases)


def _pad(settings: Mapping[str, Any]) -> Callable[..., Any]:
    config = [tuple(map(int, each)) for each in settings["padding_config"]]
    if any(inner or low < 0 or high < 0 for low, high, inner in config):
        raise NoNumpyError("padding between values, or of negative width")
    widths = [(low, high) for low, high, _ in config]
    return lambda x, value: np.pad(x, widths, constant_values=value)


def _iota(settings: Mapping[str, Any]) -> Callable[..., Any]:
    shape, axis = tuple(settings["shape"]), settings["dimension"]
    own = [1] * len(shape)
    own[axis] = shape[axis]
    found = np.broadcast_to(np.arange(shape[axis], dtype=settings["dtype"]).reshape(own), shape)
    return lambda: found


def _reduced(function: Any) -> Maker:
    return lambda settings: lambda x: function(x, axis=tuple(settings["axes"]))


def _running(function: Any) -> Maker:
    def make(settings: Mapping[str, Any]) -> Callable[..., Any]:
        axis = settings["axis"]
        if settings["reverse"]:
            return lambda x: np.flip(function(np.flip(x, axis), axis=axis), axis)
        return lambda x: function(x, axis=axis)

    return make


def _dot(settings: Mapping[str, Any]) -> Callable[..., Any]:
    """Return the contraction of two arrays: batch axes first, then what is left of each."""
    (along, other_along), (batch, other_batch) = settings["dimension_numbers"]

    def contracted(one: Numbers, other: Numbers) -> Numbers:
        letters = iter("abcdefghijklmnopqrstuvwxyz")
        names, others = [""] * one.ndim, [""] * other.ndim
        for place, other_place in (*zip(batch, other_batch, strict=True), *zip(along, other_along, strict=True)):
            names[place] = others[other_place] = next(letters)
        names, others = ([name or next(letters) for name in each] for each in (names, others))
        left = [name for place, name in enumerate(names) if place not in (*batch, *along)]
        left += [name for place, name in enumerate(others) if place not in (*other_batch, *other_along)]
        result = [names[place] for place in batch] + left
        return np.einsum(f"{''.join(names)},{''.join(others)}->{''.join(result)}", one, other)

    return contracted


class _Gather:
    """Windows of an array at starting places, (…, axes)."""

    def __init__(self, settings: Mapping[str, Any]):
        numbers, self._mode = settings["dimension_numbers"], settings["mode"]
        modes = (GatherScatterMode.PROMISE_IN_BOUNDS, GatherScatterMode.CLIP, GatherScatterMode.FILL_OR_DROP)
        if numbers.operand_batching_dims or self._mode not in modes:
            raise NoNumpyError("a gather of batches")
        self._sizes, self._fill = tuple(settings["slice_sizes"]), settings["fill_value"]
        self._starts, self._offsets = numbers.start_index_map, numbers.offset_dims
        self._window = [axis for axis in range(len(self._sizes)) if axis not in numbers.collapsed_slice_dims]

    def __call__(self, x: Numbers, places: Numbers) -> Numbers:
        around, inner = places.shape[:-1], (1,) * len(self._window)
        starts = [self._start(axis, places) for axis in range(len(self._sizes))]
        lost = np.zeros(around, dtype=bool)
        if self._mode != GatherScatterMode.PROMISE_IN_BOUNDS:
            last = [whole - size for whole, size in zip(x.shape, self._sizes, strict=True)]
            for start, end in zip(starts, last, strict=True):
                lost = lost | (start < 0) | (start > end)
            starts = [np.clip(start, 0, end) for start, end in zip(starts, last, strict=True)]
        index = tuple(start.reshape(start.shape + inner) + self._steps(axis) for axis, start in enumerate(starts))
        found = np.broadcast_to(x[index], around + tuple(self._sizes[axis] for axis in self._window))
        if self._mode == GatherScatterMode.FILL_OR_DROP and lost.any():
            found = np.where(lost.reshape(around + inner), _filling(self._fill, x.dtype), found)
        batch = [axis for axis in range(found.ndim) if axis not in self._offsets]
        return found.transpose(np.argsort([*batch, *self._offsets]).tolist())

    def _start(self, axis: int, places: Numbers) -> Numbers:
        if axis in self._starts:
            return places[..., self._starts.index(axis)]
        return np.zeros((1,) * (places.ndim - 1), dtype=int)

    def _steps(self, axis: int) -> Numbers:
        """Return the steps along an axis of the window, with the axes of the window."""
        return np.arange(self._sizes[axis]).reshape([self._sizes[axis] if axis == own else 1 for own in self._window])


def _filling(fill: Any, dtype: np.dtype) -> Any:
    if fill is not None:
        return fill
    if np.issubdtype(dtype, np.inexact):
        return np.nan
    if dtype == np.bool_:
        return True
    limits = np.iinfo(dtype)
    return limits.max if np.issubdtype(dtype, np.unsignedinteger) else limits.min


def _dynamic_slice(settings: Mapping[str, Any]) -> Callable[..., Any]:
    sizes = settings["slice_sizes"]

    def chosen(x: Numbers, *starts: Numbers) -> Numbers:
        firsts = [min(max(int(at), 0), whole - size) for at, whole, size in zip(starts, x.shape, sizes, strict=True)]
        return x[tuple(slice(first, first + size) for first, size in zip(firsts, sizes, strict=True))]

    return chosen


def _rounded(settings: Mapping[str, Any]) -> Callable[..., Any]:
    if int(settings["rounding_method"]) == 1:
        return np.round
    return lambda x: np.trunc(x + np.copysign(0.5, x))


def _converted(settings: Mapping[str, Any]) -> Callable[..., Any]:
    dtype = np.dtype(settings["new_dtype"])
    return lambda x: np.asarray(x).astype(dtype, copy=False)


MAKERS: dict[str, Maker] = {
    **{name: _plain(function) for name, function in {
        "add": np.add, "add_any": np.add, "sub": np.subtract, "mul": np.multiply, "div": _quotient, "neg": np.negative,
        "abs": np.abs, "sign": np.sign, "max": np.maximum, "min": np.minimum, "floor": np.floor, "ceil": np.ceil,
        "sqrt": np.sqrt, "rsqrt": lambda x: 1 / np.sqrt(x), "cbrt": np.cbrt, "square": np.square, "pow": np.power,
        "exp": np.exp, "exp2": np.exp2, "expm1": np.expm1, "log": np.log, "log1p": np.log1p,
        "logistic": special.expit, "erfc": error_complement,
        "sin": np.sin, "cos": np.cos, "tan": np.tan, "asin": np.arcsin, "acos": np.arccos, "atan": np.arctan,
        "atan2": np.arctan2, "sinh": np.sinh, "cosh": np.cosh, "tanh": np.tanh,
        "eq": np.equal, "ne": np.not_equal, "lt": np.less, "le": np.less_equal, "gt": np.greater,
        "ge": np.greater_equal, "is_finite": np.isfinite, "nextafter": np.nextafter, "rem": np.fmod,
        "and": np.bitwise_and, "or": np.bitwise_or, "xor": np.bitwise_xor, "not": np.invert,
        "copy": lambda x: x, "copy_p": lambda x: x, "stop_gradient": lambda x: x, "select_n": _select,
        "clamp": lambda low, x, high: np.minimum(np.maximum(x, low), high),
    }.items()},
    "integer_pow": _whole_power,
    "round": _rounded,
    "convert_element_type": _converted,
    "broadcast_in_dim": _broadcast,
    "reshape": lambda settings: lambda x: np.reshape(x, settings["new_sizes"]),
    "squeeze": lambda settings: lambda x: np.squeeze(x, tuple(settings["dimensions"])),
    "expand_dims": lambda settings: lambda x: np.expand_dims(x, tuple(settings["dimensions"])),
    "transpose": lambda settings: lambda x: np.transpose(x, settings["permutation"]),
    "rev": lambda settings: lambda x: np.flip(x, tuple(settings["dimensions"])),
    "slice": _slice,
    "split": _split,
    "dynamic_slice": _dynamic_slice,
    "gather": _Gather,
    "concatenate": lambda settings: lambda *parts: np.concatenate(parts, settings["dimension"]),
    "stack": lambda settings: lambda *parts: np.stack(parts, settings["axis"]),
    "pad": _pad,
    "iota": _iota,
    "reduce_sum": _reduced(np.sum), "reduce_max": _reduced(np.max), "reduce_min": _reduced(np.min),
    "reduce_prod": _reduced(np.prod), "reduce_and": _reduced(np.all), "reduce_or": _reduced(np.any),
    "cumsum": _running(np.cumsum), "cumprod": _running(np.cumprod),
    "cummax": _running(np.maximum.accumulate), "cummin": _running(np.minimum.accumulate),
    "dot_general": _dot,
}  # fmt: skip
"""Primitive → its maker."""

SELECTS = frozenset({"slice", "split", "gather", "dynamic_slice", "squeeze"})
"""Primitives that pass a part of an array on."""

SETTINGS = frozenset({
    "axes", "axis", "broadcast_dimensions", "dimension", "dimension_numbers", "dimensions", "dtype", "fill_value",
    "limit_indices", "mode", "new_dtype", "new_sizes", "padding_config", "permutation", "reverse", "rounding_method",
    "shape", "sizes", "slice_sizes", "start_indices", "strides", "y",
})  # fmt: skip
"""Settings that makers look at."""
