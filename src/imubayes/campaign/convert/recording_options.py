"""Options of a conversion: what the recording itself does not state."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any

from imubayes.errors import InputError, Issue, closest_first
from imubayes.procedures import PROCEDURES

ACCEL_UNITS = {"m/s^2": "m/s^2", "g": "g", "count": "m/s^2"}
GYRO_UNITS = {"rad/s": "rad/s", "deg/s": "deg/s", "count": "rad/s"}
TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
DELIMITERS = {"comma": ",", "semicolon": ";", "tab": "\t", "space": None}


@dataclass(frozen=True)
class ConvertOptions:
    """Options of a conversion."""

    name: str = ""
    """Name of the campaign; by default the name of its folder."""
    serial: str = ""
    """Serial number of the unit."""
    accel_unit: str = "m/s^2"
    """Unit of the accelerometers: m/s^2, g or count."""
    gyro_unit: str = "rad/s"
    """Unit of the gyros: rad/s, deg/s or count."""
    accel_scale: Sequence[float] | None = None
    """Nominal counts per m/s², one number or one per axis; by default estimated from the recording."""
    accel_offset: Sequence[float] | None = None
    """Counts at zero input, one number or one per axis."""
    gyro_scale: Sequence[float] | None = None
    """Nominal counts per rad/s, one number or one per axis; by default estimated from the recording."""
    gyro_offset: Sequence[float] | None = None
    """Counts at zero rate, one number or one per axis."""
    sample_rate_hz: float | None = None
    """Sampling rate of a recording without a time column."""
    time_unit: str = "s"
    """Unit of the time column: s, ms, us or ns."""
    columns: Mapping[str, str | int] = field(default_factory=dict)
    """Column of the run table → column of the recording, by name or by number from 1."""
    delimiter: str | None = None
    """comma, semicolon, tab or space; by default detected."""
    gravity_m_s2: float | None = None
    """Measured gravity of the site."""
    latitude_deg: float | None = None
    """Latitude of the site."""
    height_m: float = 0.0
    """Height of the site."""
    temperature_degC: float | None = None
    """Temperature during the recording."""
    initial_rest_s: float | None = None
    """Length of the initial rest."""
    procedure: str = "free_tumble"
    """Procedure of the run; free_tumble for a unit moved by hand."""


def read_options(given: Mapping[str, Any]) -> ConvertOptions:
    """Return the validated options.

    Raises
    ------
    InputError
        with every unknown option and every invalid value.
    """
    names = [option.name for option in fields(ConvertOptions)]
    issues = [
        Issue(
            f"'{key}' is not an option of convert",
            f"option {key}",
            closest_first(key, names),
            "correct the option",
        )
        for key in given
        if key not in names
    ]
    known = {key: _three(key, value, issues) for key, value in given.items() if key in names}
    options = ConvertOptions(**known)
    choices = {
        "accel_unit": ACCEL_UNITS,
        "gyro_unit": GYRO_UNITS,
        "time_unit": TIME_UNITS,
        "procedure": tuple(PROCEDURES),
        "delimiter": (None, *DELIMITERS),
    }
    for key, allowed in choices.items():
        value = getattr(options, key)
        if value not in allowed:
            listed = closest_first(str(value), [word for word in allowed if word], most=len(allowed))
            issues.append(Issue(f"{key} = '{value}' is not known", f"option {key}", listed, "use an allowed value"))
    for key in ("sample_rate_hz", "gravity_m_s2", "initial_rest_s"):
        value = getattr(options, key)
        if value is not None and not value > 0:
            issues.append(Issue(f"{key} = {value} is not positive", f"option {key}", "more than 0", "correct it"))
    if issues:
        raise InputError(issues)
    return options


def _three(key: str, value: Any, issues: list[Issue]) -> Any:
    """Return one number repeated for three axes."""
    if not key.endswith(("_scale", "_offset")) or value is None:
        return value
    values = [float(value)] * 3 if isinstance(value, int | float) else [float(number) for number in value]
    values = values * 3 if len(values) == 1 else values
    if len(values) != 3 or (key.endswith("_scale") and 0.0 in values):
        issues.append(
            Issue(
                f"{key} has {len(values)} numbers, or a zero",
                f"option {key}",
                "one number, or three: x, y, z; a scale is not zero",
                "correct the numbers",
            )
        )
        return None
    return values
