"""Shared by all commands: start-up of JAX, progress display, options, JSON output.

Computing commands start with double precision, a persistent compilation cache and a progress display.
"""

import json
import math
import sys
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import cyclopts

from imubayes.display.progress import terminal_progress
from imubayes.foundations.records import Record

if TYPE_CHECKING:
    from imubayes.display.layout import Report

Json = Annotated[bool, cyclopts.Parameter(name=("--json", "--json-output"), negative="")]
"""Print one JSON object on standard output."""

Flag = Annotated[bool, cyclopts.Parameter(negative="")]
"""A switch without a negative form."""

Trust = Annotated[bool, cyclopts.Parameter(negative="")]
"""Run the effect files that come with the input, now and later: they are code."""

Names = Annotated[list[str] | None, cyclopts.Parameter(consume_multiple=True, negative="")]
"""Several names after one option, separated by blanks or commas."""

Repeated = Annotated[list[str] | None, cyclopts.Parameter(negative="")]
"""Names, each after an option of its own."""


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


def show(record: Callable[[], Any], report: Callable[[], "Report"], as_json: bool) -> None:
    """Print what was found: the record as JSON if requested, else its report; only that one is made."""
    if as_json:
        found = record()
        print_json(found.model_dump(mode="json") if isinstance(found, Record) else found)
    else:
        from imubayes.display.layout import print_report

        print_report(report())


def start_jax(command: str = "") -> None:
    """Enable double precision and the persistent compilation cache, and load what the command used the last time."""
    from imubayes.compiled.jax_settings import prepare_jax

    prepare_jax(command)


def trusting(place: Path | None, trust: bool) -> None:
    """Remember the effect files that come with a result, model or plan as trusted, if the user says so."""
    if trust and place is not None:
        from imubayes.results.folder_files import trust as remember

        remember(place)


def progress(text: str = "loading") -> AbstractContextManager[Callable[[str], None]]:
    """Show what goes on, on standard error, from the first second on; yield a function that reports the step.

    Enter it before what takes long to import, and print nothing to standard error within.
    """
    return terminal_progress(text=text)


_OF_AXES = ("--accel-scale", "--accel-offset", "--gyro-scale", "--gyro-offset")
"""Options of one number, or of one for each axis."""


def numbers_apart(words: Sequence[str]) -> list[str]:
    """Return the words of a command line with the option before each number of an axis.

    People write `--gyro-offset 24800 40600 41140`, or `24800,40600,41140`.
    """
    left, apart = list(words), list[str]()
    while left:
        name, equals, first = left.pop(0).partition("=")
        if name not in _OF_AXES:
            apart.append(f"{name}{equals}{first}")
            continue
        given = [first] if equals else []
        while left and len(given) < 3 and _numbers(left[0]):
            given.append(left.pop(0))
        numbers = [number for word in given for number in _numbers(word) or [word]]
        apart += [f"{name}={number}" for number in numbers] or [name]
    return apart


def _numbers(word: str) -> list[str]:
    """Return the numbers of a word, which commas separate; none if it is anything else."""
    parts = word.strip("[]()").split(",")
    try:
        return parts if all(math.isfinite(float(part)) for part in parts) else []
    except ValueError:
        return []
