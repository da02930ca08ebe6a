"""A shape for what has no name: the simplest formula in the covariates that explains a channel's residual.

Orthogonal matching pursuit over a library of simple terms (powers, absolute values, harmonics, exponentials and
products of two covariates), all sent through the projection: the term with the strongest evidence is taken, taken out,
and the next looked for, until chance alone would do as well.  How often each term comes first when whole runs are drawn
anew says how much to trust it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np

from imubayes.criticism.covariates import Covariate
from imubayes.criticism.projection import Projection
from imubayes.criticism.screen import explain
from imubayes.units import to_si

_MOST_POWER, _HARMONICS, _MOST_TERMS, _CENTRES = 5, 6, 3, 9
# A product of two covariates has to explain so much more of χ² than the best term in one.
_PRODUCT_PENALTY = 9.0
_TIMES = (2.0, 5.0, 10.0, 30.0, 60.0)  # minutes
_REFERENCE = 25.0  # °C
_THRESHOLD, _RESAMPLES, _NEAR = 0.01, 200, 4.0
_LEAST_RETAINED = 1e-6


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
    """

    text: str
    divisor: str
    expression: str
    needs: tuple[str, ...]
    values: np.ndarray = field(repr=False)


@dataclass(frozen=True)
class Shape:
    """What was found for one channel.

    Attributes
    ----------
    channel : name.
    terms : the terms, in the order in which they were taken.
    value, sd : coefficients at the input, in `unit` of each.
    unit : one per term.
    drop : Δχ² of each term when it was taken.
    p : chance of each, with all looks at the library counted.
    inclusion : how often the first term comes first when runs are drawn anew.
    near : texts of terms that would do almost as well as the first.
    python : an effect class, ready to paste into a file beside the model.
    """

    channel: str
    terms: tuple[Term, ...]
    value: tuple[float, ...]
    sd: tuple[float, ...]
    unit: tuple[str, ...]
    drop: tuple[float, ...]
    p: tuple[float, ...]
    inclusion: float
    near: tuple[str, ...]
    python: str

    @property
    def formula(self) -> str:
        """The sum of the terms, in words."""
        return " + ".join(term.text for term in self.terms)


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


def library(known: Sequence[Covariate], rows: np.ndarray, gravity: float) -> list[Term]:
    """Return the terms that can be formed of the covariates known in some rows, shape (E,) bool."""
    terms: list[Term] = []
    bases = []
    for one in known:
        values = np.where(rows & np.isfinite(one.values), one.values, np.nan)
        if np.isfinite(values).sum() < 4 or np.nanmax(values) - np.nanmin(values) <= 0:
            continue
        if one.name == "table_angle_deg":
            terms.extend(_harmonics(np.radians(values)))
        elif one.name in _SYMBOLS:
            symbol, expression, needs, unit = _SYMBOLS[one.name]
            values = values - _REFERENCE if symbol.startswith("ΔT") else values
            bases.append((symbol, expression, needs, unit, values))
            terms.extend(_of_one(symbol, expression, needs, unit, values, gravity))
    for one, other in combinations(bases, 2):
        terms.extend(_of_two(one, other))
    return [term for term in terms if np.any(term.values != 0)]


def _filled(values: np.ndarray) -> np.ndarray:
    return np.nan_to_num(values, nan=0.0)


def _harmonics(angle: np.ndarray) -> list[Term]:
    return [
        Term(
            f"{name} {k}φ", "", f"jnp.{name}({k} * sample.ambient.table_angle)", ("table_angle",), _filled(f(k * angle))
        )
        for k in range(1, _HARMONICS + 1)
        for name, f in (("sin", np.sin), ("cos", np.cos))
    ]


def _of_one(
    symbol: str, expression: str, needs: tuple[str, ...], unit: str, values: np.ndarray, gravity: float
) -> list[Term]:
    found = [
        Term(
            _power_text(symbol, power),
            _power_unit(unit, power),
            f"{expression} ** {power}",
            needs,
            _filled(values**power),
        )
        for power in range(1, _MOST_POWER + 1)
    ]
    if symbol in ("t", "t_on"):
        found += [
            Term(
                f"exp(−{symbol}/{minutes:g} min)", "", f"jnp.exp(-{expression} / {60 * minutes})", needs,
                _filled(np.exp(-values / (60 * minutes))),
            )
            for minutes in _TIMES
        ]  # fmt: skip
        return found
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
    found += [Term(text, below, code, needs, _filled(f(values))) for text, below, code, f in signed]
    return found + _bumps(symbol, expression, needs, unit, values, gravity)


def _bumps(
    symbol: str, expression: str, needs: tuple[str, ...], unit: str, values: np.ndarray, gravity: float
) -> list[Term]:
    """Return bumps, as of a resonance: 1/(1 + ((|x| − c)/w)²) at centres and widths over the covered range."""
    size = np.abs(values)
    low, high = float(np.nanmin(size)), float(np.nanmax(size))
    factor = to_si(unit.strip("()"), gravity)
    found = []
    for centre in np.linspace(low, high, _CENTRES + 2)[1:-1].tolist():
        for width in ((high - low) / 16, (high - low) / 8, (high - low) / 4):
            text = f"1/(1 + ((|{symbol}| − {centre:.3g})/{width:.3g})²) with {symbol} in {unit.strip('()')}"
            code = f"1 / (1 + ((jnp.abs({expression}) - {centre * factor:.6g}) / {width * factor:.6g}) ** 2)"
            found.append(Term(text, "", code, needs, _filled(1 / (1 + ((size - centre) / width) ** 2))))
    return found


def _of_two(one: tuple, other: tuple) -> list[Term]:
    found = []
    for a in (1, 2):
        for b in (1, 2):
            text = f"{_power_text(one[0], a)}·{_power_text(other[0], b)}"
            below = f"{_power_unit(one[3], a)}/{_power_unit(other[3], b)}"
            code = f"{one[1]} ** {a} * {other[1]} ** {b}"
            needs = tuple(dict.fromkeys((*one[2], *other[2])))
            found.append(Term(text, below, code, needs, _filled(one[4] ** a * other[4] ** b)))
    return found


def _power_text(symbol: str, power: int) -> str:
    return symbol if power == 1 else f"{symbol}{'²³⁴⁵'[power - 2]}"


def _power_unit(unit: str, power: int) -> str:
    bracketed = f"({unit})" if "/" in unit and not unit.startswith("(") else unit
    return unit_of(bracketed, power)


def unit_of(unit: str, power: int) -> str:
    """Return a unit to a power, as the unit table writes it."""
    return unit if power == 1 else f"{unit}^{power}"


def find_shape(projection: Projection, known: Sequence[Covariate], channel: str) -> Shape | None:
    """Return the simplest formula for the residual of a channel; None where no term is beyond chance."""
    model = projection.fitted.model
    place = [one.name for one in model.campaign.channels].index(channel)
    constants = model.campaign.channels[place]
    rows = (model.entries.channel == place) & ~model.entries.closing
    terms = library(known, rows, model.campaign.site.gravity)
    if not terms:
        return None
    factor, base = _base(constants.kind, constants.scale_si, model.campaign.site.gravity)
    columns = np.stack([np.where(rows, term.values, 0.0) for term in terms], axis=1) * factor
    size = np.abs(columns).max(axis=0)
    whitened = projection.whitened(columns / size)
    at, taken = projection, []
    first: tuple[float, tuple[str, ...]] = (0.0, ())
    for step in range(_MOST_TERMS):
        found = [
            explain(at, projected[:, None], np.linalg.norm(column, keepdims=True), _LEAST_RETAINED)
            for projected, column in zip(at.project(whitened).T, whitened.T, strict=True)
        ]
        worth = [
            one.drop - _PRODUCT_PENALTY * ("·" in term.text) if one.span.shape[1] else -np.inf
            for term, one in zip(terms, found, strict=True)
        ]
        best = int(np.argmax(worth))
        p = min(1.0, found[best].p * len(terms))
        if p >= _THRESHOLD:
            break
        if step == 0:
            near = [
                term.text
                for term, one in zip(terms, found, strict=True)
                if one.drop > found[best].drop - _NEAR and term is not terms[best]
            ]
            first = (_inclusion(at, at.project(whitened), best), tuple(near))
        taken.append((best, found[best].drop, p, found[best].variance))
        at = at.without(found[best].span)
    if not taken:
        return None
    chosen = [best for best, *_ in taken]
    value, sd = _solve(projection, whitened[:, chosen], taken[-1][3])
    units = tuple(f"{base}/{terms[best].divisor}" if terms[best].divisor else base for best in chosen)
    value, sd = value / size[chosen], sd / size[chosen]
    return Shape(
        channel=channel,
        terms=tuple(terms[best] for best in chosen),
        value=tuple(value.tolist()),
        sd=tuple(sd.tolist()),
        unit=units,
        drop=tuple(drop for _, drop, _, _ in taken),
        p=tuple(p for _, _, p, _ in taken),
        inclusion=first[0],
        near=first[1],
        python=_python(constants.kind, [terms[best] for best in chosen], units, value),
    )


def _base(kind: str, scale: float, gravity: float) -> tuple[float, str]:
    """Return output units per unit of the coefficient, and that unit."""
    return (scale * np.pi / 180 / 3600, "deg/h") if kind == "gyro" else (scale * 1e-6 * gravity, "ug")


def _solve(projection: Projection, whitened: np.ndarray, variance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    projected = projection.project(whitened)
    weight = projection.strata.at_rows(variance)
    inverse = np.linalg.pinv(projected)
    return inverse @ projection.residual, np.sqrt(np.diag((inverse * weight) @ inverse.T))


def _inclusion(projection: Projection, projected: np.ndarray, best: int) -> float:
    """Return how often the same term comes first when whole runs are drawn anew."""
    model = projection.fitted.model
    count = len(model.entries)
    runs = len(model.campaign.runs)
    along, square = np.zeros((runs, projected.shape[1])), np.zeros((runs, projected.shape[1]))
    np.add.at(along, model.entries.run, projected[:count] * projection.residual[:count, None])
    np.add.at(square, model.entries.run, projected[:count] ** 2)
    drawn = np.random.default_rng(0).multinomial(runs, np.full(runs, 1 / runs), size=_RESAMPLES)
    whole = drawn @ square
    score = np.where(whole > 1e-12, (drawn @ along) ** 2 / np.where(whole > 1e-12, whole, 1.0), 0.0)
    return float(np.mean(np.argmax(score, axis=1) == best))


def _python(kind: str, terms: Sequence[Term], units: Sequence[str], value: np.ndarray) -> str:
    """Return the text of an effect class with these terms."""
    names = ["coefficient", "second", "third"][: len(terms)]
    needs = tuple(dict.fromkeys(need for term in terms for need in term.needs))
    formula = " + ".join(f"{name}·{term.text}" for name, term in zip(names, terms, strict=True))
    lines = [
        f'"""Found in the residuals: {formula}."""',
        "",
        "import jax.numpy as jnp",
        "",
        "from imubayes.effects.base import Order, SignalEffect, Stage",
        "from imubayes.parameters.parameter import parameter",
        "from imubayes.types import Scalar",
        "",
        "",
        "class FoundShape(SignalEffect):",
        f'    """Signal + {formula}."""',
        "",
        f'    name = "found_{kind}_shape"',
        f'    stage, order, kinds = Stage.SENSOR, Order.BIAS, ("{kind}",)',
        f"    needs = {needs!r}",
    ]
    for name, unit, found in zip(names, units, value.tolist(), strict=True):
        wide = float(f"{3 * abs(found):.1g}") or 1.0
        low, high = float(f"{abs(found) / 10:.1g}"), wide
        prior = f"normal(0, {wide:g} {unit})"
        lines.append(f'    {name}: Scalar = parameter("{unit}", "{prior}", ({low:g}, {high:g}), "the coefficient")')
    total = " + ".join(f"self.{name} * {term.expression}" for name, term in zip(names, terms, strict=True))
    lines += ["", "    def apply(self, signal, sample):", f"        return signal + {total}", ""]
    text = "\n".join(lines)
    return text if "jnp." in total else text.replace("import jax.numpy as jnp\n\n", "")
