"""Options that several commands have."""

from typing import Annotated

import cyclopts

Json = Annotated[bool, cyclopts.Parameter(name=("--json", "--json-output"), negative="")]
"""Print one JSON object on standard output."""

Flag = Annotated[bool, cyclopts.Parameter(negative="")]
"""Something that is asked for or not."""

Names = Annotated[list[str] | None, cyclopts.Parameter(consume_multiple=True, negative="")]
"""Several words after one option; commas separate too."""


def split(names: list[str] | None) -> list[str] | None:
    """Return names that were given as several words or with commas."""
    if names is None:
        return None
    return [part for word in names for part in word.split(",") if part]
