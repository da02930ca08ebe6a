"""Constants for use on board, written in the format that a program reads."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from imubayes.display.onboard import formats
from imubayes.foundations.errors import input_error
from imubayes.foundations.files import write_text
from imubayes.noise_analysis.noise_record import NoiseDensity
from imubayes.qualification.onboard.losses import Loss, losses
from imubayes.qualification.onboard.record import OnboardConstants

Format = Literal["json", "c", "kalibr", "px4", "ardupilot", "ros"]


@dataclass(frozen=True)
class ExportOptions:
    """What formats need beside the constants.

    Attributes
    ----------
    rate : of the samples, Hz; None where unknown.
    topic : ROS topic.
    noise : kind of channel → noise density.
    accept_loss : whether a file may leave out what is larger than its uncertainty.
    """

    rate: float | None = None
    topic: str = "/imu0"
    noise: Mapping[str, NoiseDensity] = field(default_factory=dict)
    accept_loss: bool = False


def write_constants(constants: OnboardConstants, format: Format, out: Path, options: ExportOptions) -> tuple[Loss, ...]:
    """Write the constants; return what the format leaves out.

    Raises
    ------
    InputError
        where the format cannot hold the constants, or needs what is not known.
    """
    found = () if format in ("json", "ros") else losses(constants, format)
    if not options.accept_loss:
        formats.refuse_losses(found, format, str(out))
    write_text(out, constants_text(constants, format, found, options))
    return found


def constants_text(constants: OnboardConstants, format: Format, found: tuple[Loss, ...], options: ExportOptions) -> str:
    """Return the text of the file."""
    if format == "json":
        return constants.json_text()
    if format == "kalibr":
        if not options.rate:
            raise input_error(
                "the rate of the samples is not known", "--format kalibr", "a rate in Hz", "give --rate-hz"
            )
        return formats.kalibr_yaml(constants, found, options.noise, options.rate, options.topic)
    writers = {
        "c": formats.c_header,
        "px4": formats.px4_parameters,
        "ardupilot": formats.ardupilot_parameters,
        "ros": formats.ros_covariances,
    }
    return writers[format](constants, found)
