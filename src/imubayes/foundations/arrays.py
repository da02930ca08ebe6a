"""Arrays: names of shapes, NumPy or JAX, indexing, transfer to the device, batches, and rotations in JAX.

The letters used in shapes throughout: N nodes (instants at which the signal path is evaluated), R rows (recorded
values), C channels of one kind, E entries (rows × channels that were measured), P parameters (θ, in z), H
hyperparameters (noise scales, in z).

Indexing is unchecked, and batches have a fixed size.

Linear algebra that contains no forward model is written once for both libraries: `namespace` chooses NumPy if all
operands are NumPy arrays, which compiles nothing, and JAX inside compiled, differentiated or batched functions.

Frames: n local level (x East, y North, z Up), t table (z along the rotation axis), b body.  `C_nb` transforms a vector
from b to n.  Rotations are twice differentiable at zero angle.  Their products are written out by component, so that
XLA fuses them with the surrounding elementwise operations; a batched 3 × 3 matrix product would become a library call.
"""

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jax.scipy.linalg import solve_triangular as jax_solve_triangular
from jax.scipy.special import gammaln as jax_gammaln
from jaxtyping import Bool, Float, Int

# What is NumPy when a model is declared is a JAX array when it is computed with.  Algebra that is written for both
# libraries has the type of its operands, which a type checker cannot follow through `namespace`.
if TYPE_CHECKING:
    Array = Any
else:
    Array = jax.Array | np.ndarray

if TYPE_CHECKING:
    Scalar = Scalars = Array
else:
    # A scalar of NumPy is a number.
    Scalar = Float[Array, ""] | float
    # One value for each node or channel, or a single one: what travels along the path is batched by vmap.
    Scalars = Float[Array, "*batch"] | float
Vector3 = Float[Array, "3"]
Matrix3 = Float[Array, "3 3"]
Vectors = Float[Array, "*batch 3"]
Matrices = Float[Array, "*batch 3 3"]
Flag = Bool[Array, ""]


def vector3(x: Scalar, y: Scalar, z: Scalar) -> Vector3:
    """Return the vector, shape (3,), of three components x, y, z.

    Examples
    --------
    >>> import jax.numpy as jnp
    >>> import imubayes
    >>> imubayes.vector3(jnp.array(1.0), jnp.array(2.0), jnp.array(3.0)).tolist()
    [1.0, 2.0, 3.0]
    """
    return jnp.stack([x, y, z])


__all__ = [
    "Array",
    "Bool",
    "Flag",
    "Float",
    "Int",
    "Matrices",
    "Matrix3",
    "Scalar",
    "Scalars",
    "Vector3",
    "Vectors",
    "vector3",
]


def namespace(*operands: Any) -> Any:
    """Return `jax.numpy` if an operand is an array of JAX, also a traced one; else `numpy`."""
    for operand in operands:
        if isinstance(operand, jax.Array):
            return jnp
    return np


def take(values: Array, places: Int[Array, "..."]) -> Array:
    """Return values[places]; all indices must be non-negative and within the first axis.

    Plain indexing of JAX compiles to bounds and sign checks that cost more than the gather itself.
    """
    if namespace(values, places) is np:
        return np.asarray(values)[places]
    return jnp.asarray(values).at[places].get(mode="promise_in_bounds", wrap_negative_indices=False)


def take_last(values: Array, places: Int[Array, "..."]) -> Array:
    """Return values[..., places]; all indices must be non-negative and within the last axis."""
    if namespace(values, places) is np:
        return np.asarray(values)[..., places]
    return jnp.asarray(values).at[..., places].get(mode="promise_in_bounds", wrap_negative_indices=False)


def add_at(size: int, places: Int[Array, " n"], values: Float[Array, "n *columns"]) -> Float[Array, "size *columns"]:
    """Return the sums of values by their places, shape (size, …)."""
    if namespace(places, values) is not np:
        return jnp.zeros((size, *values.shape[1:])).at[places].add(values)
    if values.ndim == 1:
        return np.bincount(places, values, size)
    found = np.zeros((size, *values.shape[1:]))
    np.add.at(found, places, values)
    return found


def scan(step: Callable, first: Array, rows: tuple[Array, ...], reverse: bool = False) -> tuple[Array, Any]:
    """Return last state and stacked results of a recursion over the first axis of `rows`, as `jax.lax.scan`."""
    if namespace(first, *rows) is not np:
        return jax.lax.scan(step, first, rows, reverse=reverse)
    state, found = first, []
    for row in zip(*(each[::-1] for each in rows) if reverse else rows, strict=True):
        state, result = step(state, row)
        found.append(result)
    found = found[::-1] if reverse else found
    if found and isinstance(found[0], tuple):
        return state, tuple(map(np.stack, zip(*found, strict=True)))
    return state, np.stack(found)


def fixed(value: Any) -> Any:
    """Return a value that counts as a constant in derivatives."""
    return jax.lax.stop_gradient(value) if namespace(*jax.tree.leaves(value)) is jnp else value


def repeat(count: int, function: Callable[[Array], Array], value: Array) -> Array:
    """Return what a function makes of a value when it is applied so many times."""
    if namespace(value) is np:
        for _ in range(count):
            value = function(value)
        return value
    return jax.lax.fori_loop(0, count, lambda _, last: function(last), value)


def cholesky(matrix: Float[Array, "*batch P P"]) -> Float[Array, "*batch P P"]:
    """Return the lower Cholesky factor; NaN where a matrix is not positive definite, as JAX has it."""
    if namespace(matrix) is jnp:
        return jnp.linalg.cholesky(matrix)
    try:
        return np.linalg.cholesky(matrix)
    except np.linalg.LinAlgError:
        if matrix.ndim == 2:
            return np.full(matrix.shape, np.nan)
        return np.stack([cholesky(each) for each in matrix])


def solve_lower(
    factor: Float[Array, "P P"], values: Float[Array, "P *columns"], transposed: bool = False
) -> Float[Array, "P *columns"]:
    """Return L⁻¹ · values, or L⁻ᵀ · values, for a lower triangular factor L."""
    if namespace(factor, values) is jnp:
        return jax_solve_triangular(factor, values, lower=True, trans=int(transposed))
    if not factor.size:
        return values
    found, status = scipy.linalg.lapack.dtrtrs(factor.T, values, lower=0, trans=int(not transposed))
    return found if status == 0 else np.full(values.shape, np.nan)


def solve_each(
    factors: Sequence[np.ndarray] | np.ndarray, vectors: Float[Array, "n P"], transposed: bool = False
) -> Float[Array, "n P"]:
    """Return L⁻¹ · vector, or L⁻ᵀ · vector, for each of n lower triangular factors (P, P) and vectors of NumPy."""
    found, solve = np.empty_like(vectors), scipy.linalg.lapack.dtrtrs
    if found.size:
        for place, (factor, vector) in enumerate(zip(factors, vectors, strict=True)):
            solved, status = solve(factor.T, vector, lower=0, trans=int(not transposed))
            found[place] = solved if status == 0 else np.nan
    return found


def inverse_lower(factors: Float[Array, "n P P"]) -> Float[Array, "n P P"]:
    """Return L⁻¹ of each of n lower triangular factors of NumPy; NaN where one is singular."""
    found, invert = np.zeros_like(factors), scipy.linalg.lapack.dtrtri
    if found.size:
        for place, factor in enumerate(factors):
            inverse, status = invert(factor.T, lower=0)
            found[place] = inverse.T if status == 0 else np.nan
    return found


def cho_solve(factor: Float[Array, "P P"], values: Float[Array, "P *columns"]) -> Float[Array, "P *columns"]:
    """Return (L Lᵀ)⁻¹ · values for a lower Cholesky factor L."""
    return solve_lower(factor, solve_lower(factor, values), transposed=True)


def gammaln(x: Float[Array, "..."]) -> Float[Array, "..."]:
    """Return log Γ(x)."""
    return jax_gammaln(x) if namespace(x) is jnp else scipy.special.gammaln(x)


def on_device(tree: Any) -> Any:
    """Return a pytree with its arrays on the device, so that calls of a compiled function do not copy them again.

    Indices become int32, as the compiled gather uses them.
    """
    return jax.device_put(jax.tree.map(_shorten, tree))


def on_host[Tree](tree: Tree) -> Tree:
    """Return a pytree with its arrays as those of NumPy; on a CPU they are not copied."""
    return jax.tree.map(lambda leaf: np.asarray(leaf) if isinstance(leaf, jax.Array) else leaf, tree)


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


# Below this angle² the series of sin(x)/x and (1 − cos x)/x² to x⁴ is exact to the last bit of a double.
_SERIES_BELOW = 1e-4
# Traced once for all that call it, and then a part of their program: tracing takes longer than compiled code to load.
_traced_once = partial(jax.jit, inline=True)


@_traced_once
def rotate(matrix: Matrix3, vector: Vector3) -> Vector3:
    """Return matrix · vector, shapes (3, 3) and (3,).

    Examples
    --------
    >>> import jax.numpy as jnp
    >>> import imubayes
    >>> quarter = imubayes.exponential(jnp.array([0.0, 0.0, jnp.pi / 2]))
    >>> imubayes.rotate(quarter, jnp.array([1.0, 0.0, 0.0])).round(12).tolist()
    [0.0, 1.0, 0.0]
    """
    x, y, z = vector[0], vector[1], vector[2]
    return jnp.stack([matrix[i, 0] * x + matrix[i, 1] * y + matrix[i, 2] * z for i in range(3)])


@_traced_once
def rotate_back(matrix: Matrix3, vector: Vector3) -> Vector3:
    """Return matrixᵀ · vector."""
    x, y, z = vector[0], vector[1], vector[2]
    return jnp.stack([matrix[0, i] * x + matrix[1, i] * y + matrix[2, i] * z for i in range(3)])


@_traced_once
def compose(first: Matrix3, second: Matrix3) -> Matrix3:
    """Return the product first · second of two matrices, shape (3, 3).

    Examples
    --------
    >>> import jax.numpy as jnp
    >>> import imubayes
    >>> eighth = imubayes.exponential(jnp.array([0.0, 0.0, jnp.pi / 4]))
    >>> imubayes.compose(eighth, eighth)[1, 0].round(12).item()
    1.0
    """
    return jnp.stack([rotate(first, second[:, column]) for column in range(3)], axis=1)


@_traced_once
def cross(a: Vector3, b: Vector3) -> Vector3:
    """Return the vector product a × b, shape (3,).

    Examples
    --------
    >>> import jax.numpy as jnp
    >>> import imubayes
    >>> imubayes.cross(jnp.array([1.0, 0.0, 0.0]), jnp.array([0.0, 1.0, 0.0])).tolist()
    [0.0, 0.0, 1.0]
    """
    return jnp.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


@_traced_once
def exponential(rotation: Vector3) -> Matrix3:
    """Return exp([rotation]×), the matrix, shape (3, 3), of a rotation vector in rad, shape (3,).

    At small angles the coefficients are series, and the unused branch is evaluated at a safe angle, so that first
    and second derivatives are finite and correct at zero.

    Examples
    --------
    >>> import jax.numpy as jnp
    >>> import imubayes
    >>> imubayes.exponential(jnp.zeros(3)).tolist()
    [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
    """
    x, y, z = rotation[0], rotation[1], rotation[2]
    square = x * x + y * y + z * z
    small = square < _SERIES_BELOW
    safe = jnp.where(small, 1.0, square)
    angle = jnp.sqrt(safe)
    sinc = jnp.where(small, 1 - square / 6 * (1 - square / 20 * (1 - square / 42)), jnp.sin(angle) / angle)
    versine = jnp.where(small, 0.5 - square / 24 * (1 - square / 30 * (1 - square / 56)), (1 - jnp.cos(angle)) / safe)
    return jnp.stack(
        [
            jnp.stack([1 - versine * (y * y + z * z), versine * x * y - sinc * z, versine * x * z + sinc * y]),
            jnp.stack([versine * x * y + sinc * z, 1 - versine * (x * x + z * z), versine * y * z - sinc * x]),
            jnp.stack([versine * x * z - sinc * y, versine * y * z + sinc * x, 1 - versine * (x * x + y * y)]),
        ]
    )


@_traced_once
def turn_back_about_z(vector: Vector3, angle: Scalar) -> Vector3:
    """Return Rz(angle)ᵀ · vector; angle in rad."""
    c, s = jnp.cos(angle), jnp.sin(angle)
    return jnp.stack([c * vector[0] + s * vector[1], c * vector[1] - s * vector[0], vector[2]])


@_traced_once
def right_jacobian(rotation: Vector3) -> Matrix3:
    """Return J of exp(φ + dφ) = exp(φ) exp(J dφ), shape (3, 3), for a rotation vector φ in rad, shape (3,).

    J = I − (1 − cos θ)/θ² [φ]× + (θ − sin θ)/θ³ [φ]×², θ = |φ| (Solà, Deray and Atchuthan, arXiv 1812.01537, eq. 143).
    """
    square = rotation @ rotation
    small = square < _SERIES_BELOW
    safe = jnp.where(small, 1.0, square)
    angle = jnp.sqrt(safe)
    versine = jnp.where(small, 0.5 - square / 24 * (1 - square / 30 * (1 - square / 56)), (1 - jnp.cos(angle)) / safe)
    series = 1 / 6 - square / 120 * (1 - square / 42 * (1 - square / 72))
    third = jnp.where(small, series, (angle - jnp.sin(angle)) / (safe * angle))
    x, y, z = rotation[0], rotation[1], rotation[2]
    none = jnp.zeros_like(x)
    cross = jnp.stack([jnp.stack([none, -z, y]), jnp.stack([z, none, -x]), jnp.stack([-y, x, none])])
    return jnp.eye(3) - versine * cross + third * (cross @ cross)


def small_rotation(matrix: Matrix3) -> Vector3:
    """Return sin(θ)·axis of a rotation matrix, which is smooth and equals the rotation vector up to O(θ³)."""
    return 0.5 * jnp.stack([matrix[2, 1] - matrix[1, 2], matrix[0, 2] - matrix[2, 0], matrix[1, 0] - matrix[0, 1]])
