"""Noise in kalibr's `imu.yaml`."""

from collections.abc import Mapping, Sequence

from imubayes_recordings.noise_analysis.noise_record import NoiseDensity

KALIBR_NAMES = {"accelerometer": "accelerometer", "gyro": "gyroscope"}
"""Kind of channel → as kalibr names it."""
_TOPIC = "/imu0"


def yaml_number(value: float) -> str:
    """Return a number that YAML 1.1 reads as one: with a point, as in 1.0e-05; 1e-05 would be a text."""
    mantissa, mark, exponent = repr(float(value)).partition("e")
    return f"{mantissa}{'' if '.' in mantissa or not mark else '.0'}{mark}{exponent}"


def yaml_row(values: Sequence[float]) -> str:
    """Return a list of numbers for YAML."""
    return f"[{', '.join(map(yaml_number, values))}]"


def density_lines(noise: Mapping[str, NoiseDensity]) -> list[str]:
    """Return the keys of the densities with what has to be known of them; what is not known is a comment."""
    lines = ["# Noise is that of the noisiest axis of a triad, in SI units."]
    for kind, name in KALIBR_NAMES.items():
        known = noise.get(kind, NoiseDensity(None, None))
        if known.walk_is_limit:
            lines.append(f"# {name}_random_walk is an upper limit of 95 %: the record did not determine it.")
        for key, value in (("noise_density", known.white), ("random_walk", known.walk)):
            told = f"{name}_{key}: {yaml_number(value)}" if value else f"# {name}_{key}: not known from these records"
            lines.append(told)
    return lines


def noise_yaml(noise: Mapping[str, NoiseDensity], rate: float, source: str) -> str:
    """Return `imu.yaml` without a fit: noise and rate, with kalibr's model of calibrated readings.

    Parameters
    ----------
    noise : kind of channel → density.
    rate : of the samples, Hz.
    source : what the record is of, for the heading.
    """
    lines = [
        f"# imu.yaml for kalibr: noise of {source}, from its static records by `imubayes noise`.",
        "# No scale factors or misalignments: `imubayes export --format kalibr` writes them from a fit.",
        *density_lines(noise),
        f"rostopic: {_TOPIC}",
        f"update_rate: {yaml_number(rate)}",
        "model: calibrated",
        "time_offset: 0.0",
    ]
    return "\n".join([*lines, ""])
