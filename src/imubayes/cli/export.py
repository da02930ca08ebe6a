"""`imubayes export`: constants of a calibrated unit for the computer on board."""

from pathlib import Path
from typing import Literal

from imubayes.cli.options import Flag, Trust


def export(
    result: Path,
    *,
    out: Path,
    format: Literal["json", "c", "kalibr", "px4", "ardupilot", "ros"] = "json",
    noise: Path | None = None,
    rate_hz: float | None = None,
    topic: str = "/imu0",
    accept_loss: Flag = False,
    trust: Trust = False,
) -> int:
    """Write the constants of a unit in the format of the program that will use them.

    Matrix, biases and gains over temperature with the joint covariance of all of them (json), as a C header with the
    function that applies them, as kalibr's imu.yaml, as PX4 or ArduPilot parameters, or as covariances of a ROS Imu
    message. A format that cannot hold what is larger than its uncertainty is refused.

    Example: imubayes export results/desk-imu --format c --out results/constants.h

    Parameters
    ----------
    result
        Result folder of a fit of the unit.
    out
        The file to write.
    format
        json, c, kalibr, px4, ardupilot or ros.
    noise
        noise.json of `imubayes noise` on a static record of the unit, for kalibr.
    rate_hz
        Rate of the samples on board in Hz, for kalibr.
    topic
        ROS topic, for kalibr.
    accept_loss
        Leave out what the format cannot hold; the file says what and how large.
    trust
        Trust the effect files that come along: they are code, and run, now and later, only where they are trusted.
    """
    from imubayes.cli.session import start_jax, trusting

    start_jax()
    trusting(result, trust)
    from imubayes import api
    from imubayes.display.onboard.losses_in_words import in_words
    from imubayes.errors import input_error

    if rate_hz is not None and not 0 < rate_hz < float("inf"):
        raise input_error(f"a rate of {rate_hz:g} Hz", "--rate-hz", "a number above 0", "correct it")
    for loss in api.export_constants(
        result, out, format, noise=noise, rate=rate_hz, topic=topic, accept_loss=accept_loss
    ):
        print(f"left out: {in_words(loss)}")
    print(f"wrote {out}")
    return 0
