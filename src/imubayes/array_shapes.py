"""Array shapes, by name.

The letters used throughout: N nodes (instants at which the signal path is evaluated), R rows (recorded
values), C channels of one kind, E entries (rows × channels that were measured), P parameters (θ, in z),
H hyperparameters (noise scales, in z).
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

# What is NumPy when a model is declared is a JAX array when it is computed with.
Array = jax.Array | np.ndarray

Scalar = Float[Array, ""]
Vector3 = Float[Array, "3"]
Matrix3 = Float[Array, "3 3"]
# One value for each node or channel, or a single one: what travels along the path is batched by vmap.
Scalars = Float[Array, "*batch"]
Vectors = Float[Array, "*batch 3"]
Matrices = Float[Array, "*batch 3 3"]
Flag = Bool[Array, ""]


def vector3(x: Scalar, y: Scalar, z: Scalar) -> Vector3:
    """Return the vector of three components."""
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
