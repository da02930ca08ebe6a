"""The names that `imubayes` offers: complete, lazy, and enough for a user's own effect."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import imubayes

SOURCE = Path(imubayes.__file__)


def names_seen_by_type_checkers() -> dict[str, str]:
    """Return public name → module, from the imports under TYPE_CHECKING."""
    (block,) = (node for node in ast.parse(SOURCE.read_text(encoding="utf-8")).body if isinstance(node, ast.If))
    imports = [node for node in block.body if isinstance(node, ast.ImportFrom)]
    return {alias.asname or alias.name: str(node.module) for node in imports for alias in node.names}


def test_type_checkers_see_what_is_there():
    seen = names_seen_by_type_checkers()
    assert sorted(seen) == imubayes.__all__
    assert {name: module for name, (module, _) in imubayes._HOME.items()} == seen
    assert set(imubayes.__all__) <= set(dir(imubayes))


@pytest.mark.parametrize("name", imubayes.__all__)
def test_every_public_name_resolves(name):
    assert getattr(imubayes, name) is not None


def test_an_unknown_name_is_refused():
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        imubayes.nothing  # noqa: B018


def test_importing_the_package_loads_nothing_heavy():
    script = "import sys, imubayes; print(*sorted({'jax', 'numpy', 'polars', 'matplotlib'} & set(sys.modules)))"
    found = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert found.stdout.split() == []
