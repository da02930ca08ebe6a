"""Progress of a call from Python: a line below the cell of a notebook, or on the terminal.

It changes as the work goes on and is gone when it is done.
"""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from html import escape
from typing import Any

from imubayes.display.terminal_progress import ShownProgress, terminal_progress
from imubayes.step_counter import Tell

# Seconds between two changes of the line: each is a message to the browser.
_TICK = 0.5


@contextmanager
def progress_of(given: Tell | None) -> Iterator[Tell]:
    """Yield the function that was given, or one that shows its text below the cell in a notebook or on the terminal.

    Where standard error is no terminal nothing is said: a script that wants lines gives a function.
    """
    if given is not None:
        yield given
        return
    display = _display()
    if display is None:
        with terminal_progress(lines=False) as tell:
            yield tell
        return
    line = _Line(display)
    line.start()
    try:
        yield line.tell
    finally:
        line.stop()


def _display() -> Callable[..., Any] | None:
    """Return the display function of a Jupyter kernel; None where this is none.

    A kernel has imported IPython, so nothing has to be imported to ask.
    """
    shell = sys.modules.get("IPython.core.getipython")
    running = shell.get_ipython() if shell is not None else None
    if running is None or getattr(running, "kernel", None) is None:
        return None
    return sys.modules["IPython.core.display_functions"].display


class _Line(ShownProgress):
    """The line below the cell, with the seconds since it began; it ticks while a step goes on without news."""

    def __init__(self, display: Callable[..., Any]):
        super().__init__("starting")
        self._cell = display(self._content(), raw=True, display_id=True)

    def show(self) -> None:
        while not self._done.wait(_TICK):
            self._cell.update(self._content(), raw=True)
        self._cell.update({"text/plain": ""}, raw=True)

    def _content(self) -> dict[str, str]:
        shown = f"{self._text} … {self._seconds():.0f} s"
        return {"text/plain": shown, "text/html": f'<span style="opacity:.75">{escape(shown)}</span>'}
