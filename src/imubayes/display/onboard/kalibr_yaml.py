"""Constants and noise as the `imu.yaml` of kalibr."""

from collections.abc import Mapping, Sequence

import numpy as np

from imubayes.display.onboard.losses_in_words import heading, yaml_number, yaml_row
from imubayes.errors import InputError, Issue
from imubayes.qualification.kalibr_matrices import kalibr_matrices
from imubayes.qualification.noise_densities import NoiseDensity
from imubayes.qualification.onboard_losses import Loss
from imubayes.qualification.onboard_record import OnboardConstants

_NAMES = {"accelerometer": "accelerometer", "gyro": "gyroscope"}


def kalibr_yaml(
    constants: OnboardConstants, found: Sequence[Loss], noise: Mapping[str, NoiseDensity], rate: float, topic: str
) -> str:
    """Return `imu.yaml`: noise as `ImuConfig` asks for it, and the matrices of the model `scale-misalignment`.

    Parameters
    ----------
    noise : kind of channel → density.
    rate : of the samples, Hz.
    topic : ROS topic.

    Raises
    ------
    InputError
        where a triad has not three channels, or a noise density is not known.
    """
    _refuse_incomplete(constants, noise)
    matrices = kalibr_matrices(constants)
    limits = [name for kind, name in _NAMES.items() if kind in noise and noise[kind].walk_is_limit]
    lines = [f"# {line}" for line in heading(constants, found)]
    lines += [
        "# Noise is that of the noisiest axis of a triad, in SI units.",
        *(f"# {name}_random_walk is an upper limit of 95 %: the record did not determine it." for name in limits),
        "# r_a = M f + b_a; r_g = M C_gyro_i w + A C_gyro_i f + b_g: from the truth to the reading, in the frame i.",
        "# Biases are not part of this file: kalibr estimates them along the recording.",
        "# C_i_body turns body axes of the campaign into the frame i; kalibr ignores it.",
        f"rostopic: {topic}",
        f"update_rate: {yaml_number(rate)}",
        "model: scale-misalignment",
        "T_i_b:",
        *(f"- {yaml_row(row)}" for row in np.eye(4).tolist()),
        "time_offset: 0.0",
    ]
    for kind, name in _NAMES.items():
        known = noise[kind]
        if known.white is not None and known.walk is not None:
            lines.append(f"{name}_noise_density: {yaml_number(known.white)}")
            lines.append(f"{name}_random_walk: {yaml_number(known.walk)}")
    if matrices.accelerometers is not None:
        lines += ["accelerometers:", *_matrix("M", matrices.accelerometers)]
    if matrices.gyroscopes is not None and matrices.g_sensitivity is not None and matrices.gyro_from_imu is not None:
        lines += ["gyroscopes:", *_matrix("M", matrices.gyroscopes), *_matrix("A", matrices.g_sensitivity)]
        lines += _matrix("C_gyro_i", matrices.gyro_from_imu)
    lines += [line[2:] for line in _matrix("C_i_body", matrices.imu_from_body)]
    return "\n".join([*lines, ""])


def _matrix(name: str, values: np.ndarray) -> list[str]:
    return [f"  {name}:", *(f"  - {yaml_row(row)}" for row in values.tolist())]


def _refuse_incomplete(constants: OnboardConstants, noise: Mapping[str, NoiseDensity]) -> None:
    issues = [
        Issue(
            f"the unit has {len(triad.channels)} {triad.kind} channels", "--format kalibr",
            "three channels of a kind", "export as json or c",
        )
        for triad in constants.triads if len(triad.channels) != 3
    ]  # fmt: skip
    present = {triad.kind for triad in constants.triads}
    issues += [
        Issue(f"the unit has no complete set of {kind}s", "--format kalibr", "gyros and accelerometers",
              "export as json or c")
        for kind in _NAMES if kind not in present
    ]  # fmt: skip
    for kind in sorted(present):
        known = noise.get(kind, NoiseDensity(None, None))
        lacking = [word for word, value in (("white noise density", known.white), ("random walk", known.walk))
                   if not value]  # fmt: skip
        issues += [
            Issue(
                f"the {word} of the {kind}s is not known, and kalibr needs it", "--format kalibr",
                "a record of `imubayes noise`, or a model with the noise",
                "name noise.json of a static record of the unit with --noise",
            )
            for word in lacking
        ]  # fmt: skip
    if issues:
        raise InputError(issues)
