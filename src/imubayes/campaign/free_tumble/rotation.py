"""Small rotations in NumPy: exponential and logarithm for stacks of rotation vectors."""

import numpy as np


def exponential(vectors: np.ndarray) -> np.ndarray:
    """Return the rotation matrices of rotation vectors, shape (…, 3) → (…, 3, 3) (Rodrigues)."""
    angle = np.linalg.norm(vectors, axis=-1)[..., None, None]
    cross = cross_matrix(vectors)
    first = np.sinc(angle / np.pi)
    second = 0.5 * np.sinc(angle / (2 * np.pi)) ** 2
    return np.eye(3) + first * cross + second * (cross @ cross)


def logarithm(matrices: np.ndarray) -> np.ndarray:
    """Return the rotation vectors of rotations by less than half a turn, shape (…, 3, 3) → (…, 3)."""
    skew = 0.5 * (matrices - np.swapaxes(matrices, -1, -2))
    sine_axis = np.stack([skew[..., 2, 1], skew[..., 0, 2], skew[..., 1, 0]], axis=-1)
    sine = np.linalg.norm(sine_axis, axis=-1, keepdims=True)
    cosine = 0.5 * (np.trace(matrices, axis1=-2, axis2=-1)[..., None] - 1.0)
    angle = np.arctan2(sine, cosine)
    return sine_axis * np.where(sine > 1e-12, angle / np.where(sine > 1e-12, sine, 1.0), 1.0)


def cross_matrix(vectors: np.ndarray) -> np.ndarray:
    """Return [v]×, so that [v]× w = v × w."""
    x, y, z = np.moveaxis(vectors, -1, 0)
    zero = np.zeros_like(x)
    return np.stack([np.stack([zero, -z, y], -1), np.stack([z, zero, -x], -1), np.stack([-y, x, zero], -1)], axis=-2)


def shortest(source: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Return the smallest rotation that takes the direction of `source` to that of `target`, both shape (3,)."""
    a, b = source / np.linalg.norm(source), target / np.linalg.norm(target)
    axis, cosine = np.cross(a, b), float(a @ b)
    if cosine < -1 + 1e-12:
        side = np.eye(3)[np.argmin(np.abs(a))]
        half = np.cross(a, side)
        return exponential(np.pi * half / np.linalg.norm(half))
    cross = cross_matrix(axis)
    return np.eye(3) + cross + cross @ cross / (1 + cosine)
