"""The 27 NIST StRD nonlinear problems, read into JAX: model lines → a function of parameters and predictors."""

import ast
import json
import math
import operator
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import jax.numpy as jnp
import numpy as np

FILE = Path(__file__).parents[3] / "shared" / "reference" / "nist_strd_nls_27.json"

_OPERATORS = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
    ast.USub: operator.neg,
}
_FUNCTIONS = {"exp": jnp.exp, "cos": jnp.cos, "sin": jnp.sin, "arctan": jnp.arctan, "log": jnp.log}


@dataclass(frozen=True)
class Certified:
    """One problem: residual(b), both starts, certified values and standard deviations, residual sd."""

    name: str
    residual: Callable
    starts: tuple[np.ndarray, np.ndarray]
    values: np.ndarray
    deviations: np.ndarray
    freedom: int


def formula_of(lines: list[str]) -> tuple[str, str]:
    """Return left and right side of the model, which may run over several lines."""
    begins = next(i for i, line in enumerate(lines) if re.match(r"\s*(y|log\[y\])\s*=", line))
    ends = next(i for i, line in enumerate(lines) if re.search(r"\+\s*e\s*$", line))
    text = re.sub(r"\+\s*e\s*$", "", " ".join(lines[begins : ends + 1]))
    left, right = text.replace("[", "(").replace("]", ")").split("=")
    return left.strip(), right.strip()


def evaluate(text: str, names: dict):
    """Evaluate arithmetic with the listed names and functions; anything else in it is refused."""

    def of(node):
        match node:
            case ast.Constant(value=int() | float() as number):
                return number
            case ast.Name(id=name) if name in names:
                return names[name]
            case ast.UnaryOp(op=op, operand=operand) if type(op) in _OPERATORS:
                return _OPERATORS[type(op)](of(operand))
            case ast.BinOp(left=left, op=op, right=right) if type(op) in _OPERATORS:
                return _OPERATORS[type(op)](of(left), of(right))
            case ast.Call(func=ast.Name(id=name), args=[argument], keywords=[]) if name in _FUNCTIONS:
                return _FUNCTIONS[name](of(argument))
        raise ValueError(f"not arithmetic: {ast.unparse(node)}")

    return of(ast.parse(text, mode="eval").body)


def read() -> dict[str, Certified]:
    """Return all problems by name."""
    return {name: _problem(name, one) for name, one in json.loads(FILE.read_text()).items()}


def _problem(name: str, one: dict) -> Certified:
    left, right = formula_of(one["model_lines"])
    data = np.array(one["data"], dtype=float)
    columns = {column: data[:, place] for place, column in enumerate(one["data_columns"])}
    observed = jnp.asarray(evaluate(left, columns))

    def residual(b, _=None):
        names = {parameter["name"]: b[place] for place, parameter in enumerate(one["params"])}
        return evaluate(right, {**columns, **names, "pi": math.pi}) - observed

    def numbers(key: str) -> np.ndarray:
        return np.array([float(parameter[key]) for parameter in one["params"]])

    return Certified(
        name, residual, (numbers("start1"), numbers("start2")), numbers("value"), numbers("sd"), int(one["dof"])
    )


def digits(found: np.ndarray, certified: np.ndarray) -> float:
    """Return the number of certified digits reproduced by the worst of several numbers."""
    worst = np.max(np.abs(found - certified) / np.abs(certified))
    return 11.0 if worst == 0 else float(min(11.0, -np.log10(worst)))
