"""Accelerometer calibration from |f| = g alone, to detect disturbed poses and to level the others.

In every static pose the calibrated force has magnitude g, whatever the attitude.  Nine parameters (a triangular matrix
and an offset) are estimated by Gauss–Newton iteration with Huber weights, which bound the influence of a disturbed
pose.  With fewer than 12 poses the matrix is diagonal, with fewer than 8 nothing is fitted.

A pose is disturbed if its |f| differs from that which the calibration of the others predicts, by Student's t with
their degrees of freedom; the scatter is theirs, or that within the poses if this is larger.  The diagonal matrix
leaves out misalignments, which are no scatter: fewer than 12 poses are not judged.
"""

import math
from dataclasses import dataclass

import numpy as np
import scipy  # loads its parts when they are first used

STEPS = 30
HUBER = 1.5  # robust standard deviations
# Probability that any pose of a recording that was still is taken as disturbed.
FALSE_ALARM = 1e-3
MOST_DISTURBED = 1 / 3
ALL = 9
# Of the best determined direction: with less a pose would be levelled by noise.
_LEAST_TOLD = 0.01
# Numbers of disturbed poses that are all tried, and the logarithm of the least level that a double holds.
_EVERY, _LEAST_LOG = 40, -690.0
LEAST_FREEDOM = 2  # of the others, to judge one
LEAST_TO_JUDGE = ALL + LEAST_FREEDOM + 1
"""Poses from which on a disturbed one is found: nine parameters, and those that are left to judge it."""


@dataclass(frozen=True)
class MagnitudeFit:
    """Calibrated force = matrix @ (force − offset).

    Attributes
    ----------
    matrix, offset : shape (3, 3) and (3,).
    residual : |calibrated force| − g per pose, m/s².
    spread : robust standard deviation of the residual.
    parameters : number of fitted parameters.
    outliers : poses whose force is not of magnitude g, shape (poses,).
    """

    matrix: np.ndarray
    offset: np.ndarray
    residual: np.ndarray
    spread: float
    parameters: int
    outliers: np.ndarray

    def apply(self, force: np.ndarray) -> np.ndarray:
        """Return the calibrated force, shape (…, 3)."""
        return (force - self.offset) @ self.matrix.T

    @property
    def judges(self) -> bool:
        """Whether there are enough poses to identify a disturbed one by |f| = g."""
        return len(self.residual) >= LEAST_TO_JUDGE


def fit_magnitude(force: np.ndarray, gravity: float, scatter: np.ndarray | float = 0.0) -> MagnitudeFit:
    """Fit the pose means of the force.

    Parameters
    ----------
    force : shape (poses, 3), m/s² by the nominal scale.
    gravity : m/s².
    scatter : standard deviation of |force| as known from within the poses, shape (poses,), m/s².
    """
    free = _free_parameters(len(force))
    values = np.zeros(9)
    spread = _spread(_residual(values, force, gravity), 0)
    for _ in range(STEPS if free.any() else 0):
        residual = _residual(values, force, gravity)
        jacobian = magnitude_jacobian(values, force)[:, free]
        spread = _spread(residual, int(free.sum()))
        root = np.sqrt(1.0 / np.maximum(1.0, np.abs(residual) / (HUBER * spread)))
        step = _solved(root[:, None] * jacobian, -root * residual)
        values[free] += step
        if np.max(np.abs(step)) < 1e-10:
            break
    residual = _residual(values, force, gravity)
    matrix, offset = _unpack(values)
    count, spread = int(free.sum()), _spread(residual, int(free.sum()))
    if not free.all():  # few residuals may vanish by the fit alone
        spread = max(spread, float(np.max(scatter, initial=0.0)))
    outliers = _outliers(values, force, gravity, scatter) if free.all() else np.zeros(len(force), dtype=bool)
    return MagnitudeFit(matrix, offset, residual, spread, count, outliers)


def _outliers(values: np.ndarray, force: np.ndarray, gravity: float, scatter: np.ndarray | float) -> np.ndarray:
    """Return the largest set of poses each of which the calibration of the others excludes, shape (poses,).

    Sets are sought from the largest down, beginning with what the robust fit leaves over, which several disturbed poses
    do not mask, and from none upwards, which the leverage of a single one does not mask.
    """
    most = min(int(MOST_DISTURBED * len(force)), len(force) - ALL - LEAST_FREEDOM)
    found = np.zeros(len(force), dtype=bool)
    sizes = _sizes(most)
    for ordered in (sizes[:0:-1], sizes):
        contradiction = np.abs(_residual(values, force, gravity))
        for size in ordered:
            left = np.argsort(np.argsort(-contradiction)) < size
            contradiction, excluded = _judged(values, force, gravity, scatter, left)
            found = left if excluded and size > found.sum() else found
    # Between the sizes that were tried.
    while (size := int(found.sum()) + 1) <= most and size not in sizes:
        left = np.argsort(np.argsort(-_judged(values, force, gravity, scatter, found)[0])) < size
        if not _judged(values, force, gravity, scatter, left)[1]:
            break
        found = left
    return found


def _sizes(most: int) -> list[int]:
    """Return numbers of poses from 0 to `most`: each of the first, then in steps of a tenth."""
    every = min(most, _EVERY)
    steps = math.ceil(math.log(max(most, 1) / every) / math.log(1.1)) if every else 0
    return sorted({*range(every + 1), *(min(most, round(every * 1.1**step)) for step in range(steps + 1))})


def _judged(
    values: np.ndarray, force: np.ndarray, gravity: float, scatter: np.ndarray | float, left: np.ndarray
) -> tuple[np.ndarray, bool]:
    """Return how far each pose is from the calibration without some poses, and whether it excludes all of these.

    The level is shared by all sets of the size, since the set was chosen by its deviations.
    """
    values, covariance, spread = _least_squares(values, force[~left], gravity)
    jacobian = magnitude_jacobian(values, force)
    leverage = np.einsum("pi,ij,pj->p", jacobian, covariance, jacobian)
    deviation = np.abs(_residual(values, force, gravity))
    count, size = len(force), int(left.sum())
    sets = math.lgamma(count + 1) - math.lgamma(size + 1) - math.lgamma(count - size + 1)
    level = math.exp(max(math.log(FALSE_ALARM / 2) - sets, _LEAST_LOG))
    limit = scipy.stats.t.isf(level, count - size - ALL)
    allowed = limit * np.maximum(spread, scatter) * np.sqrt(1 + leverage)
    own = np.maximum(np.where(left, 1 + leverage, 1 - leverage), 1e-9)
    return deviation / np.sqrt(own), bool((deviation > allowed)[left].all())


def _least_squares(values: np.ndarray, force: np.ndarray, gravity: float) -> tuple[np.ndarray, np.ndarray, float]:
    """Return the nine parameters, their covariance for unit variance, and the standard deviation of the residual."""
    for _ in range(3):  # nearly linear
        jacobian, residual = magnitude_jacobian(values, force), _residual(values, force, gravity)
        values = values - _solved(jacobian, residual)
    jacobian, residual = magnitude_jacobian(values, force), _residual(values, force, gravity)
    return values, np.linalg.pinv(jacobian.T @ jacobian), float(np.sqrt(residual @ residual / (len(force) - ALL)))


def _solved(jacobian: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Return the least-squares solution without the directions that the poses hardly determine, (parameters,)."""
    size = np.linalg.norm(jacobian, axis=0) + 1e-300
    size[:-3] = size[:-3].max()
    size[-3:] = size[-3:].max()
    return np.linalg.lstsq(jacobian / size, right, rcond=_LEAST_TOLD)[0] / size


def _free_parameters(poses: int) -> np.ndarray:
    free = np.zeros(9, dtype=bool)
    if poses >= 8:
        free[[0, 1, 2, 6, 7, 8]] = True
    if poses >= LEAST_TO_JUDGE:
        free[:] = True
    return free


def _unpack(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return matrix and offset: three diagonal elements (less 1), three above the diagonal, three offsets."""
    matrix = np.diag(1.0 + values[:3])
    matrix[0, 1], matrix[0, 2], matrix[1, 2] = values[3:6]
    return matrix, values[6:]


def _residual(values: np.ndarray, force: np.ndarray, gravity: float) -> np.ndarray:
    matrix, offset = _unpack(values)
    return np.linalg.norm((force - offset) @ matrix.T, axis=1) - gravity


def magnitude_jacobian(values: np.ndarray, force: np.ndarray) -> np.ndarray:
    """Return the derivatives of the calibrated |force| by the nine parameters, (poses, 9)."""
    matrix, offset = _unpack(values)
    centred = force - offset
    along = centred @ matrix.T
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    x, y, z = centred.T
    u, v, w = along.T
    return np.column_stack([u * x, v * y, w * z, u * y, u * z, v * z, -(along @ matrix)])


def _spread(residual: np.ndarray, parameters: int) -> float:
    """Return the robust (MAD-based) standard deviation, corrected for the fitted parameters."""
    freedom = max(1, len(residual) - parameters)
    return max(1.4826 * float(np.median(np.abs(residual))) * np.sqrt(len(residual) / freedom), 1e-9)
