"""Progress in a notebook: one line below the cell that changes as the work goes on and is gone when it is done."""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from html import escape
from typing import Any

# A line changes no faster than this, seconds: each change is a message to the browser.
_SHORTEST = 0.2

Tell = Callable[[str], None]


@contextmanager
def progress_of(given: Tell | None) -> Iterator[Tell]:
    """Yield the function that was given, one that shows its text below the cell in a notebook, or a silent one."""
    display = None if given is not None else _display()
    if display is None:
        yield given or (lambda text: None)
        return
    line = _Line(display)
    try:
        yield line.show
    finally:
        line.clear()


def _display() -> Callable[..., Any] | None:
    """Return the display function of a Jupyter kernel; None where this is none.

    A kernel has imported IPython, so nothing has to be imported to ask.
    """
    shell = sys.modules.get("IPython.core.getipython")
    running = shell.get_ipython() if shell is not None else None
    if running is None or getattr(running, "kernel", None) is None:
        return None
    return sys.modules["IPython.core.display_functions"].display


class _Line:
    """The line below the cell, with the seconds since it began."""

    def __init__(self, display: Callable[..., Any]):
        self._display, self._handle = display, None
        self._began = self._changed = time.monotonic()

    def show(self, text: str) -> None:
        now = time.monotonic()
        if self._handle is not None and now - self._changed < _SHORTEST:
            return
        self._changed = now
        shown = f"{text} … {now - self._began:.0f} s"
        content = {"text/plain": shown, "text/html": f'<span style="opacity:.75">{escape(shown)}</span>'}
        if self._handle is None:
            self._handle = self._display(content, raw=True, display_id=True)
        else:
            self._handle.update(content, raw=True)

    def clear(self) -> None:
        if self._handle is not None:
            self._handle.update({"text/plain": ""}, raw=True)
