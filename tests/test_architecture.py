"""ARCHITECTURE.md says what the sources are: the diagram, the packages, a short glossary."""

import re

import architecture_diagram
from test_layering import GUESTS, KERNEL, SOURCE

PAGE = architecture_diagram.PAGE.read_text()


def test_the_diagram_is_that_of_the_sources() -> None:
    block = architecture_diagram.BLOCK.search(PAGE)
    assert block is not None
    assert block[0] == architecture_diagram.diagram(), "run `python tests/architecture_diagram.py`"


def test_an_arrow_that_a_longer_way_implies_is_left_out() -> None:
    edges = {"cli": {"api", "run"}, "api": {"run"}, "run": set()}
    assert architecture_diagram.reduced(edges) == {"cli": {"api"}, "api": {"run"}, "run": set()}


def test_every_package_is_in_the_table_of_floors() -> None:
    packages = {path.name for path in (SOURCE / "imubayes").iterdir() if (path / "__init__.py").is_file()}
    named = set(re.findall(r"`(\w+)`", PAGE.partition("## Floors")[2].partition("## The signal path")[0]))
    assert packages | set(GUESTS) <= named
    assert packages <= {name for floor in KERNEL for name in floor}


def test_the_glossary_is_short() -> None:
    rows = re.findall(r"^\| (?!term|---)", PAGE.partition("## Glossary")[2].partition("## Where")[0], re.MULTILINE)
    assert 10 <= len(rows) <= 25
