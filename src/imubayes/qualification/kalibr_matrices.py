"""Constants in the parameters of kalibr's `scale-misalignment` model.

kalibr goes from the truth to the reading, r_a = M_a f + b_a and r_g = M_g C ω + A C f + b_g in the frame i of its IMU,
with M_a and M_g lower triangular and C = C_gyro_i a rotation (kalibr_imu_camera_calibration/IccSensors.py,
IccScaledMisalignedImu).  Frame i is therefore fixed by the accelerometers: the inverse of the matrix of the constants
is split into a lower triangle and a rotation, C_i_body.
"""

from dataclasses import dataclass

import numpy as np

from imubayes.qualification.onboard_record import OnboardConstants


@dataclass(frozen=True)
class KalibrMatrices:
    """Matrices of kalibr's model, shape (3, 3) each; those of a triad that the unit lacks are None.

    Attributes
    ----------
    accelerometers, gyroscopes : M_a and M_g, lower triangular with positive diagonals.
    g_sensitivity : A, rad/s per m/s².
    gyro_from_imu : C_gyro_i.
    imu_from_body : rotation from the body axes of the constants to kalibr's frame i.
    """

    accelerometers: np.ndarray | None
    gyroscopes: np.ndarray | None
    g_sensitivity: np.ndarray | None
    gyro_from_imu: np.ndarray | None
    imu_from_body: np.ndarray


def kalibr_matrices(constants: OnboardConstants) -> KalibrMatrices:
    """Return the constants at the reference temperature as kalibr's matrices; triads must have three channels."""
    accelerometers, gyros = constants.triad("accelerometer"), constants.triad("gyro")
    lower, imu_from_body = None, np.eye(3)
    if accelerometers is not None:
        lower, imu_from_body = lower_and_rotation(np.linalg.inv(np.array(accelerometers.matrix)))
    if gyros is None:
        return KalibrMatrices(lower, None, None, None, imu_from_body)
    forward = np.linalg.inv(np.array(gyros.matrix))
    own, rotation = lower_and_rotation(forward @ imu_from_body.T)
    body = np.zeros((3, 3)) if gyros.g_sensitivity is None else forward @ np.array(gyros.g_sensitivity)
    return KalibrMatrices(lower, own, body @ imu_from_body.T @ rotation.T, rotation, imu_from_body)


def lower_and_rotation(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return L and Q of matrix = L Q: lower triangular with a positive diagonal, and orthogonal; shape (3, 3) each."""
    q, r = np.linalg.qr(matrix.T)
    signs = np.sign(np.diag(r))
    return (r.T * signs), (q * signs).T
