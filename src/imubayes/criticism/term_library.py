"""The library of simple terms in the covariates: what a dependence without a known cause may look like.

Powers, absolute values, exponentials, harmonics of the table angle, bumps (a resonance, a jump of mode), waves (an
interference) and products of two covariates, for the formula of one channel (`imubayes.criticism.formula_search`).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np

from imubayes.covariates import Covariate, regressors
from imubayes.criticism.evidence.free_forms import HARMONICS, HIGHEST_POWER, PLACES
from imubayes.criticism.evidence.linear_problem import SAME_LEVEL
from imubayes.responses.residual_covariates import ResidualCovariate

_TIME_CONSTANTS_MIN = (2.0, 5.0, 10.0, 30.0, 60.0)


@dataclass(frozen=True)
class Term:
    """One term of the library.

    Attributes
    ----------
    text : formula in symbols of the covariates.
    divisor : unit by which that of its coefficient is divided; empty where it is not.
    expression : the same in Python, for `sample`, in SI.
    needs : covariates that a run has to supply.
    values : shape (E,), in datasheet units, 0 where not known.
    sort : power, harmonic, bump, wave or product; bumps, waves and products are chosen from many.
    """

    text: str
    divisor: str
    expression: str
    needs: tuple[str, ...]
    values: np.ndarray = field(repr=False)
    sort: str


@dataclass(frozen=True)
class _Base:
    """A covariate as formulas use it, with its values less the centre, shape (E,)."""

    entry: Covariate
    values: np.ndarray

    def term(self, text: str, divisor: str, expression: str, values: np.ndarray, sort: str) -> Term:
        return Term(text, divisor, expression, self.entry.needed, _filled(values), sort)


def library(covariates: Sequence[ResidualCovariate], rows: np.ndarray, gravity: float) -> list[Term]:
    """Return the terms that can be formed of the covariates of some rows, shape (E,) bool."""
    terms: list[Term] = []
    bases: list[_Base] = []
    entries = {entry.column: entry for entry in regressors()}
    for covariate in covariates:
        entry = entries.get(covariate.name)
        values = np.where(rows & np.isfinite(covariate.values), covariate.values, np.nan)
        if entry is None or np.isfinite(values).sum() < 4 or np.nanmax(values) - np.nanmin(values) <= 0:
            continue
        base = _Base(entry, values - entry.centre if entry.centre else values)
        if entry.periodic:
            terms.extend(_harmonics(base, gravity))
        elif entry.symbol:
            bases.append(base)
            terms.extend(_of_one(base, gravity))
    for first, second in combinations(bases, 2):
        terms.extend(_of_two(first, second))
    return [term for term in terms if np.any(term.values != 0)]


def levels(values: np.ndarray) -> np.ndarray:
    """Number the levels of a covariate: values closer than a share of the range are one; all differ in a continuum.

    Parameters
    ----------
    values : shape (n,), finite.
    """
    least = SAME_LEVEL * np.ptp(values)
    order = np.argsort(values)
    gaps = np.diff(values[order]) > least
    level = np.empty(len(values), dtype=int)
    level[order] = np.concatenate([[0], np.cumsum(gaps)])
    widths = [np.ptp(values[level == number]) for number in range(level.max() + 1)]
    # A chain of close values is a continuum, not a level.
    return level if max(widths) <= least else np.arange(len(values))


def _filled(values: np.ndarray) -> np.ndarray:
    return np.nan_to_num(values, nan=0.0)


def _harmonics(base: _Base, gravity: float) -> list[Term]:
    symbol, code, angle = base.entry.symbol, base.entry.python, base.values * base.entry.factor(gravity)
    return [
        base.term(f"{name} {k}{symbol}", "", f"jnp.{name}({k} * {code})", f(k * angle), "harmonic")
        for k in range(1, HARMONICS + 1)
        for name, f in (("sin", np.sin), ("cos", np.cos))
    ]


def _of_one(base: _Base, gravity: float) -> list[Term]:
    symbol, expression, unit, values = base.entry.symbol, base.entry.python, base.entry.unit, base.values
    found = [
        base.term(
            _power_text(symbol, power), _power_unit(unit, power), f"{expression} ** {power}", values**power, "power"
        )
        for power in range(1, HIGHEST_POWER + 1)
    ]
    if base.entry.si == "s":
        found += [
            base.term(
                f"exp(−{symbol}/{minutes:g} min)", "", f"jnp.exp(-{expression} / {60 * minutes})",
                np.exp(-values / (60 * minutes)), "power",
            )
            for minutes in _TIME_CONSTANTS_MIN
        ]  # fmt: skip
        return found + _waves(base, gravity)
    signed: tuple[tuple[str, str, str, Callable], ...] = (
        (f"|{symbol}|", _power_unit(unit, 1), f"jnp.abs({expression})", np.abs),
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
    text, code, size = base.entry.symbol, base.entry.python, base.values
    if base.entry.symmetric:
        text, code, size = f"|{text}|", f"jnp.abs({code})", np.abs(size)
    low, high = float(np.nanmin(size)), float(np.nanmax(size))
    if not high > low:  # one rate, in both directions
        return []
    unit, factor = base.entry.unit, base.entry.factor(gravity)
    found = []
    for centre in np.linspace(low, high, PLACES + 1)[1:-1].tolist():
        for width in ((high - low) / 16, (high - low) / 8, (high - low) / 4):
            formula = f"1/(1 + (({text} − {centre:.3g})/{width:.3g})²) with {base.entry.symbol} in {unit}"
            python = f"1 / (1 + (({code} - {centre * factor:.6g}) / {width * factor:.6g}) ** 2)"
            found.append(base.term(formula, "", python, 1 / (1 + ((size - centre) / width) ** 2), "bump"))
    return found


def _waves(base: _Base, gravity: float) -> list[Term]:
    """Return waves along a covariate, from one period over its range to as many as its levels resolve."""
    finite = base.values[np.isfinite(base.values)]
    most = min(HARMONICS, len(np.unique(levels(finite))) // 3)
    unit, factor = base.entry.unit, base.entry.factor(gravity)
    found = []
    for half_turns in range(2, 2 * most + 1):
        period = 2 * float(np.ptp(finite)) / half_turns
        for name, f in (("sin", np.sin), ("cos", np.cos)):
            found.append(
                base.term(
                    f"{name}(2π {base.entry.symbol}/{period:.3g} {unit})", "",
                    f"jnp.{name}({2 * np.pi / (period * factor):.6g} * {base.entry.python})",
                    f(2 * np.pi * base.values / period), "wave",
                )
            )  # fmt: skip
    return found


def _of_two(one: _Base, other: _Base) -> list[Term]:
    x, y, found = one.entry, other.entry, []
    for a in (1, 2):
        for b in (1, 2):
            text = f"{_power_text(x.symbol, a)}·{_power_text(y.symbol, b)}"
            below = f"{_power_unit(x.unit, a)}/{_power_unit(y.unit, b)}"
            code = f"{x.python} ** {a} * {y.python} ** {b}"
            needs = tuple(dict.fromkeys((*x.needed, *y.needed)))
            values = _filled(one.values**a * other.values**b)
            found.append(Term(text, below, code, needs, values, "product"))
    return found


def _power_text(symbol: str, power: int) -> str:
    return symbol if power == 1 else f"{symbol}{'²³⁴⁵'[power - 2]}"


def _power_unit(unit: str, power: int) -> str:
    """Return a unit to a power, as the unit table writes it."""
    bracketed = f"({unit})" if "/" in unit and not unit.startswith("(") else unit
    return bracketed if power == 1 else f"{bracketed}^{power}"
