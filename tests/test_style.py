"""The measurable part of the house style: sizes, complexity, names, annotations, docstrings; read from the sources."""

import ast
from collections import Counter
from collections.abc import Iterator
from functools import cache

import numpy as np
import pytest

from test_layering import SOURCE, SOURCES, statements

FILE_LINES = {50: 300, 90: 420, 100: 500}
FUNCTION_LINES = {90: 25, 100: 60}
MOST_COMPLEX = 15

Function = ast.FunctionDef | ast.AsyncFunctionDef
_BRANCHES = (ast.If, ast.For, ast.While, ast.ExceptHandler, ast.IfExp, ast.Assert, ast.comprehension, ast.match_case)


@cache
def trees() -> dict[str, ast.Module]:
    return {str(file.relative_to(SOURCE)): ast.parse(file.read_text()) for file in SOURCES}


def functions() -> Iterator[tuple[str, Function]]:
    for file, tree in trees().items():
        yield from ((f"{file}: {node.name}", node) for node, _ in statements(tree) if isinstance(node, Function))


def complexity(function: ast.AST) -> int:
    """Cyclomatic complexity after McCabe, with Boolean operators and comprehensions counted as branches."""
    nodes = [*ast.walk(function)]
    branches = sum(isinstance(node, _BRANCHES) for node in nodes)
    conditions = sum(len(node.ifs) for node in nodes if isinstance(node, ast.comprehension))
    operators = sum(len(node.values) - 1 for node in nodes if isinstance(node, ast.BoolOp))
    return 1 + branches + conditions + operators


def public_functions() -> Iterator[tuple[str, Function, ast.ClassDef | None]]:
    for file, tree in trees().items():
        for node in tree.body:
            if isinstance(node, Function):
                yield f"{file}: {node.name}", node, None
            elif isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                yield from (
                    (f"{file}: {node.name}.{part.name}", part, node) for part in node.body if isinstance(part, Function)
                )


def is_public(function: Function) -> bool:
    return not function.name.startswith("_")


def follows_a_library(owner: ast.ClassDef | None) -> bool:
    """Return whether a class implements an interface of another package, or states one (Protocol)."""
    bases = [ast.unparse(base) for base in owner.bases] if owner is not None else []
    return any(("." in base and not base.startswith("eqx.")) or base in ("Protocol", "Move") for base in bases)


def is_annotated(function: Function) -> bool:
    given = function.args
    arguments = [*given.posonlyargs, *given.args, *given.kwonlyargs, given.vararg, given.kwarg]
    named = [argument for argument in arguments if argument is not None and argument.arg not in ("self", "cls")]
    return function.returns is not None and all(argument.annotation is not None for argument in named)


@cache
def interface_methods() -> frozenset[str]:
    """Methods that a class documents for its subclasses."""
    return frozenset(
        part.name
        for tree in trees().values()
        for node, _ in statements(tree)
        if isinstance(node, ast.ClassDef)
        for part in node.body
        if isinstance(part, Function) and ast.get_docstring(part)
    )


@pytest.mark.parametrize(("percentile", "most"), FILE_LINES.items())
def test_files_are_short(percentile: int, most: int) -> None:
    lines = [len(file.read_text().splitlines()) for file in SOURCES]
    assert np.percentile(lines, percentile) <= most


@pytest.mark.parametrize(("percentile", "most"), FUNCTION_LINES.items())
def test_functions_are_short(percentile: int, most: int) -> None:
    lines = {name: (node.end_lineno or 0) - node.lineno + 1 for name, node in functions()}
    longest = max(lines, key=lambda name: lines[name])
    assert np.percentile(list(lines.values()), percentile) <= most, longest


def test_no_function_is_complex() -> None:
    assert [name for name, node in functions() if complexity(node) > MOST_COMPLEX] == []


def test_complexity_counts_branches() -> None:
    code = "def f(x):\n    if x and x > 1 or x < -1:\n        return [y for y in x if y]\n    return 0"
    assert complexity(ast.parse(code)) == 1 + 1 + 1 + 1 + 2


def test_no_class_name_stands_twice() -> None:
    names = Counter(
        node.name for tree in trees().values() for node, _ in statements(tree) if isinstance(node, ast.ClassDef)
    )
    assert [name for name, count in names.items() if count > 1] == []


def test_public_functions_are_annotated() -> None:
    assert [name for name, node, _ in public_functions() if is_public(node) and not is_annotated(node)] == []


def test_public_functions_are_documented() -> None:
    """A method that a base class documents needs no docstring of its own."""
    missing = [
        name
        for name, node, owner in public_functions()
        if is_public(node)
        and not ast.get_docstring(node)
        and not (owner is not None and owner.bases and node.name in interface_methods())
        and not follows_a_library(owner)
    ]
    assert missing == []


# Tails and cumulative distributions: what they return beyond the range of a double is decided in one module.
_OWNER_OF_TAILS = "imubayes/foundations/tail_probabilities.py"
_OF_SPECIAL = {
    f"{name}{suffix}"
    for name in ("chdtr", "fdtr", "bdtr", "pdtr", "gdtr", "betainc", "gammainc")
    for suffix in ("", "c")
} | {"ndtr", "log_ndtr", "stdtr", "nbdtr", "erfc", "erfcx"}
_OF_STATS = {"sf", "logsf", "cdf", "logcdf"}


def tails_of_scipy(tree: ast.Module) -> Iterator[str]:
    """Yield the tail probabilities that a module asks SciPy for."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("scipy"):
            yield from (f"{node.module}.{each.name}" for each in node.names if each.name in _OF_SPECIAL)
        if isinstance(node, ast.Attribute):
            name = ast.unparse(node)
            if name.startswith(("special.", "scipy.special.")) and node.attr in _OF_SPECIAL:
                yield name
            if name.startswith(("stats.", "scipy.stats.")) and node.attr in _OF_STATS:
                yield name


def test_one_module_owns_the_tail_probabilities() -> None:
    found = {file: names for file, tree in trees().items() if (names := sorted(tails_of_scipy(tree)))}
    assert list(found) == [_OWNER_OF_TAILS], found


def test_a_tail_of_scipy_is_seen() -> None:
    direct = "from scipy.special import ndtr\np = scipy.stats.chi2.logsf(x, 2) + special.chdtrc(2, x)"
    assert len(list(tails_of_scipy(ast.parse(direct)))) == 3


def test_procedures_are_told_apart_in_their_own_package_alone() -> None:
    """What a procedure needs is a fact of its record, not a case elsewhere."""
    found = [
        f"{file}:{node.lineno}"
        for file, tree in trees().items()
        if not file.startswith("procedures/")
        for node in ast.walk(tree)
        if isinstance(node, ast.Compare)
        and isinstance(node.left, ast.Attribute)
        and node.left.attr == "procedure"
        and any(isinstance(constant, ast.Constant) for side in node.comparators for constant in ast.walk(side))
    ]
    assert found == []
