"""How a record shows itself in a terminal and in a notebook.

Records stand below what displays them: `imubayes.display.presentation` registers the text and the HTML of each type.
"""

from functools import singledispatch


@singledispatch
def text_of(record: object) -> str:
    """Return a record as text for a terminal."""
    return object.__repr__(record)


@singledispatch
def html_of(record: object) -> str | None:
    """Return a record as HTML for a notebook, None where it has none."""
    return None
