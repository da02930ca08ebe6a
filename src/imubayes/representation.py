"""How records present themselves in a terminal and in a notebook.

Records stand below what displays them: `imubayes.display.registered_representations` registers the text and the HTML
of each type.  `imubayes.api` names that module, and it is imported when the first record is shown.
"""

from functools import singledispatch
from importlib import import_module

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
    """Return a record as HTML for a notebook; None where it has none."""
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
