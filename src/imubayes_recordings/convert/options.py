"""The options of a conversion, which state what a recording does not, and their checks."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any

from imubayes.foundations.errors import InputError, Issue, closest_first
from imubayes.procedures import PROCEDURES
from imubayes_recordings.convert.column_names import ACCEL_UNITS, GYRO_UNITS, TARGETS, TIME_UNITS, unit_named
from imubayes_recordings.convert.formats.text_layout import DELIMITERS

CLOCKS = ("recorded", "even")
ROWS = ("samples", "means")


_UNITS = ("accel_unit", "gyro_unit", "time_unit")
"""Options that are units, spelled as in the header of a recording."""


@dataclass(frozen=True)
class ConvertOptions:
    """Options of a conversion; what is not stated is taken from the recording, or guessed and said."""

    name: str = ""
    """Name of the campaign; by default the name of its folder."""
    serial: str = ""
    """Serial number of the unit."""
    topic: Sequence[str] = ()
    """Topics of a recording with several, or acc=TOPIC and gyro=TOPIC if their names do not state the sensor; by
    default those that hold accelerometers and gyros."""
    accel_unit: str = ""
    """Unit of the accelerometers: m/s^2, g, mg, ug, cm/s^2, count, or m/s (increments per sample)."""
    gyro_unit: str = ""
    """Unit of the gyros: rad/s, deg/s, mrad/s, mdeg/s, deg/h, count, or rad or deg (increments per sample)."""
    accel_scale: Sequence[float] | None = None
    """Nominal counts per m/s², one number or one per axis; by default estimated from the recording."""
    accel_offset: Sequence[float] | None = None
    """Counts at zero input, one number or one per axis."""
    gyro_scale: Sequence[float] | None = None
    """Nominal counts per rad/s, one number or one per axis; by default estimated from the recording."""
    gyro_offset: Sequence[float] | None = None
    """Counts at zero rate, one number or one per axis."""
    sample_rate_hz: float | None = None
    """Sampling rate; the samples are treated as evenly spaced, and recorded times are ignored."""
    time_unit: str = ""
    """Unit of the time column: s, ms, us, ns, 100us, min or h."""
    clock: str = ""
    """recorded: times as they are; even: samples evenly spaced at the mean rate. The default is recorded, unless the
    samples arrive in packets."""
    rows: str = ""
    """samples: a raw log; means: each row is the mean of one pose at rest; by default determined from the
    numbers."""
    samples: float | None = None
    """Samples in each row of a table of means that does not record their number."""
    columns: Mapping[str, str | int] = field(default_factory=dict)
    """Column of the run table → column of the recording, by name or by number from 1; a minus sign before it turns it
    round."""
    delimiter: str | None = None
    """comma, semicolon, tab, bar or space; by default detected."""
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
    turn_deg: float | None = None
    """Angle of each turn about an input axis of a gyro, from rest to rest, if it is known: 360 for a full turn."""
    turn_uncertainty_deg: float = 1.0
    """Standard uncertainty of the angle of each turn."""
    procedure: str = ""
    """Procedure of the run; by default free_tumble for a unit moved by hand, static_record for one that rests."""


def read_options(given: Mapping[str, Any]) -> ConvertOptions:
    """Return the validated options.

    Raises
    ------
    InputError
        with every unknown option and every invalid value.
    """
    names = [option.name for option in fields(ConvertOptions)]
    issues = [
        Issue(f"'{key}' is not an option of convert", f"option {key}", closest_first(key, names), "correct the option")
        for key in given
        if key not in names
    ]
    known = {key: _plain(key, value, issues) for key, value in given.items() if key in names}
    options = ConvertOptions(**known)
    choices = {
        "accel_unit": ("", *ACCEL_UNITS),
        "gyro_unit": ("", *GYRO_UNITS),
        "time_unit": ("", *TIME_UNITS),
        "clock": ("", *CLOCKS),
        "rows": ("", *ROWS),
        "procedure": ("", *PROCEDURES),
        "delimiter": (None, *DELIMITERS),
    }
    for key, allowed in choices.items():
        value = getattr(options, key)
        if value not in allowed:
            listed = closest_first(str(value), [word for word in allowed if word], most=len(allowed))
            issues.append(Issue(f"{key} = '{value}' is not known", f"option {key}", listed, "use an allowed value"))
    for key in ("sample_rate_hz", "gravity_m_s2", "initial_rest_s", "samples", "turn_deg", "turn_uncertainty_deg"):
        value = getattr(options, key)
        if value is not None and not value > 0:
            issues.append(Issue(f"{key} = {value} is not positive", f"option {key}", "more than 0", "correct it"))
    issues += _targets(options.columns)
    if issues:
        raise InputError(issues)
    return options


def _plain(key: str, value: Any, issues: list[Issue]) -> Any:
    """Return one number repeated for three axes, a unit in its own spelling, anything else as it is."""
    if key in _UNITS:
        return unit_named(value) or value
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


def _targets(columns: Mapping[str, str | int]) -> list[Issue]:
    return [
        Issue(
            f"'{target}' is not a column of a run table",
            "option columns",
            closest_first(target, TARGETS, most=12),
            "write NAME=COLUMN with a name from the list",
        )
        for target in columns
        if target not in TARGETS
    ]
