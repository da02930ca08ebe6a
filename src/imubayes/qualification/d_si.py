r"""Units as D-SI writes them: the digital unit format of the SmartCom project (doi:10.5281/zenodo.3522631).

A D-SI unit is a string of names that begin with a backslash: ``\degree\per\hour``, ``\metre\per\second\tothe{2}``.
The format has no unit for gravity and knows no parts per billion: such a unit is written in SI with a factor.  The
output unit of a channel is free text, and has a D-SI form only where it is a count, a volt or an ampere.
"""

import re

from imubayes.json_record import Record

_NAMES: dict[str, tuple[str, float, int]] = {
    "1": (r"\one", 1.0, 0), "%": (r"\percent", 1.0, 0), "ppm": (r"\ppm", 1.0, 0), "ppb": (r"\one", 1e-9, 0),
    "rad": (r"\radian", 1.0, 0), "mrad": (r"\milli\radian", 1.0, 0), "urad": (r"\micro\radian", 1.0, 0),
    "deg": (r"\degree", 1.0, 0), "arcmin": (r"\arcminute", 1.0, 0), "arcsec": (r"\arcsecond", 1.0, 0),
    "s": (r"\second", 1.0, 0), "ms": (r"\milli\second", 1.0, 0), "min": (r"\minute", 1.0, 0),
    "h": (r"\hour", 1.0, 0),
    "m": (r"\metre", 1.0, 0), "cm": (r"\centi\metre", 1.0, 0), "mm": (r"\milli\metre", 1.0, 0),
    "um": (r"\micro\metre", 1.0, 0),
    "g": ("g", 1.0, 1), "mg": ("g", 1e-3, 1), "ug": ("g", 1e-6, 1),
    "degC": (r"\kelvin", 1.0, 0), "K": (r"\kelvin", 1.0, 0),
    "A": (r"\ampere", 1.0, 0), "mA": (r"\milli\ampere", 1.0, 0), "uA": (r"\micro\ampere", 1.0, 0),
    "T": (r"\tesla", 1.0, 0), "mT": (r"\milli\tesla", 1.0, 0), "uT": (r"\micro\tesla", 1.0, 0),
    "gauss": (r"\tesla", 1e-4, 0),
    "V": (r"\volt", 1.0, 0), "mV": (r"\milli\volt", 1.0, 0), "uV": (r"\micro\volt", 1.0, 0),
    "pulse": (r"\one", 1.0, 0), "count": (r"\one", 1.0, 0), "LSB": (r"\one", 1.0, 0), "digit": (r"\one", 1.0, 0),
    "Hz": (r"\hertz", 1.0, 0), "kHz": (r"\kilo\hertz", 1.0, 0),
}  # fmt: skip
"""Unit → its D-SI name, the factor to that, and the power of gravity that the factor contains."""
_GRAVITY = ((r"\metre", 1), (r"\second", -2))
_POWERS = {"²": 2, "³": 3}
_PART = re.compile(r"^(?P<name>.+?)(?:\^(?P<power>\d)|(?P<sup>[²³]))?$")


class DigitalUnit(Record):
    """A unit in D-SI: a number in the unit of the report times `factor` is a number in `unit`."""

    unit: str
    factor: float = 1.0


def digital_unit(unit: str, gravity: float, output: str = "") -> DigitalUnit | None:
    """Return a unit of the report in D-SI; None where it contains a free text that D-SI does not know.

    Parameters
    ----------
    unit : such as ``ug/g^2``, ``deg/h/(degC/min)`` or ``pulse/s per deg/s``.
    gravity : of the site, m/s², which `g` stands for.
    output : what `output` stands for.
    """
    powers: dict[str, int] = {}
    factor = 1.0
    for place, part in enumerate(unit.split(" per ")):
        found = _terms(part, output)
        if found is None:
            return None
        sign = -1 if place else 1
        for name, power in found:
            written, scale, of_gravity = _NAMES[name]
            factor *= scale ** (sign * power) * gravity ** (of_gravity * sign * power)
            for base, own in _GRAVITY if of_gravity else ((written, 1),):
                powers[base] = powers.get(base, 0) + own * sign * power
    return DigitalUnit(unit=_written(powers), factor=factor)


def _terms(unit: str, output: str) -> list[tuple[str, int]] | None:
    """Return the names of a unit with their powers, ``deg/h/(degC/min)`` → deg 1, h −1, degC −1, min 1."""
    found: list[tuple[str, int]] = []
    for place, part in enumerate(re.split(r"/(?![^()]*\))", unit)):
        match = _PART.match(part.strip())
        if match is None:
            return None
        name, sign = match["name"], 1 if place == 0 else -1
        power = sign * int(match["power"] or _POWERS.get(match["sup"] or "", 1))
        if name == "output":
            name = f"({output})"
        if name.startswith("(") and name.endswith(")"):
            inner = _terms(name[1:-1], "")
            if inner is None:
                return None
            found += [(each, own * power) for each, own in inner]
        elif name in _NAMES:
            found.append((name, power))
        else:
            return None
    return found


def _written(powers: dict[str, int]) -> str:
    """Return names and powers as D-SI: those above the line first, and the unit one where there is none."""
    named = {name: power for name, power in powers.items() if name != r"\one" and power}
    above = [_power(name, power) for name, power in named.items() if power > 0]
    below = [rf"\per{_power(name, -power)}" for name, power in named.items() if power < 0]
    return "".join(above or [r"\one"]) + "".join(below)


def _power(name: str, power: int) -> str:
    return name if power == 1 else rf"{name}\tothe{{{power}}}"
