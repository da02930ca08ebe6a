"""Start-up of the computing commands: double precision, persistent compilation cache, progress display."""

from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path

from imubayes.display.terminal_progress import terminal_progress


def start_jax(command: str = "") -> None:
    """Enable double precision and the persistent compilation cache, and load what the command used the last time."""
    from imubayes.jax_settings import prepare_jax

    prepare_jax(command)


def trusting(place: Path | None, trust: bool) -> None:
    """Remember the effect files that come along with a result, model or plan as trusted, where the user says so."""
    if trust and place is not None:
        from imubayes.results.carried_effects import trust as remember

        remember(place)


def progress(text: str = "loading") -> AbstractContextManager[Callable[[str], None]]:
    """Show what goes on, on standard error, from the first second on; yield a function that tells the step.

    Enter it before what takes long to import, and print nothing to standard error within.
    """
    return terminal_progress(text=text)
