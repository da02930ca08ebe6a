"""The unit table: accepted units and their conversion to SI.

The table is closed: `mg` is always milli-g, never milligram.  Compound units are written with slashes and powers
(`deg/h/g`, `ug/g^2`, `ppm/degC`); a denominator may be in brackets, as in datasheets: `ppm/(deg/s)^2`,
`deg/h/(degC/min)`.  `g` is the local gravity of the site, so conversion factors that contain it depend on the site.
Temperature differences are in degC.  `output` is the channel's own output unit, free text with factor 1.  Two more
units of that dimension are for priors: `noise`, the standard deviation of one raw sample, and `scale`, the nominal
output for 1 deg/s or 1 g.
"""

import math
import re
from collections.abc import Mapping

from imubayes.foundations.errors import closest_first, input_error

# Of every bias that is shown or exported; the README has it as well.
BIAS_CONVENTION = (
    "A bias is referred to the input: output = nominal scale · (1 + scale factor error) · (input + bias + …) + offset. "
    "The b of an export is referred to the output: b = (1 + scale factor error) · bias, subtracted first."
)
ABSURD = 1e30
"""No instrument reads as much in any unit, and squares of more than 1e154 overflow."""
DAYS_PER_YEAR = 365.25  # of the Julian year
# A number with its unit after it, as options state them: `20 degC`.
NUMBER_AND_UNIT = re.compile(r"^\s*(?P<number>[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(?P<unit>\S.*?)?\s*$")
STANDARD_GRAVITY = 9.80665  # m/s², CGPM 1901; used only if the site is unknown

# name → (factor to SI, power of the site's gravity, dimension as exponents of (rad, s, m, K, A, output, T))
_RATIO = (0, 0, 0, 0, 0, 0, 0)
_ANGLE = (1, 0, 0, 0, 0, 0, 0)
_TIME = (0, 1, 0, 0, 0, 0, 0)
_LENGTH = (0, 0, 1, 0, 0, 0, 0)
_ACCELERATION = (0, -2, 1, 0, 0, 0, 0)
_KELVIN = (0, 0, 0, 1, 0, 0, 0)
_AMPERE = (0, 0, 0, 0, 1, 0, 0)
_OUTPUT = (0, 0, 0, 0, 0, 1, 0)
_TESLA = (0, 0, 0, 0, 0, 0, 1)
_UNITS: dict[str, tuple[float, int, tuple[int, ...]]] = {
    "1": (1.0, 0, _RATIO), "%": (1e-2, 0, _RATIO), "ppm": (1e-6, 0, _RATIO), "ppb": (1e-9, 0, _RATIO),
    "rad": (1.0, 0, _ANGLE), "mrad": (1e-3, 0, _ANGLE), "urad": (1e-6, 0, _ANGLE),
    "deg": (math.pi / 180, 0, _ANGLE), "arcmin": (math.pi / 10800, 0, _ANGLE),
    "arcsec": (math.pi / 648000, 0, _ANGLE),
    "s": (1.0, 0, _TIME), "ms": (1e-3, 0, _TIME), "min": (60.0, 0, _TIME), "h": (3600.0, 0, _TIME),
    "m": (1.0, 0, _LENGTH), "cm": (1e-2, 0, _LENGTH), "mm": (1e-3, 0, _LENGTH),
    "um": (1e-6, 0, _LENGTH),
    "g": (1.0, 1, _ACCELERATION), "mg": (1e-3, 1, _ACCELERATION), "ug": (1e-6, 1, _ACCELERATION),
    "degC": (1.0, 0, _KELVIN), "K": (1.0, 0, _KELVIN),
    "A": (1.0, 0, _AMPERE), "mA": (1e-3, 0, _AMPERE), "uA": (1e-6, 0, _AMPERE),
    "T": (1.0, 0, _TESLA), "mT": (1e-3, 0, _TESLA), "uT": (1e-6, 0, _TESLA), "gauss": (1e-4, 0, _TESLA),
    "output": (1.0, 0, _OUTPUT), "noise": (1.0, 0, _OUTPUT), "scale": (1.0, 0, _OUTPUT),
}  # fmt: skip
_SPELLINGS = {"µg": "ug", "µrad": "urad", "µA": "uA", "µT": "uT", "µm": "um", "°": "deg", "″": "arcsec", "′": "arcmin",
              "°C": "degC", "dps": "deg/s", "μg": "ug"}  # fmt: skip
_TOKEN = re.compile(r"^(?P<name>[^\^²³]+?)(?:\^(?P<power>\d)|(?P<sup>[²³]))?$")
_OUTSIDE_BRACKETS = re.compile(r"/(?![^()]*\))")


def _parse(unit: str, where: str, own: Mapping[str, float]) -> tuple[float, int, tuple[int, ...]]:
    factor, gravity_power, dimension = 1.0, 0, [0] * len(_RATIO)
    spelled = (_SPELLINGS.get(part.strip(), part.strip()) for part in _OUTSIDE_BRACKETS.split(unit))
    for position, part in enumerate(_OUTSIDE_BRACKETS.split("/".join(spelled))):
        match = _TOKEN.match(part)
        name = _SPELLINGS.get(match["name"], match["name"]) if match else part
        if name.startswith("(") and name.endswith(")"):
            scale, gravity, exponents = _parse(name[1:-1], where or f"unit '{unit}'", own)
        elif name in _UNITS:
            scale, gravity, exponents = _UNITS[name]
        else:
            remedy = "write the unit with names of this list, joined by '/' and '^', such as deg/h/g"
            raise input_error(f"'{part}' is not a unit", where or f"unit '{unit}'", closest_first(part, _UNITS), remedy)
        power = int((match and match["power"]) or {"²": 2, "³": 3}.get((match and match["sup"]) or "", 1))
        power = power if position == 0 else -power
        factor *= (scale * own.get(name, 1.0)) ** power
        gravity_power += gravity * power
        dimension = [d + power * e for d, e in zip(dimension, exponents, strict=True)]
    return factor, gravity_power, tuple(dimension)


def to_si(
    unit: str, gravity: float = STANDARD_GRAVITY, where: str = "", own: Mapping[str, float] | None = None
) -> float:
    """Return the conversion factor from `unit` to SI (rad, s, m, K, A, T; output units are kept).

    Parameters
    ----------
    unit : compound of table names, such as ``ug/g^2``.
    gravity : local gravity, m/s².
    where : key or column to name in the error.
    own : values of `noise` and `scale` for the channel, output units.

    Raises
    ------
    InputError
        if a unit name is not in the table.

    Examples
    --------
    >>> import imubayes
    >>> round(imubayes.to_si("deg/h") * 1e6, 3)  # µrad/s
    4.848
    """
    factor, gravity_power, _ = _parse(unit, where, own or {})
    return factor * gravity**gravity_power


def with_output_unit(unit: str, output: str) -> str:
    """Return a unit as it is shown, with a channel's own output unit for `output`: output/degC → pulse/s/degC.

    Model files keep `output`: the output unit of a channel is free text, which no prior can be parsed with.
    """
    if not output:
        return unit
    whole = f"({output})" if "/" in output or " " in output else output
    first = re.sub(r"(?<!/)\boutput\b(?!\^)", lambda _: output, unit)
    return re.sub(r"(?<=/)output\b|\boutput(?=\^)", lambda _: whole, first)


def dimension(unit: str, where: str = "") -> tuple[int, ...]:
    """Return the dimension of `unit` as exponents of (rad, s, m, K, A, output, T).

    Parameters
    ----------
    unit : as in model files, such as deg/h/g.
    where : place of the unit, for errors.

    Raises
    ------
    InputError
        if a unit name is not in the table.

    Examples
    --------
    >>> import imubayes
    >>> imubayes.dimension("ppm/degC") == imubayes.dimension("1/K")
    True
    """
    return _parse(unit, where, {})[2]


def same_dimension(first: str, second: str, where: str = "") -> bool:
    """Return whether two units have the same dimension; `where` is the place to name in an error."""
    return dimension(first, where) == dimension(second, where)
