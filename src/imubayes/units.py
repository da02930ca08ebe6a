"""The unit table: which units there are, and what each is in SI.

The table is closed on purpose: `mg` is milli-g here, never milligram.  A compound is written with
slashes and powers (`deg/h/g`, `ug/g^2`, `ppm/degC`).  `g` is the gravity of the site, so factors that
contain it depend on where the test was made.  What stands below a slash may be a unit in brackets, as datasheets write
it: `ppm/(deg/s)^2`, `deg/h/(degC/min)`.  A temperature difference is in degC; `output` stands for
the channel's own output unit, which is free text and has factor 1.  Two more units of that dimension serve priors:
`noise`, the standard deviation of one raw sample, and `scale`, the nominal output for 1 deg/s or 1 g.
"""

import math
import re
from collections.abc import Mapping

from imubayes.errors import InputError, Issue, closest_first

STANDARD_GRAVITY = 9.80665  # m/s², CGPM 1901; used only where no site is known

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
    "g": (1.0, 1, _ACCELERATION), "mg": (1e-3, 1, _ACCELERATION), "ug": (1e-6, 1, _ACCELERATION),
    "degC": (1.0, 0, _KELVIN), "K": (1.0, 0, _KELVIN),
    "A": (1.0, 0, _AMPERE), "mA": (1e-3, 0, _AMPERE), "uA": (1e-6, 0, _AMPERE),
    "T": (1.0, 0, _TESLA), "mT": (1e-3, 0, _TESLA), "uT": (1e-6, 0, _TESLA), "gauss": (1e-4, 0, _TESLA),
    "output": (1.0, 0, _OUTPUT), "noise": (1.0, 0, _OUTPUT), "scale": (1.0, 0, _OUTPUT),
}  # fmt: skip
_SPELLINGS = {"µg": "ug", "µrad": "urad", "µA": "uA", "µT": "uT", "°": "deg", "″": "arcsec", "′": "arcmin",
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
            raise InputError(
                Issue(
                    f"'{part}' is not a unit",
                    where or f"unit '{unit}'",
                    closest_first(part, _UNITS),
                    "write the unit with names from the table, joined by '/' and '^', such as deg/h/g",
                )
            )
        power = int((match and match["power"]) or {"²": 2, "³": 3}.get((match and match["sup"]) or "", 1))
        power = power if position == 0 else -power
        factor *= (scale * own.get(name, 1.0)) ** power
        gravity_power += gravity * power
        dimension = [d + power * e for d, e in zip(dimension, exponents, strict=True)]
    return factor, gravity_power, tuple(dimension)


def to_si(
    unit: str, gravity: float = STANDARD_GRAVITY, where: str = "", own: Mapping[str, float] | None = None
) -> float:
    """Return the factor that turns a number in `unit` into SI (rad, s, m, K, A, T; output units stay).

    Parameters
    ----------
    unit : compound of table names, such as ``ug/g^2``.
    gravity : gravity of the site, m/s².
    where : key or column named in the error.
    own : values of `noise` and `scale` for the channel at hand, output units.

    Raises
    ------
    InputError
        if a name is not in the table.
    """
    factor, gravity_power, _ = _parse(unit, where, own or {})
    return factor * gravity**gravity_power


def dimension(unit: str, where: str = "") -> tuple[int, ...]:
    """Return the exponents of (rad, s, m, K, A, output, T) of `unit`."""
    return _parse(unit, where, {})[2]


def same_dimension(first: str, second: str, where: str = "") -> bool:
    """Tell whether a number in one unit may be given in the other; `where` is named where a unit is unknown."""
    return dimension(first, where) == dimension(second, where)
