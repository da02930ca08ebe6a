"""How records present themselves in a terminal and in a notebook.

Records stand below what displays them: `imubayes.display.registered_representations` registers the text and the HTML
of each type.
"""

from functools import singledispatch


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
        return headline_of(self)

    def __str__(self) -> str:
        return text_of(self)

    def _repr_html_(self) -> str | None:
        return html_of(self)
