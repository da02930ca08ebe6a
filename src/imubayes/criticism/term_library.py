"""The library of simple terms in the covariates: what a dependence that has no name may look like.

Powers, absolute values, exponentials, harmonics of the table angle, bumps (a resonance, a jump of mode), waves (an
interference) and products of two covariates.  The scan of details looks at each of them on all channels of a kind
(`imubayes.criticism.localised_structure`), the search for a formula at each on one channel
(`imubayes.criticism.formula_search`).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np

from imubayes.criticism import thresholds
from imubayes.criticism.residual_covariates import ResidualCovariate
from imubayes.units import to_si

_REFERENCE = 25.0  # °C


@dataclass(frozen=True)
class Term:
    """One term of the library.

    Attributes
    ----------
    text : formula in words of the covariates.
    divisor : unit that its coefficient has below the slash, empty where it has none.
    expression : the same in Python, for `sample`, in SI.
    needs : what a run has to supply.
    values : shape (E,), in datasheet units, 0 where not known.
    covariates : one or two.
    sort : power, harmonic, bump, wave or product; bumps, waves and products are chosen from many.
    family : in brief; terms that are one dependence have one: sine and cosine of one wave.
    """

    text: str
    divisor: str
    expression: str
    needs: tuple[str, ...]
    values: np.ndarray = field(repr=False)
    covariates: tuple[ResidualCovariate, ...]
    sort: str
    family: str


@dataclass(frozen=True)
class _Base:
    """A covariate as formulas write it: symbol, Python in SI, needs, datasheet unit and values (E,)."""

    symbol: str
    expression: str
    needs: tuple[str, ...]
    unit: str
    values: np.ndarray
    covariate: ResidualCovariate

    def term(self, text: str, divisor: str, expression: str, values: np.ndarray, sort: str, family: str = "") -> Term:
        covariates = (self.covariate,)
        return Term(text, divisor, expression, self.needs, _filled(values), covariates, sort, family or text)


# covariate → (symbol, Python in SI, what a run must supply, datasheet unit)
_SYMBOLS: dict[str, tuple[str, str, tuple[str, ...], str]] = {
    **{
        f"rate_{letter}": (f"Ω_{letter}", f"sample.rate[{axis}]", ("turning",), "deg/s")
        for axis, letter in enumerate("ios")
    },
    **{f"force_{letter}": (f"f_{letter}", f"sample.force[{axis}]", (), "g") for axis, letter in enumerate("ios")},
    "temperature_degC": ("ΔT", f"(sample.ambient.temperature - {_REFERENCE})", ("temperature",), "degC"),
    "converter_temperature_degC": (
        "ΔT_c",
        f"(sample.ambient.converter_temperature - {_REFERENCE})",
        ("converter_temperature",),
        "degC",
    ),
    "temperature_rate_degC_min": ("dT/dt", "sample.ambient.temperature_rate", ("temperature_rate",), "(degC/min)"),
    "time_s": ("t", "sample.ambient.time", ("time",), "s"),
    "power_on_s": ("t_on", "sample.ambient.power_on", ("power_on",), "s"),
}


def library(known: Sequence[ResidualCovariate], rows: np.ndarray, gravity: float) -> list[Term]:
    """Return the terms that can be formed of the covariates known in some rows, shape (E,) bool."""
    terms: list[Term] = []
    bases = []
    for one in known:
        values = np.where(rows & np.isfinite(one.values), one.values, np.nan)
        if np.isfinite(values).sum() < 4 or np.nanmax(values) - np.nanmin(values) <= 0:
            continue
        if one.name == "table_angle_deg":
            terms.extend(_harmonics(one, np.radians(values)))
        elif one.name in _SYMBOLS:
            symbol, expression, needs, unit = _SYMBOLS[one.name]
            values = values - _REFERENCE if symbol.startswith("ΔT") else values
            bases.append(_Base(symbol, expression, needs, unit, values, one))
            terms.extend(_of_one(bases[-1], gravity))
    for one, other in combinations(bases, 2):
        terms.extend(_of_two(one, other))
    return [term for term in terms if np.any(term.values != 0)]


def levels(values: np.ndarray) -> np.ndarray:
    """Number the levels of a covariate: values closer than a share of the range are one; each its own in a continuum.

    Parameters
    ----------
    values : shape (n,), finite.
    """
    order = np.argsort(values)
    gaps = np.diff(values[order]) > thresholds.SAME_LEVEL * np.ptp(values)
    level = np.empty(len(values), dtype=int)
    level[order] = np.concatenate([[0], np.cumsum(gaps)])
    widths = [np.ptp(values[level == one]) for one in range(level.max() + 1)]
    # A chain of close values is a continuum, not a level.
    return level if max(widths) < thresholds.SAME_LEVEL * np.ptp(values) or level.max() == 0 else np.arange(len(values))


def _filled(values: np.ndarray) -> np.ndarray:
    return np.nan_to_num(values, nan=0.0)


def _harmonics(covariate: ResidualCovariate, angle: np.ndarray) -> list[Term]:
    base = _Base("φ", "sample.ambient.table_angle", ("table_angle",), "", angle, covariate)
    return [
        base.term(f"{name} {k}φ", "", f"jnp.{name}({k} * {base.expression})", f(k * angle), "harmonic", f"{k}φ")
        for k in range(1, thresholds.HARMONICS + 1)
        for name, f in (("sin", np.sin), ("cos", np.cos))
    ]


def _of_one(base: _Base, gravity: float) -> list[Term]:
    symbol, expression, unit, values = base.symbol, base.expression, base.unit, base.values
    found = [
        base.term(
            _power_text(symbol, power), _power_unit(unit, power), f"{expression} ** {power}", values**power, "power"
        )
        for power in range(1, thresholds.MAX_POWER + 1)
    ]
    if symbol in ("t", "t_on"):
        found += [
            base.term(
                f"exp(−{symbol}/{minutes:g} min)", "", f"jnp.exp(-{expression} / {60 * minutes})",
                np.exp(-values / (60 * minutes)), "power",
            )
            for minutes in thresholds.TIME_CONSTANTS_MIN
        ]  # fmt: skip
        return found + _waves(base, gravity)
    signed: tuple[tuple[str, str, str, Callable], ...] = (
        (f"|{symbol}|", unit, f"jnp.abs({expression})", np.abs),
        (
            f"{symbol}·|{symbol}|",
            _power_unit(unit, 2),
            f"{expression} * jnp.abs({expression})",
            lambda v: v * np.abs(v),
        ),
        (f"sgn {symbol}", "", f"jnp.sign({expression})", np.sign),
    )
    found += [base.term(text, below, code, f(values), "power") for text, below, code, f in signed]
    return found + _bumps(base, gravity) + _waves(base, gravity)


def _bumps(base: _Base, gravity: float) -> list[Term]:
    """Return bumps, as of a resonance: 1/(1 + ((x − c)/w)²) at centres and widths over the covered range.

    A rate or a force acts alike in both directions, and x is its size; a temperature has no second side.
    """
    one_sided = base.symbol.startswith("ΔT")
    text, code = (base.symbol, base.expression) if one_sided else (f"|{base.symbol}|", f"jnp.abs({base.expression})")
    size = base.values if one_sided else np.abs(base.values)
    low, high = float(np.nanmin(size)), float(np.nanmax(size))
    unit = base.unit.strip("()")
    factor = to_si(unit, gravity)
    found = []
    for centre in np.linspace(low, high, thresholds.BUMP_CENTRES + 2)[1:-1].tolist():
        for width in ((high - low) / 16, (high - low) / 8, (high - low) / 4):
            formula = f"1/(1 + (({text} − {centre:.3g})/{width:.3g})²) with {base.symbol} in {unit}"
            python = f"1 / (1 + (({code} - {centre * factor:.6g}) / {width * factor:.6g}) ** 2)"
            brief = f"at {text} = {centre:.3g} {unit}, width {width:.3g} {unit}"
            found.append(base.term(formula, "", python, 1 / (1 + ((size - centre) / width) ** 2), "bump", brief))
    return found


def _waves(base: _Base, gravity: float) -> list[Term]:
    """Return waves along a covariate, from one through its range to as many as its levels can show."""
    known = base.values[np.isfinite(base.values)]
    most = min(thresholds.MAX_WAVES, len(np.unique(levels(known))) // 3)
    unit = base.unit.strip("()")
    factor = to_si(unit, gravity)
    found = []
    for half_turns in range(2, 2 * most + 1):
        period = 2 * float(np.ptp(known)) / half_turns
        for name, f in (("sin", np.sin), ("cos", np.cos)):
            found.append(
                base.term(
                    f"{name}(2π {base.symbol}/{period:.3g} {unit})", "",
                    f"jnp.{name}({2 * np.pi / (period * factor):.6g} * {base.expression})",
                    f(2 * np.pi * base.values / period), "wave", f"of {base.symbol}, period {period:.3g} {unit}",
                )
            )  # fmt: skip
    return found


def _of_two(one: _Base, other: _Base) -> list[Term]:
    found = []
    for a in (1, 2):
        for b in (1, 2):
            text = f"{_power_text(one.symbol, a)}·{_power_text(other.symbol, b)}"
            below = f"{_power_unit(one.unit, a)}/{_power_unit(other.unit, b)}"
            code = f"{one.expression} ** {a} * {other.expression} ** {b}"
            needs = tuple(dict.fromkeys((*one.needs, *other.needs)))
            values = _filled(one.values**a * other.values**b)
            found.append(Term(text, below, code, needs, values, (one.covariate, other.covariate), "product", text))
    return found


def _power_text(symbol: str, power: int) -> str:
    return symbol if power == 1 else f"{symbol}{'²³⁴⁵'[power - 2]}"


def _power_unit(unit: str, power: int) -> str:
    """Return a unit to a power, as the unit table writes it."""
    bracketed = f"({unit})" if "/" in unit and not unit.startswith("(") else unit
    return bracketed if power == 1 else f"{bracketed}^{power}"
