"""Typed records: the base of those that are kept as JSON, and how they present themselves in terminal and notebook.

Records stand below what displays them: `imubayes.display.representations` registers the text and the HTML of each type.
`imubayes.api` names that module, and it is imported when the first record is shown.
"""

import math
from collections.abc import Iterable
from functools import singledispatch
from importlib import import_module
from pathlib import Path
from typing import cast

from pydantic import BaseModel, ConfigDict


class Record(BaseModel):
    """Base of everything that a result folder keeps as JSON, and of what `--json` prints."""

    model_config = ConfigDict(extra="ignore", frozen=True, allow_inf_nan=False)

    def json_text(self) -> str:
        """Return the record as the text of a JSON file."""
        return self.model_dump_json(indent=1) + "\n"


def finite(value: float) -> float | None:
    """Return a number for JSON; None for a non-finite value."""
    return float(value) if math.isfinite(value) else None


_displays: list[str] = []


def displayed_by(module: str) -> None:
    """Name the module that registers text and HTML of records when it is imported."""
    if module not in _displays:
        _displays.append(module)


def _learn_displays() -> None:
    for module in _displays:
        import_module(module)


@singledispatch
def text_of(record: object) -> str:
    """Return a record as text for a terminal."""
    return object.__repr__(record)


@singledispatch
def headline_of(record: object) -> str:
    """Return a record in one line."""
    return object.__repr__(record)


@singledispatch
def html_of(record: object) -> str | None:
    """Return a record as HTML for a notebook; None if it has none."""
    return None


class Presented:
    """Mixin of the records whose headline, text and HTML are registered: `repr` is short, `print` shows all."""

    def __repr__(self) -> str:
        _learn_displays()
        return headline_of(self)

    def __str__(self) -> str:
        _learn_displays()
        return text_of(self)

    def _repr_html_(self) -> str | None:
        _learn_displays()
        return html_of(self)


def several[Item: str | Path](given: Item | Iterable[Item] | None) -> tuple[Item, ...]:
    """Return the members of an argument that takes one value or several; none of None.

    A text is one value: iterated over, it would be its letters.
    """
    if given is None:
        return ()
    return (cast(Item, given),) if isinstance(given, str | Path) else tuple(given)
