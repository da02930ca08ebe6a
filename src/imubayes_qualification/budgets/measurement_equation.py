"""The measurement model as equations (GUM 7.2.7 a), read off the formulas of its effects.

An effect is written once, as code for one sample.  JAX traces that code to its arithmetic, which is written here as an
expression: the equations of a certificate are those that were evaluated, also for an effect that a laboratory wrote.
The signal x begins with the input along the nominal axis and passes the effects of each order in turn, y is the output:

    x₁ = Ω_i + …,    x₂ = x₁ + D_I f_i + …,    y = y₀ + S₀ x_n.

Effects on table, mounting and circumstances act on what the axes experience, and a memory is a state of its own: they
stand with the sentence that states their formula.  An effect whose arithmetic has no form here is a function by its
name.
"""

import inspect
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import jax
import jax.numpy as jnp

from imubayes.effects.base import RecordEffect, SignalEffect, Stage
from imubayes.foundations.campaign_data import Campaign
from imubayes.foundations.covariates import COVARIATES, ambient_names
from imubayes.foundations.records import Record
from imubayes.foundations.signal_path_state import Ambient, Sample
from imubayes.model.effect_registry import EffectClass
from imubayes.model.model_file import EffectSpec
from imubayes.parameters.declarations import declared_options, declared_parameters
from imubayes.results.result import Result
from imubayes_qualification.budgets.standard_quantities import standard_symbol

Form = Literal["symbol", "number", "sum", "product", "power", "quotient", "function"]


class Expression(Record):
    """An expression.

    Attributes
    ----------
    form : of it.
    text : symbol, as ``D_F``, or name of the function.
    number : value of a number.
    parts : terms, factors, base and exponent, numerator and denominator, or arguments.
    """

    form: Form
    text: str = ""
    number: float = 0.0
    parts: tuple["Expression", ...] = ()


class EquationLine(Record):
    """One equation: a symbol, and what it is."""

    left: Expression
    right: Expression


class SignalEquations(Record):
    """The equations of channels that are alike: their kind, names, and lines down to that of the output."""

    kind: str
    channels: tuple[str, ...]
    lines: tuple[EquationLine, ...]


class ModelSymbol(Record):
    """A symbol of the equations that stands for a parameter: family of its names, unit and meaning."""

    symbol: str
    family: str
    unit: str
    meaning: str


class StatedFormula(Record):
    """An effect or noise component whose formula stands in words."""

    name: str
    formula: str


class MeasurementModel(Record):
    """The measurement model.

    Attributes
    ----------
    equations : of the signal, by kind of channel.
    symbols : of the parameters in them.
    inputs : effects on what the axes experience, on recorded circumstances and on injected currents, and memories.
    noise : components of the noise.
    """

    equations: tuple[SignalEquations, ...] = ()
    symbols: tuple[ModelSymbol, ...] = ()
    inputs: tuple[StatedFormula, ...] = ()
    noise: tuple[StatedFormula, ...] = ()


def symbol(text: str) -> Expression:
    """Return a symbol."""
    return Expression(form="symbol", text=text)


def number(value: float) -> Expression:
    """Return a number."""
    return Expression(form="number", number=float(value))


_ONE, _MINUS = number(1.0), number(-1.0)


def total(terms: Sequence[Expression]) -> Expression:
    """Return the sum of terms, without what cancels."""
    flat: list[Expression] = []
    for term in terms:
        for each in term.parts if term.form == "sum" else (term,):
            opposite = _opposite(each)
            if opposite in flat:
                flat.remove(opposite)
            elif each != number(0.0):
                flat.append(each)
    return flat[0] if len(flat) == 1 else Expression(form="sum", parts=tuple(flat)) if flat else number(0.0)


def times(factors: Sequence[Expression]) -> Expression:
    """Return the product of factors."""
    flat = [part for each in factors for part in (each.parts if each.form == "product" else (each,))]
    value = 1.0
    for each in flat:
        value *= each.number if each.form == "number" else 1.0
    rest = [each for each in flat if each.form != "number"]
    known = [] if value == 1 and rest else [number(value)]
    found = [*known, *rest]
    return found[0] if len(found) == 1 else Expression(form="product", parts=tuple(found))


def _opposite(term: Expression) -> Expression:
    return number(-term.number) if term.form == "number" else times((_MINUS, term))


def _power(base: Expression, exponent: Expression) -> Expression:
    return base if exponent == _ONE else Expression(form="power", parts=(base, exponent))


def _quotient(above: Expression, below: Expression) -> Expression:
    return Expression(form="quotient", parts=(above, below))


def _function(name: str) -> Callable[..., Expression]:
    return lambda *arguments: Expression(form="function", text=name, parts=arguments)


Value = Expression | tuple[Expression, ...]
"""Of a traced variable: a number, or the components of a vector."""
_ARITHMETIC: dict[str, Callable[..., Expression]] = {
    "add": lambda a, b: total((a, b)),
    "sub": lambda a, b: total((a, _opposite(b))),
    "mul": lambda a, b: times((a, b)),
    "neg": _opposite,
    "div": _quotient,
    "pow": _power,
    "expm1": lambda a: total((_function("exp")(a), _MINUS)),
    "square": lambda a: _power(a, number(2)),
    **{name: _function(name) for name in ("abs", "exp", "log", "sin", "cos", "tanh", "sqrt", "sign", "max", "min")},
}  # fmt: skip
_ALIKE = ("convert_element_type", "copy", "stop_gradient")


class _NoFormError(Exception):
    """The arithmetic of an effect has no form as an expression."""


def _evaluated(jaxpr: Any, constants: Sequence[Any], values: Sequence[Value]) -> list[Value]:
    """Return the outputs of traced code for values of its inputs."""
    known: dict[Any, Value] = dict(zip(jaxpr.invars, values, strict=True))
    known |= {variable: _constant(value) for variable, value in zip(jaxpr.constvars, constants, strict=True)}

    def read(variable: Any) -> Value:
        return _constant(variable.val) if hasattr(variable, "val") else known[variable]

    for equation in jaxpr.eqns:
        inner = equation.params.get("jaxpr") or equation.params.get("call_jaxpr")
        given = [read(variable) for variable in equation.invars]
        if inner is not None:
            found = _evaluated(getattr(inner, "jaxpr", inner), getattr(inner, "consts", ()), given)
        else:
            found = [_step(equation, given)]
        known |= dict(zip(equation.outvars, found, strict=True))
    return [read(variable) for variable in jaxpr.outvars]


def _constant(value: Any) -> Value:
    known = jnp.asarray(value)
    if known.ndim == 0:
        return number(float(known))
    if known.ndim == 1:
        return tuple(number(float(each)) for each in known)
    raise _NoFormError


def _step(equation: Any, given: Sequence[Value]) -> Value:
    name, parameters, first = equation.primitive.name, equation.params, given[0]
    if name in _ALIKE:
        return first
    if name == "stack" and all(isinstance(each, Expression) for each in given):
        return tuple(each for each in given if isinstance(each, Expression))
    if isinstance(first, tuple) and name in _PARTS:
        return _part(name, parameters, first)
    if name == "integer_pow":
        given, name = [first, number(parameters["y"])], "pow"
    return _elementwise(name, given)


_PARTS = ("slice", "squeeze", "reshape")


def _part(name: str, parameters: Mapping[str, Any], vector: tuple[Expression, ...]) -> Value:
    """Return components of a vector, or its only one."""
    if name == "slice" and not parameters["strides"]:
        return vector[parameters["start_indices"][0] : parameters["limit_indices"][0]]
    if name == "slice" or len(vector) != 1:
        raise _NoFormError
    return vector[0]


def _elementwise(name: str, given: Sequence[Value]) -> Value:
    """Return the result of an operation on numbers, or on the components of vectors."""
    sizes = {len(each) for each in given if isinstance(each, tuple)}
    if name not in _ARITHMETIC or len(sizes) > 1:
        raise _NoFormError
    columns = [each if isinstance(each, tuple) else (each,) * max(sizes, default=1) for each in given]
    found = tuple(_ARITHMETIC[name](*own) for own in zip(*columns, strict=True))
    return found if sizes else found[0]


_VECTORS = {"rate": "Ω", "force": "f", "acceleration": "α", "north": "n", "up": "u"}
SCALE, OFFSET = symbol("S_0"), symbol("y_0")


def _sample(kind: str) -> tuple[Sample, list[Value]]:
    """Return what a channel experiences, as arrays to trace, and what each stands for.

    The third axis of an accelerometer is P.
    """
    axes, zeros = ("i", "o", "s" if kind == "gyro" else "p"), jnp.zeros(3)
    ambient = Ambient(**dict.fromkeys(ambient_names(), jnp.array(1.0)))
    sample = Sample(**dict.fromkeys(_VECTORS, zeros), ambient=ambient, output_scale=jnp.array(1.0))
    found: list[Value] = []
    for path, _ in jax.tree_util.tree_leaves_with_path(sample):
        name = str(getattr(path[-1], "key", getattr(path[-1], "name", "")))
        if name in _VECTORS:
            found.append(tuple(symbol(f"{_VECTORS[name]}_{axis}") for axis in axes))
        else:
            found.append(SCALE if name == "output_scale" else symbol(_covariate_symbol(name)))
    return sample, found


def _covariate_symbol(name: str) -> str:
    own = COVARIATES[name].symbol.removeprefix("Δ")
    return own if own and "/" not in own else {"temperature_rate": "Ṫ", "campaign_time": "t"}.get(name, name)


def formula(
    effect: type[SignalEffect] | type[RecordEffect],
    kind: str,
    signal: Expression,
    parameters: Mapping[str, Expression],
    options: Mapping[str, float],
    memory: Expression | None = None,
) -> Expression | None:
    """Return the signal after an effect, from its code; None if its arithmetic has no form here.

    Parameters
    ----------
    kind : of the channel.
    signal : before it.
    parameters : field → its expression.
    options : fixed settings.
    memory : of an effect that has one.
    """
    sample, experienced = _sample(kind)
    state = () if memory is None else (jnp.array(0.5),)

    def applied(values: dict[str, Any], before: Any, sample: Sample, *state: Any) -> Any:
        return effect(**values, **options).apply(before, sample, *state)  # pyright: ignore[reportCallIssue]

    traced = jax.make_jaxpr(applied)(dict.fromkeys(parameters, jnp.array(0.5)), jnp.array(1.0), sample, *state)
    given = [parameters[name] for name in sorted(parameters)]
    values = [*given, signal, *experienced, *(() if memory is None else (memory,))]
    try:
        (found,) = _evaluated(traced.jaxpr, traced.consts, values)
    except _NoFormError:
        return None
    return found if isinstance(found, Expression) else None


_SIMPLE = re.compile(r"[^\W\d_]′?(_\w+)?")


@dataclass
class _Symbols:
    """Symbols of parameters: those of the standards if they are plain, θ_1, θ_2, … for the others."""

    known: dict[str, ModelSymbol] = field(default_factory=dict)

    def of(self, effect: EffectClass) -> dict[str, Expression]:
        """Return field → symbol of the parameters of an effect that its formula has."""
        declared = declared_parameters(effect)
        widths = {each.spread for each in declared.values()}
        for name, each in declared.items():
            family = f"{effect.name}.{name}"
            if name not in widths and family not in self.known:
                self.known[family] = ModelSymbol(
                    symbol=self._new(family), family=family, unit=each.unit, meaning=each.meaning
                )
        return {name: symbol(self.known[f"{effect.name}.{name}"].symbol) for name in declared if name not in widths}

    def _new(self, family: str) -> str:
        own, _ = standard_symbol(family)
        taken = {each.symbol for each in self.known.values()} | {SCALE.text, OFFSET.text}
        if _SIMPLE.fullmatch(own) and own not in taken:
            return own
        return f"θ_{1 + sum(each.symbol.startswith('θ') for each in self.known.values())}"


def measurement_model(result: Result) -> MeasurementModel:
    """Return the equations of the model of a result."""
    model, symbols = result.fit.model, _Symbols()
    known = model.registry.effects
    # Every campaign implies the unknowns of a bench that states no direction; a campaign that states it binds none.
    acting = model.acting
    ordered = sorted(
        (spec for spec in acting if _is_signal(known[spec.name])),
        key=lambda spec: (known[spec.name].stage, known[spec.name].order),  # pyright: ignore[reportAttributeAccessIssue]
    )
    specs = {spec.name: spec for spec in ordered}
    equations = tuple(
        SignalEquations(
            kind=kind, channels=tuple(channels),
            lines=tuple(_lines(kind, [(known[name], specs[name]) for name in names], symbols)),
        )
        for (kind, names), channels in _alike(result.fit.model.campaign, ordered, known).items()
    )  # fmt: skip
    others = [spec.name for spec in acting if spec.name not in specs or _in_words(known[spec.name])]
    noise = [name for name in others if not hasattr(known[name], "stage")]
    return MeasurementModel(
        equations=equations,
        symbols=tuple(symbols.known.values()),
        inputs=tuple(_stated(known[name]) for name in dict.fromkeys(others) if name not in noise),
        noise=tuple(_stated(known[name]) for name in dict.fromkeys(noise)),
    )


def _alike(
    campaign: Campaign, ordered: Sequence[EffectSpec], known: Mapping[str, EffectClass]
) -> dict[tuple[str, tuple[str, ...]], list[str]]:
    """Return kind and effects, in their order, of the channels that have these."""
    groups: dict[tuple[str, tuple[str, ...]], list[str]] = {}
    for channel in campaign.channels:
        own = tuple(spec.name for spec in ordered if _acts(spec, known[spec.name], channel.kind, channel.name))
        if channel.kind in ("gyro", "accelerometer"):
            groups.setdefault((channel.kind, own), []).append(channel.name)
    return groups


def _is_signal(effect: EffectClass) -> bool:
    return issubclass(effect, SignalEffect | RecordEffect) and "injection" not in effect.needs


def _in_words(effect: EffectClass) -> bool:
    return issubclass(effect, RecordEffect)


def _acts(spec: EffectSpec, effect: EffectClass, kind: str, channel: str) -> bool:
    return kind in effect.kinds and (spec.channels is None or channel in spec.channels)


def _stated(effect: EffectClass) -> StatedFormula:
    said = (inspect.getdoc(effect) or "").partition("\n\n")[0]
    return StatedFormula(name=effect.name, formula=" ".join(said.split()))


def _lines(kind: str, effects: Sequence[tuple[EffectClass, EffectSpec]], symbols: _Symbols) -> Iterator[EquationLine]:
    """Yield the equations down to the output, one for the effects of an order."""
    before, converted = symbol(f"{_VECTORS['rate' if kind == 'gyro' else 'force']}_i"), False
    steps: dict[tuple[Stage, int], list[tuple[EffectClass, EffectSpec]]] = {}
    for effect, spec in effects:
        steps.setdefault((effect.stage, effect.order), []).append((effect, spec))  # pyright: ignore[reportAttributeAccessIssue]
    for place, ((stage, _), own) in enumerate(steps.items(), 1):
        after = before
        if stage == Stage.CONVERTER and not converted:
            converted, after = True, times((SCALE, before))
        for effect, spec in own:
            after = _after(effect, spec, kind, after, symbols)
        before = symbol(f"x_{place}")
        yield EquationLine(left=before, right=after)
    last = before if converted else times((SCALE, before))
    yield EquationLine(left=symbol("y"), right=total((last, OFFSET)))


def _after(effect: EffectClass, spec: EffectSpec, kind: str, signal: Expression, symbols: _Symbols) -> Expression:
    assert issubclass(effect, SignalEffect | RecordEffect)
    parameters = symbols.of(effect)
    memory = symbol(f"m_{effect.name}") if issubclass(effect, RecordEffect) else None
    widths = {each.spread: 1.0 for each in declared_parameters(effect).values() if each.spread}
    options = declared_options(effect) | dict(spec.options) | widths
    found = formula(effect, kind, signal, parameters, options, memory)
    return found if found is not None else Expression(form="function", text=effect.name, parts=(signal,))
