"""The equations of a certificate are what was evaluated: each is held against the code of its effect, in numbers."""

import math
import re
import unicodedata
from collections.abc import Mapping
from typing import Any
from xml.etree import ElementTree

import jax.numpy as jnp
import numpy as np
import pytest

from imubayes.effects.base import Order, RecordEffect, SignalEffect, Stage
from imubayes.foundations.arrays import Scalar
from imubayes.foundations.covariates import ambient_names
from imubayes.foundations.signal_path_state import Ambient, Sample
from imubayes.model.effect_registry import Registry
from imubayes.parameters.declarations import declared_options, declared_parameters, parameter
from imubayes_qualification.budgets.measurement_equation import (
    EquationLine,
    Expression,
    _covariate_symbol,
    _stated,
    formula,
    symbol,
)
from imubayes_qualification.display.report.equations import mathml, plain, typst_mathematics

EFFECTS = {
    name: effect
    for name, effect in Registry().effects.items()
    if issubclass(effect, SignalEffect | RecordEffect) and "injection" not in effect.needs
}
# Their code branches, which has no form as an expression: they stand by their name and the sentence of their formula.
BY_NAME = {"gyro_dead_zone", "accel_dead_zone", "converter_dead_zone", "gyro_bandwidth", "accel_bandwidth"}
EXPERIENCED = [f"{letter}_{axis}" for letter in "Ωf" for axis in "iosp"] + ["α_i", "α_o", "α_s"]
VALUES = {name: 0.3 + 0.1 * place for place, name in enumerate([*EXPERIENCED, "S_0"])}
VALUES |= {f"{letter}_{axis}": 0.2 + 0.07 * k for k, letter in enumerate("nu") for axis in "iosp"}
AMBIENT = {name: 1.5 + 0.3 * place for place, name in enumerate(ambient_names())}


def value(of: Expression, known: Mapping[str, float]) -> float:
    """An expression by arithmetic of its own."""
    parts = [value(part, known) for part in of.parts]
    match of.form:
        case "symbol":
            return known[of.text]
        case "number":
            return of.number
        case "sum":
            return math.fsum(parts)
        case "product":
            return math.prod(parts)
        case "power":
            return parts[0] ** parts[1]
        case "quotient":
            return parts[0] / parts[1]
        case "function":
            functions: dict[str, Any] = vars(math) | {"abs": abs, "max": max, "min": min, "sign": np.sign}
            return float(functions[of.text](*parts))


def written(name: str, signal: float = 0.7) -> tuple[Expression | None, float, dict[str, float]]:
    """The expression of an effect, the output of its code, and the values of its symbols."""
    effect = EFFECTS[name]
    kind = effect.kinds[0]
    third = "s" if kind == "gyro" else "p"
    declared = declared_parameters(effect)
    fields = {field: 0.05 + 0.02 * place for place, field in enumerate(declared)}

    def vector(letter: str) -> Any:
        return jnp.array([VALUES.get(f"{letter}_{axis}", 0.9) for axis in ("i", "o", third)])

    sample = Sample(
        rate=vector("Ω"), force=vector("f"), acceleration=vector("α"), north=vector("n"), up=vector("u"),
        ambient=Ambient(**{each: jnp.array(number) for each, number in AMBIENT.items()}), output_scale=VALUES["S_0"],
    )  # fmt: skip
    memory, options = issubclass(effect, RecordEffect), declared_options(effect)
    made: Any = effect(**{field: jnp.array(number) for field, number in fields.items()}, **options)
    output = made.apply(jnp.array(signal), sample, *([jnp.array(0.4)] if memory else []))
    found = formula(
        effect,
        kind,
        symbol("x"),
        {field: symbol(field) for field in declared},
        options,
        symbol("m") if memory else None,
    )
    known = VALUES | {_covariate_symbol(each): number for each, number in AMBIENT.items()}
    return found, float(output), known | {f"α_{third}": 0.9} | fields | {"x": signal, "m": 0.4}


@pytest.mark.parametrize("name", sorted(set(EFFECTS) - BY_NAME))
def test_the_equation_of_an_effect_is_its_code(name):
    found, output, known = written(name)
    assert found is not None
    assert value(found, known) == pytest.approx(output, rel=1e-12)
    # Planted fault: the same equation of another value is another number.
    assert value(found, known | {"x": 0.8}) != pytest.approx(output, rel=1e-6)


@pytest.mark.parametrize("name", sorted(BY_NAME))
def test_code_that_branches_has_a_name_and_no_wrong_equation(name):
    assert written(name)[0] is None


def test_an_effect_of_the_user_has_its_equation_without_more():
    class Own(SignalEffect):
        """Own: signal + a·sin φ."""

        name = "own_of_this_test"
        stage, order, kinds = Stage.SENSOR, Order.BIAS, ("gyro",)
        a: Scalar = parameter("deg/h", "normal(0, 1 deg/h)", (0.1, 1), "the amplitude")

        def apply(self, signal: Scalar, sample: Sample) -> Scalar:
            return signal - 2 * self.a * jnp.sin(sample.ambient.table_angle)

    found = formula(Own, "gyro", symbol("x_1"), {"a": symbol("θ_1")}, {})
    assert found is not None
    line = EquationLine(left=symbol("x_2"), right=found)
    assert plain(line) == "x_2 = x_1 − 2 · θ_1 · sin(φ)"
    assert typst_mathematics(line) == 'x_2 = x_1 − 2 θ_1 "sin" (φ)'.replace("x_2", 'x_"2"').replace("_1", '_"1"')


@pytest.mark.parametrize("name", sorted(set(EFFECTS) - BY_NAME))
def test_equations_are_mathematics_for_browser_and_paper(name):
    found, _, _ = written(name)
    assert found is not None
    line = EquationLine(left=symbol("x_1"), right=found)
    root = ElementTree.fromstring(mathml(line).replace("&#x2062;", "").replace("&#x2061;", ""))
    assert root.tag == "math"
    assert plain(line).startswith("x_1 = ")
    assert "+ −" not in plain(line)


@pytest.mark.parametrize("name", sorted(Registry().effects))
def test_formulas_in_words_have_every_sign_on_paper(name):
    """Fonts set no dot above a Greek capital: Ω̇ would be printed as Ω.  A word or a comma is no subscript."""
    said = _stated(Registry().effects[name]).formula
    assert not any(map(unicodedata.combining, said))
    assert not re.search(r"\b[A-Za-z]_(\w+,\w|[a-z]{4})", said)


def test_typst_sets_every_equation():
    typst = pytest.importorskip("typst", reason="typst is not installed")
    lines = [written(name)[0] for name in sorted(set(EFFECTS) - BY_NAME)]
    text = "\n".join(f"$ {typst_mathematics(EquationLine(left=symbol('x'), right=each))} $" for each in lines if each)
    assert typst.compile(text.encode(), format="svg")
