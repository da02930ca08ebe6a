"""Accelerometer calibration from |f| = g alone, to detect disturbed poses and to level the others.

In every static pose the calibrated force has magnitude g, whatever the attitude.  Nine parameters (a triangular matrix
and an offset) are estimated by Gauss–Newton iteration with Huber weights, which bound the influence of a disturbed
pose.  With fewer than 12 poses the matrix is diagonal, with fewer than 8 nothing is fitted.
"""

from dataclasses import dataclass

import numpy as np

STEPS = 30
HUBER = 1.5  # robust standard deviations
OUTLIER = 5.0


@dataclass(frozen=True)
class MagnitudeFit:
    """Calibrated force = matrix @ (force − offset).

    Attributes
    ----------
    matrix, offset : shape (3, 3) and (3,).
    residual : |calibrated force| − g per pose, m/s².
    spread : robust standard deviation of the residual.
    parameters : number of fitted parameters.
    """

    matrix: np.ndarray
    offset: np.ndarray
    residual: np.ndarray
    spread: float
    parameters: int

    def apply(self, force: np.ndarray) -> np.ndarray:
        """Return the calibrated force, shape (…, 3)."""
        return (force - self.offset) @ self.matrix.T

    @property
    def outliers(self) -> np.ndarray:
        """Mask of the poses whose force is not of magnitude g, shape (poses,)."""
        return np.abs(self.residual) > OUTLIER * self.spread


def fit_magnitude(force: np.ndarray, gravity: float) -> MagnitudeFit:
    """Fit the pose means of the force, shape (poses, 3), m/s² by the nominal scale."""
    free = _free_parameters(len(force))
    values = np.zeros(9)
    spread = _spread(_residual(values, force, gravity), 0)
    for _ in range(STEPS if free.any() else 0):
        residual = _residual(values, force, gravity)
        jacobian = _jacobian(values, force)[:, free]
        spread = _spread(residual, int(free.sum()))
        root = np.sqrt(1.0 / np.maximum(1.0, np.abs(residual) / (HUBER * spread)))
        step = np.linalg.lstsq(root[:, None] * jacobian, -root * residual, rcond=None)[0]
        values[free] += step
        if np.max(np.abs(step)) < 1e-10:
            break
    residual = _residual(values, force, gravity)
    matrix, offset = _unpack(values)
    return MagnitudeFit(matrix, offset, residual, _spread(residual, int(free.sum())), int(free.sum()))


def _free_parameters(poses: int) -> np.ndarray:
    free = np.zeros(9, dtype=bool)
    if poses >= 8:
        free[[0, 1, 2, 6, 7, 8]] = True
    if poses >= 12:
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


def _jacobian(values: np.ndarray, force: np.ndarray) -> np.ndarray:
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
