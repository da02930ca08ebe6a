"""Covariances for the ROS message `sensor_msgs/Imu`."""

from collections.abc import Sequence

import numpy as np

from imubayes.display.onboard.losses_in_words import heading, yaml_row
from imubayes.qualification.onboard_conventions import measurement_covariances
from imubayes.qualification.onboard_losses import Loss
from imubayes.qualification.onboard_record import OnboardConstants

_FIELDS = {"gyro": ("angular_velocity", "rad^2/s^2"), "accelerometer": ("linear_acceleration", "m^2/s^4")}


def ros_covariances(constants: OnboardConstants, found: Sequence[Loss]) -> str:
    """Return the covariances of a corrected sample as YAML, row-major about x, y, z."""
    lines = [f"# {line}" for line in heading(constants, found)]
    lines += [
        "# Of samples that were corrected with the constants (`imubayes export --format json` or c), in body axes.",
        "# *_covariance: noise of one sample, independent from sample to sample: what filters take it for.",
        "# *_systematic_covariance: calibration at zero input and run-to-run offset; the same for all samples of a",
        "# recording. It does not average, and is not part of the message: a filter estimates it as a bias.",
    ]
    if constants.slow_noise:
        lines.append(f"# In neither: {', '.join(constants.slow_noise)}.")
    lines.append(f"orientation_covariance: {yaml_row([-1.0] + [0.0] * 8)}  # no orientation")
    for triad in constants.triads:
        field, unit = _FIELDS[triad.kind]
        noise, systematic = measurement_covariances(constants, triad)
        lines += [
            f"{field}_covariance: {_flat(noise)}  # {unit}",
            f"{field}_systematic_covariance: {_flat(systematic)}  # {unit}",
        ]
    return "\n".join([*lines, ""])


def _flat(matrix: np.ndarray) -> str:
    return yaml_row([float(f"{value:.9g}") for value in matrix.ravel()])
