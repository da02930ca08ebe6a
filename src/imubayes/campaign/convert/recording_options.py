"""What a converter must be told about a foreign recording, because the recording does not say it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any

from imubayes.campaign.file_schemas import PROCEDURE_NAMES
from imubayes.errors import InputError, Issue, closest_first

ACCEL_UNITS = {"m/s^2": "m/s^2", "g": "g", "count": "m/s^2"}
GYRO_UNITS = {"rad/s": "rad/s", "deg/s": "deg/s", "count": "rad/s"}
TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
DELIMITERS = {"comma": ",", "semicolon": ";", "tab": "\t", "space": None}


@dataclass(frozen=True)
class ConvertOptions:
    """Options of a conversion.

    Attributes
    ----------
    name : of the campaign; by default the name of the folder.
    serial : of the unit.
    accel_unit : ``m/s^2``, ``g`` or ``count``.
    gyro_unit : ``rad/s``, ``deg/s`` or ``count``.
    accel_scale, gyro_scale : nominal counts per m/s² and per rad/s, one number or one per axis; estimated from
        the recording where they are not given.
    accel_offset, gyro_offset : counts at zero input, one number or one per axis.
    sample_rate_hz : for recordings without a time column.
    time_unit : of the time column: ``s``, ``ms``, ``us`` or ``ns``.
    columns : column of the run table → column of the recording, by name or by number from 1.
    delimiter : ``comma``, ``semicolon``, ``tab`` or ``space``; recognised where it is not given.
    gravity_m_s2, latitude_deg, height_m : of the site.
    temperature_degC : during the recording.
    initial_rest_s : length of the rest at the beginning.
    procedure : what was done; ``free_tumble`` for a recording by hand.
    """

    name: str = ""
    serial: str = ""
    accel_unit: str = "m/s^2"
    gyro_unit: str = "rad/s"
    accel_scale: Sequence[float] | None = None
    accel_offset: Sequence[float] | None = None
    gyro_scale: Sequence[float] | None = None
    gyro_offset: Sequence[float] | None = None
    sample_rate_hz: float | None = None
    time_unit: str = "s"
    columns: Mapping[str, str | int] = field(default_factory=dict)
    delimiter: str | None = None
    gravity_m_s2: float | None = None
    latitude_deg: float | None = None
    height_m: float = 0.0
    temperature_degC: float | None = None
    initial_rest_s: float | None = None
    procedure: str = "free_tumble"


def read_options(given: Mapping[str, Any]) -> ConvertOptions:
    """Return checked options; unknown names and values are refused together."""
    names = [one.name for one in fields(ConvertOptions)]
    issues = [
        Issue(f"'{key}' is no option of a conversion", f"option {key}", closest_first(key, names), "correct the option")
        for key in given
        if key not in names
    ]
    known = {key: _three(key, value, issues) for key, value in given.items() if key in names}
    options = ConvertOptions(**known)
    choices = {
        "accel_unit": ACCEL_UNITS,
        "gyro_unit": GYRO_UNITS,
        "time_unit": TIME_UNITS,
        "procedure": PROCEDURE_NAMES,
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
    """Spread one number over three axes."""
    if not key.endswith(("_scale", "_offset")) or value is None:
        return value
    values = [float(value)] * 3 if isinstance(value, int | float) else [float(one) for one in value]
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
