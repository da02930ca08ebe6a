"""Least squares with coefficients whose sign is known: a width, a rate or a spread cannot be negative.

Under no effect the drop of χ² is then a mixture of χ² distributions (chi-bar-squared: Silvapulle and Sen, Constrained
Statistical Inference, 2005).  With one such coefficient half of the residuals ask for the wrong sign and give 0, the
other half χ² with one degree of freedom.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import special

from imubayes.criticism import thresholds
from imubayes.tail_probabilities import chi2_log_survival, f_log_survival, normal_survival


@dataclass(frozen=True)
class Cone:
    """What columns span with coefficients of the allowed sign.

    Attributes
    ----------
    span : shape (R, d), orthonormal basis of all columns.
    columns : shape (d, C), the columns in that basis, of unit length before projection and of the allowed sign.
    bounded : shape (C,), bool: coefficients that may not be negative.
    weights : shape (d + 1,), probability under no effect that so many directions are used.
    """

    span: np.ndarray
    columns: np.ndarray
    bounded: np.ndarray
    weights: np.ndarray

    @staticmethod
    def of(span: np.ndarray, columns: np.ndarray, bounded: np.ndarray) -> "Cone":
        """Return the cone of columns (R, C) within their span (R, d)."""
        inside = span.T @ columns
        count = span.shape[1]
        if count <= 1:
            return Cone(span, inside, bounded, np.array([0.5, 0.5]) if count else np.ones(1))
        draws = np.random.default_rng(0).normal(size=(thresholds.CONE_DRAWS, count))
        used = _solved(inside, bounded, draws) != 0
        directions = np.minimum(used.sum(axis=1), count)
        return Cone(span, inside, bounded, np.bincount(directions, minlength=count + 1) / len(draws))

    def coefficients(self, residuals: np.ndarray) -> np.ndarray:
        """Return the coefficients of the allowed sign that fit residuals (n, R) best, (n, C)."""
        return _solved(self.columns, self.bounded, residuals @ self.span)

    def p_values(self, residuals: np.ndarray) -> np.ndarray:
        """Return the p-value of what each of some residuals (n, R) of known noise has along the cone, (n,)."""
        found = self.coefficients(residuals) @ self.columns.T
        return self.survival(np.sum(found**2, axis=1))

    def survival(self, chi2: np.ndarray | float) -> np.ndarray:
        """Return the probability of a drop of χ² of at least so much under no effect."""
        return np.exp(self.log_survival(chi2))

    def log_survival(self, chi2: np.ndarray | float) -> np.ndarray:
        """Return the logarithm of `survival`."""
        chi2 = np.asarray(chi2, dtype=float)
        freedom = np.arange(1, len(self.weights)).reshape(-1, *(1,) * chi2.ndim)
        weights = self.weights[1:].reshape(freedom.shape)
        if not len(freedom):
            return np.zeros_like(chi2)
        tails = np.asarray(special.logsumexp(chi2_log_survival(chi2, freedom), axis=0, b=weights))
        return np.where(chi2 > 0, tails, 0.0)

    def f_log_survival(self, total: float, denominator: float) -> float:
        """Return `log_survival` where the noise scale is estimated with so many degrees of freedom."""
        freedom = np.arange(1, len(self.weights))
        if not (total > 0 and len(freedom)):
            return 0.0
        tails = f_log_survival(total / freedom, freedom, denominator)
        return float(np.asarray(special.logsumexp(tails, b=self.weights[1:])))


def least_p_of_cones(cones: Sequence[Cone], residuals: np.ndarray) -> np.ndarray:
    """Return the smallest p-value of residuals (n, R) over all cones, (n,); 1 without cones."""
    one = [cone.columns.shape == (1, 1) and bool(cone.bounded[0]) and cone.columns[0, 0] != 0 for cone in cones]
    smallest = [np.ones(len(residuals))]
    smallest += [cone.p_values(residuals) for cone, alone in zip(cones, one, strict=True) if not alone]
    rays = [cone.span * np.sign(cone.columns[0, 0]) for cone, alone in zip(cones, one, strict=True) if alone]
    if rays:
        # A single coefficient: half the tail of χ² with one degree of freedom, which is the normal tail of the score.
        largest = (residuals @ np.concatenate(rays, axis=1)).max(axis=1)
        smallest.append(np.where(largest > 0, normal_survival(largest), 1.0))
    return np.min(smallest, axis=0)


def _solved(columns: np.ndarray, bounded: np.ndarray, targets: np.ndarray) -> np.ndarray:
    """Return the least-squares coefficients, (n, C), of targets (n, d) on columns (d, C), bounded ones at least 0.

    Coordinate descent, which solves this convex problem for all targets at once; columns of different channels are
    orthogonal or nearly so, and it ends after a few rounds.
    """
    square, drive = columns.T @ columns, targets @ columns
    size = np.diag(square)
    found = np.zeros_like(drive)
    scale = 1e-9 * (1e-300 + float(np.abs(drive).max(initial=0.0)))
    for _ in range(thresholds.CONE_ROUNDS):
        before = found.copy()
        for place in np.flatnonzero(size > 0).tolist():
            free = found[:, place] + (drive[:, place] - found @ square[:, place]) / size[place]
            found[:, place] = np.maximum(free, 0.0) if bounded[place] else free
        if np.all(np.abs(found - before) * np.sqrt(size) <= scale):
            break
    return found
