"""Rotations in JAX, twice differentiable at zero angle.

Frames: n local level (x East, y North, z Up), t table (z along the rotation axis), b body.  `C_nb` transforms a
vector from b to n.  Products are written out by component, so that XLA fuses them with the surrounding elementwise
operations; a batched 3 × 3 matrix product would become a library call.
"""

from functools import partial

import jax
import jax.numpy as jnp

from imubayes.array_shapes import Matrix3, Scalar, Vector3

# Below this angle² the series of sin(x)/x and (1 − cos x)/x² to x⁴ is exact to the last bit of a double.
_SERIES_BELOW = 1e-4
# Traced once for all that call it, and then a part of their program: tracing takes longer than compiled code to load.
_traced_once = partial(jax.jit, inline=True)


@_traced_once
def rotate(matrix: Matrix3, vector: Vector3) -> Vector3:
    """Return matrix · vector."""
    x, y, z = vector[0], vector[1], vector[2]
    return jnp.stack([matrix[i, 0] * x + matrix[i, 1] * y + matrix[i, 2] * z for i in range(3)])


@_traced_once
def rotate_back(matrix: Matrix3, vector: Vector3) -> Vector3:
    """Return matrixᵀ · vector."""
    x, y, z = vector[0], vector[1], vector[2]
    return jnp.stack([matrix[0, i] * x + matrix[1, i] * y + matrix[2, i] * z for i in range(3)])


@_traced_once
def compose(first: Matrix3, second: Matrix3) -> Matrix3:
    """Return first · second."""
    return jnp.stack([rotate(first, second[:, column]) for column in range(3)], axis=1)


@_traced_once
def cross(a: Vector3, b: Vector3) -> Vector3:
    """Return a × b."""
    return jnp.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


@_traced_once
def exponential(rotation: Vector3) -> Matrix3:
    """Return exp([rotation]×), the matrix of a rotation vector in rad.

    At small angles the coefficients are series, and the unused branch is evaluated at a safe angle, so that first
    and second derivatives are finite and correct at zero.
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
def small_rotation(matrix: Matrix3) -> Vector3:
    """Return sin(θ)·axis of a rotation matrix, which is smooth and equals the rotation vector up to O(θ³)."""
    return 0.5 * jnp.stack([matrix[2, 1] - matrix[1, 2], matrix[0, 2] - matrix[2, 0], matrix[1, 0] - matrix[0, 1]])
