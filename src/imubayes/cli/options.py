"""Options shared by several commands, and the JSON output of all."""

import json
import sys
from typing import Annotated, Any

import cyclopts

Json = Annotated[bool, cyclopts.Parameter(name=("--json", "--json-output"), negative="")]
"""Print one JSON object on standard output."""

Flag = Annotated[bool, cyclopts.Parameter(negative="")]
"""A switch without a negative form."""

Trust = Annotated[bool, cyclopts.Parameter(negative="")]
"""Run the effect files that come along, now and later: they are code."""

Names = Annotated[list[str] | None, cyclopts.Parameter(consume_multiple=True, negative="")]
"""Several names after one option, separated by blanks or commas."""


def split(names: list[str] | None) -> list[str] | None:
    """Return the names of a `Names` option, split at commas."""
    if names is None:
        return None
    return [part for word in names for part in word.split(",") if part]


def print_json(value: Any) -> None:
    """Print a JSON value as one line on standard output."""
    plain = (sys.stdout.encoding or "utf-8").lower().replace("-", "") != "utf8"
    json.dump(value, sys.stdout, ensure_ascii=plain)
    print()
