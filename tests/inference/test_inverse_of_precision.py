"""The inverse of a precision whose parameters are determined to very different shares of their priors."""

from fractions import Fraction

import numpy as np
import pytest

from imubayes.foundations.numerics import inverse_of_precision
from imubayes.inference.laplace_marginal import inverse_within

DETERMINED = np.array([1e9, 1.0, 1e8, 3e2, 1e6])
"""Prior over posterior standard deviation: that of a servo table over a day reaches 1e8 and more."""


def precision() -> np.ndarray:
    """A precision of unit prior and of data that correlate every parameter with the others."""
    factors = np.random.default_rng(5).normal(size=(12, 5)) * DETERMINED
    return factors.T @ factors + np.eye(5)


def exact_inverse(matrix: np.ndarray) -> np.ndarray:
    """Gauss–Jordan elimination in rational numbers."""
    size = len(matrix)
    rows = [[Fraction(float(value)) for value in row] + [Fraction(int(i == k)) for k in range(size)]
            for i, row in enumerate(matrix)]  # fmt: skip
    for pivot in range(size):
        rows[pivot] = [value / rows[pivot][pivot] for value in rows[pivot]]
        for other in set(range(size)) - {pivot}:
            factor = rows[other][pivot]
            rows[other] = [a - factor * b for a, b in zip(rows[other], rows[pivot], strict=True)]
    return np.array([[float(value) for value in row[size:]] for row in rows])


def test_it_is_exact_on_the_scale_of_each_parameter():
    expected = exact_inverse(precision())
    found = inverse_of_precision(precision())
    scale = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(found / np.outer(scale, scale), expected / np.outer(scale, scale), atol=1e-12)


def test_the_widest_direction_is_right_where_the_least_eigenvalue_of_the_precision_is_not():
    widest = np.linalg.eigvalsh(exact_inverse(precision()))[-1]
    assert np.linalg.eigvalsh(inverse_of_precision(precision()))[-1] == pytest.approx(widest, rel=1e-9)
    assert 1 / np.linalg.eigvalsh(precision())[0] != pytest.approx(widest, rel=1e-2)


def test_rounding_beyond_positive_definite_gives_finite_variances():
    alike = np.full((3, 3), 1e17) + np.eye(3)
    assert np.linalg.eigvalsh(alike)[0] < 0.5
    inverse = inverse_of_precision(alike)
    assert np.isfinite(inverse).all()
    assert (np.diag(inverse) > 0).all()


def unequal() -> tuple[np.ndarray, np.ndarray]:
    """A precision of which one direction is the prior's alone, and what completes that to an orthonormal basis."""
    random = np.random.default_rng(6)
    basis = np.linalg.qr(random.normal(size=(5, 5)))[0]
    factors = random.normal(size=(12, 4)) * np.array([1e4, 1e5, 1e6, 3e7])
    strong = basis[:, 1:]
    return strong @ (factors.T @ factors) @ strong.T + np.eye(5), strong


def test_the_strong_directions_next_to_one_of_the_prior_are_told_to_their_last_digits():
    precision, strong = unequal()
    within = strong.T @ precision @ strong
    scale = np.sqrt(np.diag(exact_inverse(within)))
    expected = exact_inverse(within) / np.outer(scale, scale)
    found = strong.T @ inverse_within(precision, strong) @ strong
    np.testing.assert_allclose(found / np.outer(scale, scale), expected, atol=1e-9)
    # From the eigenvalues of the whole covariance, the planted fault, the smallest variance is off by a per cent.
    variances, vectors = np.linalg.eigh(inverse_of_precision(precision))
    planted = strong.T @ (vectors[:, :-1] * variances[:-1]) @ vectors[:, :-1].T @ strong
    assert np.abs(planted / np.outer(scale, scale) - expected).max() > 1e-3
