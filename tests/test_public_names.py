"""The names that `imubayes` offers: all resolve, and none is loaded before its use."""

import ast
import inspect
import re
import subprocess
import sys
from itertools import chain
from pathlib import Path

import pytest

import imubayes

STUB = Path(imubayes.__file__).with_suffix(".pyi")


def names_of_kernel() -> list[str]:
    """Return the names that the stub of the kernel exports, each of which it imports."""
    body = ast.parse(STUB.with_name("kernel_names.pyi").read_text(encoding="utf-8")).body
    exported = next(ast.literal_eval(node.value) for node in body if isinstance(node, ast.Assign))
    imports = [node for node in body if isinstance(node, ast.ImportFrom)]
    assert sorted(exported) == sorted(alias.name for node in imports for alias in node.names)
    return exported


def test_type_checkers_see_every_name():
    imports = [node for node in ast.parse(STUB.read_text(encoding="utf-8")).body if isinstance(node, ast.ImportFrom)]
    *beside, kernel = [[alias.asname or alias.name for alias in node.names] for node in imports]
    assert kernel == ["*"]
    assert sorted([*chain(*beside), *names_of_kernel()]) == sorted(imubayes.__all__)
    assert set(imubayes.__all__) <= set(dir(imubayes))


@pytest.mark.parametrize("name", imubayes.__all__)
def test_every_public_name_resolves(name):
    assert getattr(imubayes, name) is not None


def test_each_public_name_stands_in_one_of_four_groups():
    groups = re.findall(r"^- \w+:", imubayes.__doc__ or "", re.MULTILINE)
    named = re.findall(r"`(\w+)`", (imubayes.__doc__ or "").partition("Public names")[2])
    assert groups == ["- Data:", "- Fit:", "- Loop:", "- Results:"]
    assert sorted(named) == sorted(imubayes.__all__)


@pytest.mark.parametrize("name", imubayes.__all__)
def test_every_public_name_is_documented(name):
    found = getattr(imubayes, name)
    if inspect.isclass(found) or inspect.isroutine(found):
        assert inspect.getdoc(found), name
        assert isinstance(found, type) or inspect.getdoc(found) != inspect.getdoc(type(found)), name


def test_an_unknown_name_is_refused():
    with pytest.raises(AttributeError, match="nothing"):
        imubayes.nothing  # noqa: B018


def test_importing_the_package_loads_nothing_heavy():
    script = "import sys, imubayes; print(*sorted({'jax', 'numpy', 'polars', 'matplotlib'} & set(sys.modules)))"
    found = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert found.stdout.split() == []
