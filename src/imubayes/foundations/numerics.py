"""Numerical helpers that need NumPy alone: stretches, means of groups, cross products, quadrature, rounding, inverses.

Arrays of compiled functions are in `imubayes.foundations.arrays`, tail probabilities in
`imubayes.foundations.tail_probabilities`.
"""

from decimal import ROUND_HALF_EVEN, Decimal
from functools import lru_cache

import numpy as np

_CROSS = np.array(
    [[[0, 0, 0], [0, 0, 1], [0, -1, 0]], [[0, 0, -1], [0, 0, 0], [1, 0, 0]], [[0, 1, 0], [-1, 0, 0], [0, 0, 0]]]
)

# Order of differences that a slow change hardly adds to, and their variance of white noise of variance 1.
_ROUGH, _ROUGH_NOISE = 4, 70.0


def cross_matrices(vectors: np.ndarray) -> np.ndarray:
    """Return the matrices C of vectors v for which a @ C is v × a, shape (..., 3, 3)."""
    return np.tensordot(vectors, _CROSS, axes=1)


def angle_between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the angle between vectors, shape (…, 3) → (…), rad."""
    cosine = np.sum(a * b, axis=-1) / np.linalg.norm(a, axis=-1) / np.linalg.norm(b, axis=-1)
    return np.asarray(np.arccos(np.clip(cosine, -1.0, 1.0)))


def true_stretches(mask: np.ndarray) -> np.ndarray:
    """Return the first place of each stretch in which a mask (n,) holds, and the first behind it, (stretches, 2)."""
    change = np.diff(np.concatenate([[False], np.asarray(mask, dtype=bool), [False]]).astype(np.int8))
    return np.flatnonzero(change).reshape(-1, 2)


def group_means(values: np.ndarray, group: np.ndarray) -> np.ndarray:
    """Return at each entry the mean of the finite values of its group, (n,); 0 where the group has none.

    Parameters
    ----------
    values : shape (n,).
    group : shape (n,), numbers of the groups, from 0.
    """
    good = np.isfinite(values)
    total = np.bincount(group, np.where(good, values, 0.0))
    return (total / np.maximum(np.bincount(group, good), 1))[group]


def scatter_of_samples(readings: np.ndarray) -> np.ndarray:
    """Return the standard deviation of single samples about what changes slowly, (n, S) → (n,); NaN of too few.

    It is that of their fourth differences.
    """
    if readings.shape[1] <= _ROUGH + 1:
        return np.full(len(readings), np.nan)
    return np.sqrt(np.mean(np.diff(readings, _ROUGH, axis=1) ** 2, axis=1) / _ROUGH_NOISE)


def leading_decade(value: float, digits: int = 1) -> int:
    """Return the power of ten of the leading digit of a number after rounding to some significant digits.

    Of the number as it is written, ties to even (ISO 80000-1, B.3), as the numbers themselves are printed: 0.995 is 1.0
    to two digits, although its binary value is a little below that.
    """
    number = Decimal(repr(float(value)))
    if not number:
        return 0
    last = Decimal((0, (1,), number.adjusted() - digits + 1))
    return number.quantize(last, ROUND_HALF_EVEN).adjusted()


@lru_cache(maxsize=256)  # rows of a run, and quadratures of a report, have few numbers of nodes
def gauss_legendre(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return nodes on [−1, 1] and weights of Gauss–Legendre quadrature, (count,) each, not to be changed.

    Exact for polynomials of degree 2 count − 1.
    """
    return np.polynomial.legendre.leggauss(count)


def inverse_of_precision(precision: np.ndarray) -> np.ndarray:
    """Return the inverse of a positive definite matrix, (P, P).

    Some parameters of a servo table are determined to 1e-8 of their prior, and the eigenvalues of their precision
    differ by more than the rounding of the largest.  Cholesky's factor does not depend on the scale of the parameters,
    and weak directions are those of the largest variance, which rounding does not touch.
    """
    scale = np.sqrt(np.diag(precision))
    correlated = precision / np.outer(scale, scale)
    try:
        lower = np.linalg.cholesky(correlated)
    except np.linalg.LinAlgError:
        lower = np.linalg.cholesky(correlated + len(scale) * np.finfo(float).eps * np.eye(len(scale)))
    half = np.linalg.solve(lower, np.diag(1 / scale))
    return half.T @ half


def running_products(matrices: np.ndarray) -> np.ndarray:
    """Return the products of the first 0, 1, … K matrices of each stretch, (T, K, 3, 3) → (T, K + 1, 3, 3).

    Blocks of √K steps are multiplied side by side, then one block after another: 2√K products of arrays in place of K.
    """
    count, steps = matrices.shape[:2]
    size = max(1, round(steps**0.5))
    blocks = -(-steps // size)
    within = np.broadcast_to(np.eye(3), (count, blocks * size, 3, 3)).copy()
    within[:, :steps] = matrices
    within = within.reshape(count, blocks, size, 3, 3)
    for step in range(1, size):
        within[:, :, step] = within[:, :, step - 1] @ within[:, :, step]
    for block in range(1, blocks):
        within[:, block] = within[:, block - 1, -1:] @ within[:, block]
    products = within.reshape(count, blocks * size, 3, 3)[:, :steps]
    return np.concatenate([np.broadcast_to(np.eye(3), (count, 1, 3, 3)), products], axis=1)
