"""Kalibr's `imu.yaml` with the constants of a fitted unit."""

from collections.abc import Mapping

import numpy as np

from imubayes.foundations.errors import InputError, Issue, input_error
from imubayes_qualification.onboard.record import OnboardConstants, TriadConstants, kalibr_matrices
from imubayes_recordings.display.kalibr_noise import KALIBR_NAMES, density_lines, yaml_number, yaml_row
from imubayes_recordings.noise_analysis.noise_record import NoiseDensity

_WHERE = "--format kalibr"


def kalibr_yaml(
    constants: OnboardConstants, noise: Mapping[str, NoiseDensity], rate: float | None, topic: str
) -> list[str]:
    """Return the lines of `imu.yaml`: noise as `ImuConfig` asks for it, and the model `scale-misalignment`.

    Parameters
    ----------
    noise : kind of channel → density.
    rate : of the samples, Hz.
    topic : ROS topic.

    Raises
    ------
    InputError
        if a triad has not three channels, or the rate or a noise density is not known.
    """
    if not rate:
        raise input_error("the sampling rate is not known", _WHERE, "a rate in Hz", "give --rate-hz")
    matrices = kalibr_matrices(*_triads(constants, noise))
    return [
        "# r_a = M f + b_a; r_g = M C_gyro_i w + A C_gyro_i f + b_g: from the truth to the reading, in the frame i.",
        "# Biases are not part of this file: kalibr estimates them along the recording.",
        "# C_i_body turns body axes of the campaign into the frame i; kalibr ignores it.",
        f"rostopic: {topic}",
        f"update_rate: {yaml_number(rate)}",
        "model: scale-misalignment",
        "T_i_b:",
        *(f"- {yaml_row(row)}" for row in np.eye(4).tolist()),
        "time_offset: 0.0",
        *density_lines(noise),
        "accelerometers:",
        *_matrix("M", matrices.accelerometers),
        "gyroscopes:",
        *_matrix("M", matrices.gyroscopes),
        *_matrix("A", matrices.g_sensitivity),
        *_matrix("C_gyro_i", matrices.gyro_from_imu),
        *(line[2:] for line in _matrix("C_i_body", matrices.imu_from_body)),
    ]


def _matrix(name: str, values: np.ndarray) -> list[str]:
    return [f"  {name}:", *(f"  - {yaml_row(row)}" for row in values.tolist())]


def _triads(constants: OnboardConstants, noise: Mapping[str, NoiseDensity]) -> tuple[TriadConstants, TriadConstants]:
    """Return accelerometers and gyros, of which kalibr needs three channels each, with their noise."""
    issues = [
        Issue(
            f"the unit has {len(triad.channels)} {triad.kind} channels", _WHERE,
            "three channels of a kind", "export as json or c",
        )
        for triad in constants.triads if len(triad.channels) != 3
    ]  # fmt: skip
    present = {triad.kind for triad in constants.triads}
    issues += [
        Issue(f"the unit has no complete set of {kind}s", _WHERE, "gyros and accelerometers",
              "export as json or c")
        for kind in KALIBR_NAMES if kind not in present
    ]  # fmt: skip
    for kind in sorted(present):
        known = noise.get(kind, NoiseDensity(None, None))
        lacking = [word for word, value in (("white noise density", known.white), ("random walk", known.walk))
                   if not value]  # fmt: skip
        issues += [
            Issue(
                f"the {word} of the {kind}s is not known, and kalibr needs it", _WHERE,
                "a record of `imubayes noise`, or a model with the noise",
                "name noise.json of a static record of the unit with --noise",
            )
            for word in lacking
        ]  # fmt: skip
    accelerometers, gyros = constants.triad("accelerometer"), constants.triad("gyro")
    if issues or accelerometers is None or gyros is None:
        raise InputError(issues)
    return accelerometers, gyros
