"""Start-up of the computing commands: double precision, persistent compilation cache, progress display."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager


def start_jax() -> None:
    """Enable double precision and the persistent compilation cache."""
    from imubayes.jax_settings import prepare_jax

    prepare_jax()


@contextmanager
def progress(quiet: bool = False) -> Iterator[Callable[[str], None]]:
    """Yield a function that shows a status text on a terminal (standard error); silent elsewhere."""
    if quiet or not sys.stderr.isatty():
        yield lambda text: None
        return
    from rich.console import Console

    with Console(stderr=True).status("starting") as status:
        yield lambda text: status.update(text)
