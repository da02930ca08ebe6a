"""What the commands share: start-up of JAX, reading beside its import, progress display, options, JSON output.

Computing commands start with double precision, a persistent compilation cache and a progress display.  A campaign is
read in a process of its own while this one imports JAX: each takes a second, on a core of its own.
"""

import json
import os
import signal
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager, contextmanager
from multiprocessing import active_children, get_context
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import cyclopts

from imubayes.display.progress import terminal_progress
from imubayes.foundations.records import Record

if TYPE_CHECKING:
    from imubayes.campaign import Inspection
    from imubayes.display.layout import Report


@contextmanager
def inspecting(campaign: Path) -> Iterator[Callable[[], "Inspection"]]:
    """Begin to read and judge a campaign, and yield a function that waits for the result.

    Where JAX is imported already, or there is one core, the function does all of it.
    """
    if "jax" in sys.modules or (os.cpu_count() or 1) < 2:
        yield lambda: _inspect(campaign)
        return
    # Spawned: a process that holds JAX must not fork, and what is imported here shall not depend on the order.
    pool = ProcessPoolExecutor(1, get_context("spawn"), _leave_interrupts_to_the_parent)
    inspection = pool.submit(_inspect, campaign)

    def wait() -> "Inspection":
        try:
            return inspection.result()
        except BrokenProcessPool:  # killed, or this system starts no processes
            return _inspect(campaign)

    try:
        yield wait
    finally:
        if not inspection.done():  # an error elsewhere: nobody waits for the result
            for child in active_children():
                child.terminate()
        # A child that is still to be told to end would wait for it for ever: the command ends without Python's shutdown
        # of threads, and joins its children.
        pool.shutdown(wait=True, cancel_futures=True)


def _inspect(campaign: Path) -> "Inspection":
    from imubayes.campaign import inspect_campaign

    return inspect_campaign(campaign)


def _leave_interrupts_to_the_parent() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)


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


def show(record: Callable[[], Any], report: Callable[[], "Report"], as_json: bool) -> None:
    """Print what was found: the record as JSON where that is asked for, else its report; only that one is made."""
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
    """Remember the effect files that come along with a result, model or plan as trusted, where the user says so."""
    if trust and place is not None:
        from imubayes.results.folder_files import trust as remember

        remember(place)


def progress(text: str = "loading") -> AbstractContextManager[Callable[[str], None]]:
    """Show what goes on, on standard error, from the first second on; yield a function that tells the step.

    Enter it before what takes long to import, and print nothing to standard error within.
    """
    return terminal_progress(text=text)
