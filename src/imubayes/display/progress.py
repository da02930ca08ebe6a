"""Progress on standard error or below the cell of a notebook: a moving line, or plain lines.

On a terminal the line moves; elsewhere there are plain lines.  Nothing is shown during the first second.  A thread of
its own moves the line while the work computes, so that a step without news is seen to be at work.  A call from Python
shows a line below the cell of a notebook, or on the terminal; it changes as the work goes on and is gone when it is
done.
"""

import contextvars
import shutil
import sys
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from html import escape
from typing import Any, Protocol, runtime_checkable

from imubayes.foundations.progress import Tell, silent

FIRST = 1.0
"""Seconds without a sign of life at the most."""

_FRAMES = "⠋⠙⠹⠸⠼⠴⠦⠧⠇⠏"
_FRAME = 0.1
# Plain lines: a new step is reported at once, the same one with its counter no more often than this.
_LINE, _STILL = 2.0, 15.0


@runtime_checkable
class Stream(Protocol):
    """What is written to, such as standard error."""

    def write(self, text: str, /) -> int:
        """Write a text."""
        ...

    def flush(self) -> None:
        """Write what is kept back."""
        ...

    def isatty(self) -> bool:
        """Whether it is a terminal."""
        ...


@contextmanager
def terminal_progress(stream: Stream | None = None, *, lines: bool = True, text: str = "starting") -> Iterator[Tell]:
    """Yield a function that shows a status text on standard error until the block ends.

    Parameters
    ----------
    stream : standard error if None.
    lines : whether plain lines are printed if the stream is no terminal; silent there otherwise.
    text : of the first step.
    """
    chosen: Stream = stream if stream is not None else sys.stderr
    moving = chosen.isatty()
    if not moving and not lines:
        yield silent
        return
    with (_MovingLine if moving else _PlainLines)(chosen, text).shown() as tell:
        yield tell


class ShownProgress(ABC):
    """Display, in a thread of its own, the step that goes on and the seconds since the first one began."""

    def __init__(self, text: str):
        self._text = text
        self._began = time.monotonic()
        self._done = threading.Event()
        # A notebook knows by its context which cell it shows something below.
        self._thread = threading.Thread(target=contextvars.copy_context().run, args=(self.show,), daemon=True)

    @contextmanager
    def shown(self) -> Iterator[Tell]:
        """Show the step until the block ends, and take the line away; yield the function that reports a step."""
        self._thread.start()
        try:
            yield self.tell
        finally:
            self._done.set()
            self._thread.join()

    def tell(self, text: str) -> None:
        """Report the step that goes on."""
        self._text = text

    @abstractmethod
    def show(self) -> None:
        """Show the steps until `_done` is set."""

    def _seconds(self) -> float:
        return time.monotonic() - self._began


class _OnStream(ShownProgress):
    def __init__(self, stream: Stream, text: str):
        super().__init__(text)
        self._stream = stream

    def _write(self, text: str) -> None:
        try:
            self._stream.write(text)
            self._stream.flush()
        except (OSError, ValueError):  # closed by the other end
            self._done.set()


class _MovingLine(_OnStream):
    """A line that is written over, and gone in the end."""

    def show(self) -> None:
        if self._done.wait(FIRST):
            return
        frame = 0
        while True:
            width = shutil.get_terminal_size().columns - 1
            line = f"{_FRAMES[frame % len(_FRAMES)]} {self._text} · {self._seconds():.0f} s"
            self._write(f"\r\x1b[2K{line[:width]}")
            frame += 1
            if self._done.wait(_FRAME):
                self._write("\r\x1b[2K")
                return


class _PlainLines(_OnStream):
    """A line for each step, and one now and then for a step that goes on."""

    def show(self) -> None:
        said, at = "", -_STILL
        wait = FIRST
        while not self._done.wait(wait):
            wait, text, now = _LINE / 4, self._text, self._seconds()
            if now - at < (_STILL if text == said else _LINE):
                continue
            self._write(f"{text} · {now:.0f} s\n")
            said, at = text, now


# Seconds between two changes of the line: each is a message to the browser.
_TICK = 0.5


@contextmanager
def progress_of(given: Tell | None) -> Iterator[Tell]:
    """Yield the function that was given, or one that shows its text below the cell in a notebook or on the terminal.

    If standard error is no terminal nothing is said: a script that wants lines gives a function.
    """
    if given is not None:
        yield given
        return
    display = _display()
    if display is None:
        with terminal_progress(lines=False) as tell:
            yield tell
        return
    with _Line(display).shown() as tell:
        yield tell


def _display() -> Callable[..., Any] | None:
    """Return the display function of a Jupyter kernel; None if this is none.

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
