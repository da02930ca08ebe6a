"""Meaning of a column of a recording by its name and unit: a channel, its scatter, a time, a temperature, a counter.

The names of programs and loggers differ in spelling only: `AccX`, `imu.acc.x`, `accelerometer_m_s2[0]`,
`a_RS_S_x [m s^-2]` and `X-Axis Acceleration` all say the same.  A name is taken apart into words; one says the
quantity, one the axis, one perhaps a statistic or a unit.  What is left over distinguishes sensors of one recording.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

from imubayes.foundations.covariates import recorded_columns

ACCELEROMETERS, GYROS = ("ax", "ay", "az"), ("gx", "gy", "gz")
SIX = (*ACCELEROMETERS, *GYROS)
TIME, TEMPERATURE, SAMPLES, COUNTER = "time_s", "temperature_degC", "samples", "counter"
DATE, CLOCK, TABLE_RATE, TABLE_ANGLE = "date", "clock", "table_rate_deg_s", "table_angle_deg"
UNKNOWN_AXES = ("?x", "?y", "?z")
"""Axes of a quantity that neither the name nor the unit of the column says."""


@dataclass(frozen=True)
class InputUnit:
    """A unit of specific force or rate: `scale` of it are one `per`; an increment is the integral over one sample."""

    per: str
    scale: float = 1.0
    increment: bool = False


ACCEL_UNITS = {
    "m/s^2": InputUnit("m/s^2"),
    "g": InputUnit("g"),
    "mg": InputUnit("g", 1e3),
    "ug": InputUnit("g", 1e6),
    "cm/s^2": InputUnit("m/s^2", 1e2),
    "m/s": InputUnit("m/s^2", 1.0, True),
    "count": InputUnit("m/s^2"),
}
GYRO_UNITS = {
    "rad/s": InputUnit("rad/s"),
    "deg/s": InputUnit("deg/s"),
    "mrad/s": InputUnit("rad/s", 1e3),
    "mdeg/s": InputUnit("deg/s", 1e3),
    "deg/h": InputUnit("deg/s", 3600.0),
    "rad": InputUnit("rad/s", 1.0, True),
    "deg": InputUnit("deg/s", 1.0, True),
    "count": InputUnit("rad/s"),
}
TIME_UNITS = {"s": 1.0, "ms": 1e-3, "100us": 1e-4, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0, "d": 86400.0}
TEMPERATURE_UNITS = ("degC", "K", "degF")
_WORDS_OF_TIME = (DATE, CLOCK, "stamp")  # what a text table holds in words is read as seconds

_SPELLED = {
    "m/s^2": "m/s2 m/s/s m/sec2 ms-2 mps2 m/sec/sec mss ms2",
    "g": "g gn g0 gee gees gs",
    "mg": "mg mgee milli-g",
    "ug": "ug µg μg",
    "cm/s^2": "cm/s2 gal",
    "rad/s": "rad/s rad/sec rads-1 radps radians/s radian/s rad/second rads",
    "deg/s": "deg/s deg/sec degs-1 dps degree/s degrees/s degrees/sec °/s º/s °/sec degps degs °s-1",
    "mdeg/s": "mdeg/s mdps m°/s",
    "mrad/s": "mrad/s mrad/sec",
    "deg/h": "deg/h deg/hr deg/hour dph °/h °/hr",
    "count": "count counts lsb digit digits adu",
    "m/s": "m/s",
    "rad": "rad",
    "deg": "deg",
    "s": "s sec secs second seconds",
    "ms": "ms msec msecs millis millisecond milliseconds",
    "us": "us usec usecs µs μs micros microsecond microseconds",
    "ns": "ns nsec nsecs nanos nanosecond nanoseconds",
    "min": "min",
    "h": "h hr hour hours",
    "d": "day days",
    "degC": "c degc °c ºc celsius deg.c degreecelsius degreescelsius",
    "K": "k kelvin",
    "degF": "degf °f fahrenheit deg.f",
}
_UNITS = {word: unit for unit, words in _SPELLED.items() for word in words.split()}
# Units as the last words of a name: accel_x_m_s2, gyro_rad_s, temp_degC.
_ENDINGS = (
    ("m", "s2", "m/s^2"), ("m", "s", "s", "m/s^2"), ("m", "s", "2", "m/s^2"), ("ms", "2", "m/s^2"),
    ("mps", "2", "m/s^2"), ("m", "s", "m/s"), ("s", "2", "m/s^2"),
    ("rad", "s", "rad/s"), ("rad", "sec", "rad/s"), ("rad", "per", "s", "rad/s"), ("rad", "per", "sec", "rad/s"),
    ("deg", "s", "deg/s"), ("deg", "sec", "deg/s"), ("deg", "per", "s", "deg/s"), ("deg", "per", "sec", "deg/s"),
    ("deg", "h", "deg/h"), ("deg", "c", "degC"),
    ("mdeg", "s", "mdeg/s"), ("mrad", "s", "mrad/s"),
)  # fmt: skip


def _words(text: str) -> frozenset[str]:
    return frozenset(text.split())


_ACCEL = _words(
    "a f acc accel accels accelerometer accelerometers acceleration accelerations accelero xl sf accl"
    " beschleunigung beschl"
)
_GYRO = _words(
    "g gyr gyro gyros ars gyroscope gyroscopes w omega ω angvel angrate turnrate rotationrate rate rates drehrate"
)
_NEITHER = _words(
    "mag magn magnetometer magnetic compass baro barometer gps gnss quat quaternion euler roll pitch yaw cov covariance"
    " var variance position pos gravity grav bias true ref reference nominal target ideal set max min error err user"
    " altitude lat lon latitude longitude integral delta setpoint clipping clip status free orientation linearacc"
    " drift angle angles inclination tilt heading attitude speed"
)
_GRAVITY, _MOTION = _words("gravity grav"), _words("user linear linearacc")
WITHOUT_GRAVITY = frozenset({"lin"})
"""Words of a name that say that gravity may have been subtracted, if other columns are named without them."""
_MEAN, _SCATTER = _words("mean avg average median means"), _words("std sd stdev stddev sigma")
_TIMES = _words(
    "t time times timestamp timestamps ts stamp elapsed ustime mstime utc unixtime epoch loggingtime"
    " zeit zeitstempel tow sow itow datenum"
)
_OF_ORIGIN = _words("since from in start boot reboot unix")
_TEMPERATURES = {"temp", "temperature", "tmp", "temperatures", "temperatur"}  # `temps` is a time in French
_COUNTERS = _words("counter count cnt seq sequence packet packetcounter sample index idx frame")
_AXES = ("x", "y", "z")
_DULL = _ACCEL | _GYRO | _MEAN | _SCATTER | {*_AXES, "axis", "angular", "velocity", "linear", "specific", "force"}
_NO_UNIT = _DULL | _words("raw filtered filt cal calibrated uncal uncalibrated body imu sensor lpf text")
TARGETS = (*SIX, *recorded_columns(), *(f"{name}_sd" for name in SIX), SAMPLES)
"""Columns of a run table, which a column of a recording can become."""
_JOINED = re.compile(r"(a|f|acc|accel|g|gyr|gyro|w|omega|rate)([xyz])|([xyz])(acc|accl|accel|gyr|gyro|omega|rate)")
_INDEX, _BRACKETED = re.compile(r"\[(\d)\]"), re.compile(r"[\[({]([^\])}]*)[\])}]")
_PARTS = re.compile(r"[A-Z]+(?![a-zµ])|[A-Z]?[a-zµ°ωº]+|\d+|[A-Zω]")


@dataclass(frozen=True)
class ColumnRole:
    """What a column is.

    Attributes
    ----------
    target : column of a run table, `?x` for an axis of an unknown quantity, or what a clock is made of.
    unit : key of the units of its quantity; empty if neither name nor recording states it.
    group : the words of the name that say nothing known; columns of one sensor share them.
    unknown : what stands in the place of the unit and is none.
    """

    target: str
    unit: str = ""
    group: tuple[str, ...] = ()
    unknown: str = ""


# Names that do not say what they are, or their unit: Physics Toolbox, Xsens, LabVIEW.
_OF_PROGRAMS = {f"gF{axis}": ColumnRole(f"a{axis}", "g") for axis in _AXES} | {
    "SampleTimeFine": ColumnRole(TIME, "100us"),
    "X_Value": ColumnRole(TIME, "s"),
}


def unit_named(word: str) -> str:
    """Return the unit that is written in any usual spelling; empty if it is none that a recording has."""
    plain = word.strip().strip("[](){}").replace("²", "2").replace("⁻", "-").replace("¹", "1")
    for sign in ("^", "**", " ", "_", "·", "*", "(", ")"):
        plain = plain.replace(sign, "")
    if plain in ("K", "C", "F"):
        return {"K": "K", "C": "degC", "F": "degF"}[plain]
    return _UNITS.get(plain.lower(), "") or _UNITS.get(plain.lower().replace(".", ""), "")


def is_unit(cell: str) -> bool:
    """Return whether a cell of a text table is a unit and not a name: `g` is both."""
    return bool(unit_named(cell)) or cell.strip().strip("[](){}").lower() in ("-", "1", "", "na", "n/a", "unitless")


def unit_in_brackets(name: str) -> str:
    """Return the unit that a name states in brackets; empty if it states none."""
    return next((unit for found in _BRACKETED.findall(name) if (unit := unit_named(found))), "")


def words_of(name: str) -> list[str]:
    """Return the words that a name is made of, in small letters."""
    return [part.lower() for part in _PARTS.findall(name)]


def role_of(name: str, stated_unit: str = "") -> ColumnRole | None:
    """Return what a column is; None if its name says nothing that a campaign knows.

    Parameters
    ----------
    name : as the recording writes it.
    stated_unit : as the recording states it beside the name.
    """
    role = _known_role(name, stated_unit)
    if role is None or (role.target == TEMPERATURE and "raw" in words_of(name)):
        return None
    if role.unit:
        return role
    unknown = [text.strip() for text in (stated_unit, *_BRACKETED.findall(_INDEX.sub("", name))) if _is_unknown(text)]
    return replace(role, unknown=unknown[0]) if unknown else role


def _known_role(name: str, stated_unit: str) -> ColumnRole | None:
    if stated_unit in _WORDS_OF_TIME:
        return ColumnRole(TIME if stated_unit == "stamp" else stated_unit, "s")
    if name in TARGETS:
        return ColumnRole(name, unit_named(stated_unit) or _own_unit(name))
    if name in _OF_PROGRAMS:
        return _OF_PROGRAMS[name]
    index = _INDEX.search(name)
    bare = name[: index.start()] + name[index.end() :] if index else name
    bracketed = [unit for found in _BRACKETED.findall(bare) if (unit := unit_named(found))]
    words = words_of(_BRACKETED.sub(" ", bare))
    unit = unit_named(stated_unit) or "".join(bracketed[:1])
    if not unit:
        words, unit = _unit_beside(words, _BRACKETED.findall(bare))
    if not words or set(words) & _NEITHER:
        return _time_of_gps(words, unit)
    if index is not None:
        return _channel(words, "xyz"[int(index[1]) : int(index[1]) + 1], unit)
    return _beside(words, unit) or _channel(*_apart(words), unit)


def _unit_beside(words: list[str], bracketed: Sequence[str]) -> tuple[list[str], str]:
    """Return the words without the unit at their end, and it; or the unit among the words in brackets."""
    plain, unit = _without_ending(words)
    return plain, unit or _unit_in_words(plain, bracketed)


def _unit_in_words(words: Sequence[str], bracketed: Sequence[str]) -> str:
    """Return the unit of a time among other words in brackets, `epoch_ms`, or that of a temperature, T(°)."""
    if list(words) == ["t"] and any(text.strip() in ("°", "º") for text in bracketed):
        return "degC"
    inside = [word for text in bracketed for word in words_of(text)]
    units = {unit for word in inside if (unit := _UNITS.get(word, "")) in TIME_UNITS}
    others = {word for word in inside if _UNITS.get(word) not in TIME_UNITS}
    return units.pop() if len(units) == 1 and others <= _TIMES | _OF_ORIGIN else ""


def _time_of_gps(words: list[str], unit: str) -> ColumnRole | None:
    known = words[:1] == ["gps"] and set(words[1:]) <= _TIMES and (words[1:] or unit in TIME_UNITS)
    return ColumnRole(TIME, unit, ("gps",)) if known else None


def _is_unknown(text: str) -> bool:
    """Return whether what stands in the place of a unit is none that is known, and no word beside it."""
    named = bool(text.strip()) and not re.search(r"\d{3}", text)  # a descriptor, such as [x8004], is none
    return named and not is_unit(text) and not set(words_of(text)) <= _NO_UNIT


def body_rates(names: Sequence[str]) -> dict[int, ColumnRole]:
    """Return position → role of columns p, q and r, the rates about x, y and z; none unless all three are there."""
    bare = [_BRACKETED.sub("", name).strip() for name in names]
    if any(bare.count(letter) != 1 for letter in "pqr"):
        return {}
    places = [bare.index(letter) for letter in "pqr"]
    return {k: ColumnRole(name, unit_named(names[k].strip()[1:])) for k, name in zip(places, GYROS, strict=True)}


@dataclass(frozen=True)
class SeparateGravity:
    """The places, from 0, of gravity and of the acceleration beside it in the columns of one axis, and their unit."""

    gravity: int
    motion: int
    unit: str


def separate_gravity(names: Sequence[str]) -> dict[str, SeparateGravity]:
    """Return accelerometer → the two columns whose sum it reads; none unless all axes have both, in one unit.

    A phone estimates gravity and subtracts it: what is left is the acceleration of its user.
    """
    gravity, motion = (_parts_of_force(names)[part] for part in ("gravity", "motion"))
    if not set(gravity) == set(motion) == set(_AXES) or any(gravity[axis][1] != motion[axis][1] for axis in _AXES):
        return {}
    return {f"a{axis}": SeparateGravity(gravity[axis][0], motion[axis][0], gravity[axis][1]) for axis in _AXES}


def without_gravity(names: Sequence[str]) -> tuple[int, ...]:
    """Return the places of three accelerations from which gravity was subtracted; empty unless all axes have one."""
    motion = _parts_of_force(names)["motion"]
    return tuple(motion[axis][0] for axis in _AXES) if set(motion) == set(_AXES) else ()


def _parts_of_force(names: Sequence[str]) -> dict[str, dict[str, tuple[int, str]]]:
    """Return part → axis → place and unit of the columns of gravity, and of the acceleration beside it."""
    found: dict[str, dict[str, tuple[int, str]]] = {"gravity": {}, "motion": {}}
    for place, name in enumerate(names):
        words = words_of(_BRACKETED.sub(" ", name))
        axes = [word for word in words if word in _AXES]
        part = "gravity" if set(words) & _GRAVITY else "motion" if set(words) & _MOTION else ""
        if part and len(axes) == 1 and axes[0] not in found[part]:
            unit = next((unit for word in _BRACKETED.findall(name) if (unit := unit_named(word))), "")
            found[part][axes[0]] = place, unit
    return found


def names_gravity(words: Sequence[str]) -> bool:
    """Return whether words name gravity, apart from the reading of the accelerometers."""
    return bool(set(words) & _GRAVITY)


def axis_and_words(name: str) -> tuple[str, tuple[str, ...]]:
    """Return the axis of a name and its other words; no axis if it has none or several, or is of another quantity."""
    words = words_of(_BRACKETED.sub(" ", name))
    axes = [word for word in words if word in _AXES]
    if len(axes) != 1 or set(words) & _NEITHER:
        return "", ()
    return axes[0], tuple(word for word in words if word not in _AXES)


def quantity_of(words: set[str], unit: str) -> str:
    """Return ``a`` or ``g`` for words that name an accelerometer or a gyro, or by the unit; else empty."""
    angular = bool(words & {"angular", "rotation", "gyro", "gyr"})
    if words & _NEITHER:
        return ""
    if angular or (words & _GYRO - {"g"}):
        return "g"
    if words & _ACCEL:
        return "a"
    if unit in ACCEL_UNITS and unit not in GYRO_UNITS:
        return "a"
    return "g" if unit in GYRO_UNITS and unit not in ACCEL_UNITS else ""


def _own_unit(name: str) -> str:
    return {TIME: "s", TEMPERATURE: "degC", "converter_temperature_degC": "degC"}.get(name, "")


def _without_ending(words: list[str]) -> tuple[list[str], str]:
    """Return the words without those at the end, or the first, that are a unit; the axis may come last."""
    axis = words[-1:] if words[-1:] and words[-1] in "xyz" and len(words) > 2 else []
    core = words[: len(words) - len(axis)]
    for *ending, unit in sorted(_ENDINGS, key=len, reverse=True):
        if len(core) > len(ending) and core[-len(ending) :] == ending:
            return core[: -len(ending)] + axis, unit
    unit = _last_unit(core)
    return (core[:-1] + axis, unit) if unit else (words, "")


def _last_unit(words: list[str]) -> str:
    """Return the unit that is the last of several words; f, h and k are one only of a temperature."""
    if len(words) < 2:
        return ""
    last, warm = words[-1], bool(set(words) & _TEMPERATURES)
    if len(last) == 1 and last in "fhk":
        return unit_named(last.upper()) if warm and last != "h" else ""
    unit = unit_named(last)
    if unit in TEMPERATURE_UNITS and not warm:  # UncompAccel.c[0]
        return ""
    per_second = {"rad": "rad/s", "deg": "deg/s"} if set(words) & _GYRO else {}  # PX4 writes gyro_rad for rad/s
    return per_second.get(unit, unit)


def _beside(words: list[str], unit: str) -> ColumnRole | None:
    """Return the role of a time, a temperature or a counter."""
    known = set(words)
    group = tuple(word for word in words if word not in _TIMES | _TEMPERATURES | _OF_ORIGIN)
    if known & _TEMPERATURES or _is_warmth(words, unit):
        return ColumnRole(TEMPERATURE, unit, group)
    written = {"ustime": "us", "mstime": "ms"}.get(words[0]) or _UNITS.get(words[0], "")
    if unit in (*TIME_UNITS, "") and (known & _TIMES or (len(words) == 1 and written in TIME_UNITS)):
        return ColumnRole(TIME, unit or (written if written in TIME_UNITS else ""), group)
    if known <= _COUNTERS | {"imu", "no"} or words == ["n"]:
        return ColumnRole(COUNTER, "", group)
    return None


def _is_warmth(words: Sequence[str], unit: str) -> bool:
    """Recognise a temperature by its unit; `K` alone may be something else."""
    return unit in ("degC", "degF") or (unit == "K" and list(words) in (["t"], ["tc"], ["ts"]))


def _apart(words: list[str]) -> tuple[list[str], str]:
    """Return the words with a joined quantity and axis taken apart, and the letters of axes among them."""
    joined = next((found for word in words if (found := _JOINED.fullmatch(word))), None)
    if joined:
        parts = [part for part in joined.groups() if part]
        words = [part for word in words for part in (parts if word == joined[0] else [word])]
    return words, "".join(word for word in words if word in _AXES)


def _channel(words: list[str], letters: str, unit: str) -> ColumnRole | None:
    """Return the role of one axis, by the only letter."""
    known = set(words)
    quantity = quantity_of(known, unit) or ("g" if "g" in known and unit not in ACCEL_UNITS else "")
    group = tuple(word for word in words if word not in _DULL)
    velocity = "velocity" in known and quantity != "g"  # not angular; its unit would make it an increment
    if len(letters) != 1 or (group and not quantity) or velocity:
        return None
    return ColumnRole(f"{quantity or '?'}{letters}{'_sd' if known & _SCATTER else ''}", unit, group)
