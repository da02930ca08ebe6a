"""Expressions as MathML, which browsers set themselves, as the mathematics of Typst, and as a line of text."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from markupsafe import escape

from imubayes.display.layout import Cell, Sheet, cells
from imubayes.display.numbers_and_labels import pretty
from imubayes_qualification.budgets.measurement_equation import EquationLine, Expression, MeasurementModel
from imubayes_qualification.display.report.document import Block, Equations, Heading, Items, Paragraph

_KINDS = {"gyro": "Gyros", "accelerometer": "Accelerometers"}
_INTRODUCTION = (
    "All rows of all runs have one measurement model. Its equations are derived from the code of the model. "
    "Quantities are in SI units, temperatures in °C. Ω and f are the inertial rate and the specific force that act on "
    "a channel, along its nominal input axis i, output axis o, and third axis, s of a gyro and p of an accelerometer; "
    "y is the output, S_0 and y_0 the nominal scale factor and offset. A parameter has a separate value for each "
    "channel, run, mounting or table; its name in the result table states which in brackets."
)


@dataclass(frozen=True)
class _Notation:
    """How a notation writes symbols, numbers, operators and the forms that are no line of symbols."""

    symbol: Callable[[str, str], str]
    number: Callable[[str], str]
    operator: Callable[[str], str]
    product: str
    function: Callable[[str, Sequence[str]], str]
    quotient: Callable[[str, str], str]
    power: Callable[[str, str], str]
    brackets: Callable[[str], str]

    def written(self, of: Expression) -> str:
        """Return an expression."""
        match of.form:
            case "symbol":
                return self.symbol(*_name(of.text))
            case "number":
                sign = self.operator("−") if of.number < 0 else ""
                return sign + self.number(f"{abs(of.number):.10g}")
            case "sum":
                return "".join(self._terms(of.parts))
            case "product":
                return self._factors(of.parts)
            case "power":
                base, exponent = of.parts
                own = self.written(base)
                whole = own if base.form == "symbol" else self.brackets(own)
                return self.power(whole, self.written(exponent))
            case "quotient":
                return self.quotient(*(self.written(part) for part in of.parts))
            case "function":
                return self.function(of.text, [self.written(part) for part in of.parts])

    def _terms(self, terms: Sequence[Expression]) -> Iterator[str]:
        for place, term in enumerate(terms):
            negative = _is_negative(term)
            if place or negative:
                yield self.operator("−" if negative else "+")
            yield self.written(_positive(term) if negative else term)

    def _factors(self, factors: Sequence[Expression]) -> str:
        first = factors[0]
        sign = self.operator("−") if first.form == "number" and first.number == -1 else ""
        rest = factors[1:] if sign else factors
        written = (self.brackets(self.written(each)) if each.form == "sum" else self.written(each) for each in rest)
        return sign + self.product.join(written)

    def line(self, line: EquationLine) -> str:
        """Return an equation."""
        return self.written(line.left) + self.operator("=") + self.written(line.right)


def _name(text: str) -> tuple[str, str]:
    """Return base and subscript of a symbol; the whole name of one that is a word."""
    base, _, below = text.partition("_")
    return (base, below.replace("_", " ")) if len(base.removesuffix("′")) == 1 else (text.replace("_", " "), "")


def _is_negative(term: Expression) -> bool:
    leading = term.parts[0] if term.form == "product" else term
    return leading.form == "number" and leading.number < 0


def _positive(term: Expression) -> Expression:
    if term.form == "number":
        return term.model_copy(update={"number": -term.number})
    first, *rest = term.parts
    if first.number == -1:
        return rest[0] if len(rest) == 1 else term.model_copy(update={"parts": tuple(rest)})
    return term.model_copy(update={"parts": (first.model_copy(update={"number": -first.number}), *rest)})


def _row(inner: str) -> str:
    return f"<mrow>{inner}</mrow>"


def _mathml_symbol(base: str, below: str) -> str:
    own = f"<mi>{escape(base)}</mi>"
    return f"<msub>{own}<mtext>{escape(below)}</mtext></msub>" if below else own


def _mathml_function(name: str, arguments: Sequence[str]) -> str:
    if name == "sqrt":
        return f"<msqrt>{arguments[0]}</msqrt>"
    if name == "abs":
        return f"<mrow><mo>|</mo>{arguments[0]}<mo>|</mo></mrow>"
    inner = "<mo>,</mo>".join(arguments)
    return f"<mrow><mi>{escape(name.replace('_', ' '))}</mi><mo>&#x2061;</mo><mo>(</mo>{inner}<mo>)</mo></mrow>"


_MATHML = _Notation(
    symbol=_mathml_symbol,
    number=lambda text: f"<mn>{text}</mn>",
    operator=lambda text: f"<mo>{text}</mo>",
    product="<mo>&#x2062;</mo>",
    function=_mathml_function,
    quotient=lambda above, below: f"<mfrac>{_row(above)}{_row(below)}</mfrac>",
    power=lambda base, exponent: f"<msup>{_row(base)}{_row(exponent)}</msup>",
    brackets=lambda inner: f"<mrow><mo>(</mo>{inner}<mo>)</mo></mrow>",
)


def _quoted(text: str) -> str:
    return text if len(text) == 1 and text.isalpha() else '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'


def _typst_function(name: str, arguments: Sequence[str]) -> str:
    inner = ", ".join(arguments)
    return f"{name}({inner})" if name in ("sqrt", "abs") else f"{_quoted(name.replace('_', ' '))} ({inner})"


_TYPST = _Notation(
    symbol=lambda base, below: _quoted(base) + (f"_{_quoted(below)}" if below else ""),
    number=lambda text: text,
    operator=lambda text: f" {text} ",
    product=" ",
    function=_typst_function,
    quotient=lambda above, below: f"frac({above}, {below})",
    power=lambda base, exponent: f"{base}^({exponent})",
    brackets=lambda inner: f"({inner})",
)


_PLAIN = _Notation(
    symbol=lambda base, below: f"{base}_{below}" if below else base,
    number=lambda text: text,
    operator=lambda text: f" {text} ",
    product=" · ",
    function=lambda name, arguments: f"{name}({', '.join(arguments)})",
    quotient=lambda above, below: f"({above})/({below})",
    power=lambda base, exponent: f"{base}^{exponent}",
    brackets=lambda inner: f"({inner})",
)


def mathml(line: EquationLine) -> str:
    """Return an equation as MathML, displayed."""
    return f'<math display="block"><mrow>{_MATHML.line(line)}</mrow></math>'


def typst_mathematics(line: EquationLine) -> str:
    """Return an equation as Typst writes mathematics, without the dollar signs."""
    return _TYPST.line(line)


def plain(line: EquationLine) -> str:
    """Return an equation in one line of text, for those who do not see it."""
    return _PLAIN.line(line)


def measurement_section(model: MeasurementModel) -> Iterator[Block]:
    """Return the measurement model (GUM 7.2.7 a): equations, symbols, and what acts on inputs and noise, in words."""
    if not model.equations:
        return
    yield Heading("Measurement model")
    yield Paragraph(_INTRODUCTION)
    for each in model.equations:
        yield Paragraph(f"{_KINDS.get(each.kind, each.kind)} {', '.join(each.channels)}:", kept=True)
        yield Equations(
            [mathml(line) for line in each.lines],
            [typst_mathematics(line) for line in each.lines],
            [plain(line) for line in each.lines],
        )
    rows = [
        cells(Cell(each.symbol, formula=True), each.family, each.meaning, pretty(each.unit)) for each in model.symbols
    ]
    note = "Estimates are in the result table; prior distributions are in the annex on model and record."
    yield Sheet(
        "Parameters in the equations", ("symbol", "parameter", "meaning", "unit"), rows, (0, 1, 2, 3), note=note
    )
    if model.inputs:
        yield Paragraph("The inputs of a channel, and their recorded values, follow from table, mounting and site by:")
        yield Items([f"`{each.name}`: {each.formula}" for each in model.inputs])
    if model.noise:
        yield Paragraph("The noise of a row is the sum of:")
        yield Items([f"`{each.name}`: {each.formula}" for each in model.noise])
