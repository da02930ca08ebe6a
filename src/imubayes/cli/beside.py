"""Reading a campaign in a process of its own while this one imports JAX: each takes a second, on a core of its own."""

import os
import signal
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import active_children, get_context
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from imubayes.campaign import Inspection


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
