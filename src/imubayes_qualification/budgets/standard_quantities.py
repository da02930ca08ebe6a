r"""The quantities of the standards: name, symbol and term of the model equation; and their units as D-SI writes them.

The standards are IEEE Std 952 (optical gyros) and IEEE Std 517 (their g-sensitive terms) for gyros, IEEE Std 1293 for
accelerometers.  Each quantity is bound to the parameters behind it.  It is computed for every posterior draw, so that
it has a posterior of its own.  If a result lacks its parameters it is listed as not estimated, never as zero.

Signs are those of the standards.  In IEEE Std 1293 the misalignment terms are δ_o a_p − δ_p a_o: δ_o is the angle of
the input axis toward P, −δ_p that toward O.

D-SI is the digital unit format of the SmartCom project (doi:10.5281/zenodo.3522631).  A D-SI unit is a string of names
that begin with a backslash: ``\degree\per\hour``, ``\metre\per\second\tothe{2}``.  The format has no unit for gravity
and knows no parts per billion: such a unit is written in SI with a factor.  The output unit of a channel is free text,
and has a D-SI form only if it is a count, a volt or an ampere.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, reduce
from typing import Literal

import numpy as np

from imubayes.foundations.campaign_data import Channel
from imubayes.foundations.quantity_names import AXIS_ANGLE, QuantityName, name_of
from imubayes.foundations.records import Record
from imubayes.foundations.units import to_si
from imubayes.results.posterior_quantities import PosteriorQuantities

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
    """Return a unit of the report in D-SI; None if it contains a free text that D-SI does not know.

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
    r"""Return names and powers as D-SI: those above the line, or one, then those below it after the only ``\\per``."""
    named = {name: power for name, power in powers.items() if name != r"\one" and power}
    above = [_power(name, power) for name, power in named.items() if power > 0]
    below = [_power(name, -power) for name, power in named.items() if power < 0]
    return "".join(above or [r"\one"]) + (r"\per" + "".join(below) if below else "")


def _power(name: str, power: int) -> str:
    return name if power == 1 else rf"{name}\tothe{{{power}}}"


Standard = Literal["IEEE Std 952", "IEEE Std 517", "IEEE Std 1293"]
SensorKind = Literal["gyro", "accelerometer"]
_ARCSEC_PER_DEGREE = 3600.0


@dataclass(frozen=True)
class UnitUnderTest:
    """What quantities of the standards are computed from.

    Attributes
    ----------
    quantities : parameters and derived quantities, with draws.
    channels : of the unit.
    inputs : channel → inputs of the rows of the runs that were made over its range, deg/s or g, shape (n,), in order.
    gravity : of the site, m/s².
    """

    quantities: PosteriorQuantities
    channels: tuple[Channel, ...]
    inputs: dict[str, np.ndarray]
    gravity: float

    def input_range(self, channel: str) -> tuple[float, float]:
        """Return the lowest and the highest input of a channel, deg/s or g; zeros if it had none."""
        tested = self.inputs.get(channel, np.zeros(1))
        return float(tested[0]), float(tested[-1])


@dataclass(frozen=True)
class StandardDraws:
    """Draws of a quantity of the standards, (S,), with its unit and the quantities that it was computed from.

    `length` says whether it is the length of the vector of these.
    """

    label: str
    unit: str
    draws: np.ndarray
    members: tuple[str, ...]
    length: bool = False


Source = Callable[[UnitUnderTest, Channel], list[StandardDraws]]


@dataclass(frozen=True)
class StandardQuantity:
    """A quantity of the standards.

    Attributes
    ----------
    key : its name in reports and specifications.
    symbol, name : as in the standard.
    standard : where it is defined.
    kind : of the channels that have it.
    term : what it multiplies in the model equation, or its definition.
    sources : ways to compute it; the first that a result allows is taken.
    effects : which a model needs for it.
    family : of the parameters that it is, channel by channel; empty if it is computed of them.
    """

    key: str
    symbol: str
    name: str
    standard: Standard
    kind: SensorKind
    term: str
    sources: tuple[Source, ...]
    effects: tuple[str, ...]
    family: str = ""


def of_family(family: str, factor: float = 1.0) -> Source:
    """Return the source of a quantity that is a parameter of each channel, times a factor."""

    def draws(unit: UnitUnderTest, channel: Channel) -> list[StandardDraws]:
        name = name_of(family, channel.name)
        known = unit.quantities
        if name not in known.draws:
            return []
        return [StandardDraws(channel.name, known.entries[name].unit, factor * known.draws[name], (name,))]

    return draws


def _total_angle(*families: str) -> Source:
    """Return the source of the angle between true and nominal input axis."""

    def draws(unit: UnitUnderTest, channel: Channel) -> list[StandardDraws]:
        names = tuple(name_of(family, channel.name) for family in families)
        if not all(name in unit.quantities.draws for name in names):
            return []
        size = np.sqrt(sum(unit.quantities.draws[name] ** 2 for name in names))
        return [StandardDraws(channel.name, unit.quantities.entries[names[0]].unit, size, names, length=True)]

    return draws


def _spread_over_runs(family: str) -> Source:
    """Return the source of a repeatability: standard deviation over the runs that have values of their own."""

    def draws(unit: UnitUnderTest, channel: Channel) -> list[StandardDraws]:
        known = unit.quantities
        parts = {name: QuantityName.of(name) for name in known.draws}
        names = tuple(
            name for name, each in parts.items()
            if each.family == family and len(each.labels) > 1 and each.first == channel.name
        )  # fmt: skip
        if len(names) < 2:
            return []
        spread = np.std(np.stack([known.draws[name] for name in names]), axis=0, ddof=1)
        return [StandardDraws(channel.name, known.entries[names[0]].unit, spread, names)]

    return draws


def _at_the_input(family: str, unit_name: str) -> Source:
    """Return the source of a quantity that the model has in output units, in units of the input."""

    def draws(unit: UnitUnderTest, channel: Channel) -> list[StandardDraws]:
        name = name_of(family, channel.name)
        if name not in unit.quantities.draws:
            return []
        factor = 1 / abs(channel.scale_si) / to_si(unit_name, unit.gravity)
        return [StandardDraws(channel.name, unit_name, factor * unit.quantities.draws[name], (name,))]

    return draws


def _non_orthogonality(unit: UnitUnderTest, channel: Channel) -> list[StandardDraws]:
    """Return the angle of a channel's axis to those of later channels of its kind, less its nominal value."""
    known, found = unit.quantities, []
    for other in unit.channels:
        name = name_of(AXIS_ANGLE, channel.name, other.name)
        if name in known.draws:
            nominal = np.degrees(np.arccos(np.clip(channel.axes[0] @ other.axes[0], -1, 1)))
            apart = (known.draws[name] - nominal) * _ARCSEC_PER_DEGREE
            found.append(StandardDraws(f"{channel.name},{other.name}", "arcsec", apart, (name,)))
    return found


def _response_error(
    unit: UnitUnderTest, channel: Channel, input_: np.ndarray
) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
    """Return a gyro's error nonlinear in rate at inputs (n,) in deg/s, in ppm·deg/s.

    It is the product of K ≤ 3 coefficients, (S, K), with the shapes that they multiply, (K, n); and their names.
    """
    known = unit.quantities.draws
    terms = {
        name_of("gyro_scale_asymmetry.asymmetry", channel.name): np.abs(input_),
        name_of("gyro_scale_quadratic.quadratic", channel.name): input_**2,
        name_of("gyro_scale_cubic.cubic", channel.name): input_**3,
    }
    found = {name: shape for name, shape in terms.items() if name in known}
    if not found:
        return np.zeros((0, 0)), np.zeros((0, len(input_))), ()
    return np.stack([known[name] for name in found], axis=1), np.stack(list(found.values())), tuple(found)


def _least_squares_line(values: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return slope and intercept of straight lines through values (K, n) at x (n,), shape (2, K)."""
    return np.linalg.lstsq(np.stack([x, np.ones_like(x)], axis=1), values.T)[0]


def _nonlinearity(unit: UnitUnderTest, channel: Channel) -> list[StandardDraws]:
    """Return the largest deviation from the least-squares line over the rates that were run, in ppm of the largest."""
    rates = unit.inputs.get(channel.name, np.zeros(1))
    coefficients, shapes, members = _response_error(unit, channel, rates)
    full_scale = float(np.abs(rates).max())
    if not members or len(rates) < 3:  # two points are on a line
        return []
    # The line is linear in the error: what the lines of the shapes leave is that of every draw.
    slope, intercept = _least_squares_line(shapes, rates)
    rest = shapes - slope[:, None] * rates - intercept[:, None]
    # Rate by rate: all draws at all rates would be a gigabyte.
    deviation = reduce(np.maximum, (np.abs(coefficients @ at_rate) for at_rate in rest.T))
    return [StandardDraws(channel.name, "ppm", deviation / full_scale, members)]


def _asymmetry(unit: UnitUnderTest, channel: Channel) -> list[StandardDraws]:
    """Return the difference between the slopes of the least-squares lines for positive and negative rates, in ppm."""
    rates = unit.inputs.get(channel.name, np.zeros(1))
    low, high = unit.input_range(channel.name)
    # Without a row at rest, what drifts by less than a hundredth of the range is one.
    rest = 0.01 * max(-low, high)
    forward, reverse = rates[rates >= -rest], rates[rates <= rest]
    if not low < -rest < rest < high or min(len(forward), len(reverse)) < 2:
        return []
    (coefficients, above, members), (_, below, _) = (
        _response_error(unit, channel, rates) for rates in (forward, reverse)
    )
    if not members:
        return []
    slopes = _least_squares_line(above, forward)[0] - _least_squares_line(below, reverse)[0]
    return [StandardDraws(channel.name, "ppm", coefficients @ slopes, members)]


_STANDARDS: dict[SensorKind, Standard] = {"gyro": "IEEE Std 952", "accelerometer": "IEEE Std 1293"}


def _scalar(
    key: str, symbol: str, name: str, term: str, family: str, factor: float = 1.0, standard: Standard | None = None
) -> StandardQuantity:
    """Return a quantity that is one parameter of each channel; of the standard of its sensors if no other is named."""
    kind: SensorKind = "accelerometer" if family.startswith("accel") else "gyro"
    sources, effects = (of_family(family, factor),), (QuantityName.of(family).effect,)
    same = family if factor == 1 else ""
    return StandardQuantity(key, symbol, name, standard or _STANDARDS[kind], kind, term, sources, effects, same)


def _derived(
    key: str, symbol: str, name: str, kind: SensorKind, term: str, *sources: Source, effects: tuple[str, ...] = ()
) -> StandardQuantity:
    return StandardQuantity(key, symbol, name, _STANDARDS[kind], kind, term, sources, effects)


_NONLINEAR = ("gyro_scale_asymmetry", "gyro_scale_quadratic", "gyro_scale_cubic")
STANDARD_QUANTITIES: tuple[StandardQuantity, ...] = (
    _derived("gyro_scale_factor", "S", "scale factor", "gyro", "output = S·(Ω + …)", of_family("scale_factor"),
             effects=("gyro_scale_factor",)),
    _scalar("gyro_scale_factor_error", "ε_K", "scale factor error", "S/S_nominal − 1", "gyro_scale_factor.scale"),
    _derived("nonlinearity", "f(I)", "scale factor nonlinearity", "gyro",
             "largest deviation from the least-squares line at the rates run, relative to the largest", _nonlinearity,
             effects=_NONLINEAR),
    _derived("asymmetry", "S₊ − S₋", "scale factor asymmetry", "gyro",
             "difference of the least-squares slopes at the positive and the negative rates that were run", _asymmetry,
             effects=_NONLINEAR),
    _derived("scale_factor_repeatability", "s_S", "scale factor repeatability", "gyro", "standard deviation over runs",
             _spread_over_runs("gyro_scale_factor.scale"), effects=("gyro_scale_factor",)),
    _scalar("gyro_scale_temperature", "ε_T", "scale factor temperature sensitivity", "ε_T·(T − T_ref)·Ω",
            "gyro_scale_temperature.slope"),
    _scalar("gyro_scale_temperature_2", "ε_TT", "scale factor temperature sensitivity, second order",
            "ε_TT·(T − T_ref)²·Ω", "gyro_scale_temperature_quadratic.curvature"),
    _scalar("gyro_bias", "D_F", "bias", "D_F", "gyro_bias.bias"),
    _derived("gyro_bias_repeatability", "s_D", "bias repeatability", "gyro", "standard deviation over runs",
             of_family("gyro_run_bias.spread"), _at_the_input("run_scatter.tau", "deg/h"), effects=("gyro_run_bias",)),
    _scalar("gyro_bias_temperature", "D_T", "bias temperature sensitivity", "D_T·(T − T_ref)",
            "gyro_bias_temperature.slope"),
    _scalar("gyro_bias_temperature_2", "D_TT", "bias temperature sensitivity, second order", "D_TT·(T − T_ref)²",
            "gyro_bias_temperature_quadratic.curvature"),
    _scalar("gyro_bias_temperature_3", "D_TTT", "bias temperature sensitivity, third order", "D_TTT·(T − T_ref)³",
            "gyro_bias_temperature_cubic.coefficient"),
    _scalar("gyro_bias_temperature_rate", "D_Ṫ", "bias temperature-rate sensitivity", "D_Ṫ·dT/dt",
            "gyro_bias_temperature_rate.slope"),
    *(
        _scalar(f"gyro_g_sensitivity_{axis}", f"D_{axis.upper()}", f"g-sensitivity along {axis.upper()}",
                f"D_{axis.upper()}·f_{axis.upper()}", f"gyro_g_sensitivity.d_{axis}", standard="IEEE Std 517")
        for axis in "ios"
    ),
    *(
        _scalar(f"gyro_g2_sensitivity_{pair}", f"D_{pair.upper()}", f"g²-sensitivity {pair.upper()}",
                f"D_{pair.upper()}·f_{pair[0].upper()}·f_{pair[1].upper()}", f"gyro_g2_sensitivity.d_{pair}",
                standard="IEEE Std 517")
        for pair in ("ii", "oo", "ss", "io", "os", "si")
    ),
    _scalar("gyro_misalignment_o", "Θ_O", "input-axis misalignment toward O", "Θ_O·Ω_O", "gyro_misalignment.toward_o"),
    _scalar("gyro_misalignment_s", "Θ_S", "input-axis misalignment toward S", "Θ_S·Ω_S", "gyro_misalignment.toward_s"),
    _derived("gyro_misalignment_total", "Θ", "input-axis misalignment", "gyro", "√(Θ_O² + Θ_S²)",
             _total_angle("gyro_misalignment.toward_o", "gyro_misalignment.toward_s"), effects=("gyro_misalignment",)),
    _derived("gyro_non_orthogonality", "γ", "non-orthogonality", "gyro",
             "angle between two input axes, less its nominal value", _non_orthogonality,
             effects=("gyro_misalignment",)),
    _scalar("gyro_threshold", "Ω_th", "threshold", "half-width of the dead zone", "gyro_dead_zone.half_width"),
    _scalar("accel_bias", "K_0", "bias", "K_0", "accel_bias.bias"),
    _derived("accel_scale_factor", "K_1", "scale factor", "accelerometer", "output = K_1·(a_i + …)",
             of_family("scale_factor"), effects=("accel_scale_factor",)),
    _scalar("accel_scale_factor_error", "ΔK_1/K_1", "scale factor error", "K_1/K_1nominal − 1",
            "accel_scale_factor.scale"),
    _scalar("accel_asymmetry", "K_1′", "scale factor asymmetry", "K_1′·|a_i|", "accel_scale_asymmetry.asymmetry"),
    _scalar("accel_second_order", "K_2", "second-order nonlinearity", "K_2·a_i²", "accel_quadratic.quadratic"),
    _scalar("accel_odd_quadratic", "K_oq", "odd quadratic nonlinearity", "K_oq·a_i·|a_i|",
            "accel_odd_quadratic.odd_quadratic"),
    _scalar("accel_third_order", "K_3", "third-order nonlinearity", "K_3·a_i³", "accel_cubic.cubic"),
    _scalar("accel_cross_coupling_ip", "K_ip", "cross coupling of I and P", "K_ip·a_i·a_p",
            "accel_cross_coupling.k_ip"),
    _scalar("accel_cross_coupling_io", "K_io", "cross coupling of I and O", "K_io·a_i·a_o",
            "accel_cross_coupling.k_io"),
    _scalar("accel_cross_axis_oo", "K_oo", "cross-axis nonlinearity along O", "K_oo·a_o²",
            "accel_cross_axis_quadratic.k_oo"),
    _scalar("accel_cross_axis_pp", "K_pp", "cross-axis nonlinearity along P", "K_pp·a_p²",
            "accel_cross_axis_quadratic.k_pp"),
    _scalar("accel_misalignment_o", "δ_o", "misalignment about O", "δ_o·a_p", "accel_misalignment.toward_p"),
    _scalar("accel_misalignment_p", "δ_p", "misalignment about P", "−δ_p·a_o", "accel_misalignment.toward_o", -1.0),
    _derived("accel_misalignment_total", "δ", "input-axis misalignment", "accelerometer", "√(δ_o² + δ_p²)",
             _total_angle("accel_misalignment.toward_o", "accel_misalignment.toward_p"),
             effects=("accel_misalignment",)),
    _derived("accel_non_orthogonality", "γ", "non-orthogonality", "accelerometer",
             "angle between two input axes, less its nominal value", _non_orthogonality,
             effects=("accel_misalignment",)),
    _derived("accel_bias_repeatability", "s_K0", "bias repeatability", "accelerometer", "standard deviation over runs",
             of_family("accel_run_bias.spread"), _at_the_input("run_scatter.tau", "ug"), effects=("accel_run_bias",)),
    _scalar("accel_bias_temperature", "K_0T", "bias temperature sensitivity", "K_0T·(T − T_ref)",
            "accel_bias_temperature.slope"),
    _scalar("accel_bias_temperature_2", "K_0TT", "bias temperature sensitivity, second order", "K_0TT·(T − T_ref)²",
            "accel_bias_temperature_quadratic.curvature"),
    _scalar("accel_bias_temperature_3", "K_0TTT", "bias temperature sensitivity, third order", "K_0TTT·(T − T_ref)³",
            "accel_bias_temperature_cubic.coefficient"),
    _scalar("accel_scale_temperature", "K_1T", "scale factor temperature sensitivity", "K_1T·(T − T_ref)·a_i",
            "accel_scale_temperature.slope"),
    _scalar("accel_scale_temperature_2", "K_1TT", "scale factor temperature sensitivity, second order",
            "K_1TT·(T − T_ref)²·a_i", "accel_scale_temperature_quadratic.curvature"),
    _scalar("accel_vibration_rectification", "K_v", "vibration rectification", "K_v·a_rms²",
            "accel_vibration_rectification.rectification"),
    _scalar("accel_threshold", "a_th", "threshold", "half-width of the dead zone", "accel_dead_zone.half_width"),
)  # fmt: skip
"""Every quantity of the standards that the report knows, in its order."""


def standard_symbol(name: str) -> tuple[str, str]:
    """Return symbol and label of a quantity: those of the standards if they know it, else its family."""
    parts = QuantityName.of(name)
    return _symbols().get(parts.family, parts.family), parts.label


@cache
def _symbols() -> dict[str, str]:
    """Return key, or family of the parameter, of every quantity of the standards → its symbol."""
    found = {each.key: each.symbol for each in STANDARD_QUANTITIES}
    return found | {each.family: each.symbol for each in STANDARD_QUANTITIES if each.family}


def draws_of_standard(quantity: StandardQuantity, unit: UnitUnderTest) -> list[StandardDraws]:
    """Return the draws of a quantity, one entry per channel or pair of channels; none if the result lacks it."""
    for source in quantity.sources:
        found = [each for channel in unit.channels if channel.kind == quantity.kind for each in source(unit, channel)]
        if found:
            return found
    return []
