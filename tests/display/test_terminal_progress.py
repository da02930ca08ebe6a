"""Progress: something moves within two seconds on a terminal, in lines elsewhere, with an estimate of the time left."""

import io
import os
import pty
import re
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress

import pytest

from imubayes.display import progress as shown
from imubayes.display.progress import progress_of
from imubayes.foundations.progress import counted, duration


class Terminal(io.StringIO):
    """A stream that says that it is a terminal."""

    def isatty(self) -> bool:
        return True


@pytest.fixture
def hasty(monkeypatch):
    """Everything ten times as fast."""
    monkeypatch.setattr(shown, "FIRST", 0.05)
    monkeypatch.setattr(shown, "_FRAME", 0.01)
    monkeypatch.setattr(shown, "_LINE", 0.05)
    monkeypatch.setattr(shown, "_STILL", 0.2)


def until(condition: Callable[[], bool]) -> None:
    end = time.monotonic() + 10
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.005)


def test_a_line_moves_while_a_step_goes_on(hasty):
    stream = Terminal()
    with shown.terminal_progress(stream) as tell:
        tell("fitting: mode")
        until(lambda: len(set(re.findall(r"[⠋⠙⠹⠸⠼⠴⠦⠧⠇⠏] fitting: mode", stream.getvalue()))) > 3)
    assert stream.getvalue().endswith("\r\x1b[2K")  # the line is gone


def test_nothing_is_shown_of_what_is_done_at_once(hasty):
    for stream in (Terminal(), io.StringIO()):
        with shown.terminal_progress(stream) as tell:
            tell("fitting")
        assert stream.getvalue() == ""


def test_plain_lines_where_there_is_no_terminal(hasty):
    stream = io.StringIO()
    with shown.terminal_progress(stream) as tell:
        tell("first")
        until(lambda: stream.getvalue().count("first") == 2)  # it goes on
        tell("second")
        until(lambda: "second" in stream.getvalue())
    assert "\r" not in stream.getvalue()
    assert "\x1b" not in stream.getvalue()
    assert re.fullmatch(r"(first · \d+ s\n)+second · \d+ s\n", stream.getvalue())


def test_a_call_from_python_speaks_on_a_terminal_alone(hasty, monkeypatch):
    for stream, speaks in ((Terminal(), True), (io.StringIO(), False)):
        monkeypatch.setattr(sys, "stderr", stream)
        with progress_of(None) as tell:
            tell("fitting")
            time.sleep(0.1)
            if speaks:
                until(lambda stream=stream: "fitting" in stream.getvalue())
        assert ("fitting" in stream.getvalue()) is speaks


def test_a_closed_stream_stops_the_display_not_the_work(hasty):
    stream = Terminal()
    with shown.terminal_progress(stream):
        stream.close()
        time.sleep(0.1)


def test_steps_are_counted_with_the_time_left(monkeypatch):
    clock = iter([0.0, 0.0, 10.0, 12.0, 14.0])
    monkeypatch.setattr("imubayes.foundations.progress.time.monotonic", lambda: next(clock))
    said: list[str] = []
    assert list(counted(said.append, "leave-one-run-out", "abcd")) == list("abcd")
    # The first step compiles: the estimate is by the others.
    assert said == [
        "leave-one-run-out, 1 of 4",
        "leave-one-run-out, 2 of 4",
        "leave-one-run-out, 3 of 4, about 4 s left",
        "leave-one-run-out, 4 of 4, about 2 s left",
    ]
    assert [duration(seconds) for seconds in (0.2, 40, 200, 7200)] == ["1 s", "40 s", "3 min", "2.0 h"]


def test_a_command_on_a_pseudo_terminal_moves_within_two_seconds(tmp_path):
    """A slow start-up, as of JAX: the line stands there while modules are imported."""
    code = (
        "import sys, time\n"
        "from imubayes.cli.session import progress\n"
        "with progress() as tell:\n"
        "    time.sleep(1.3)\n"
        "    tell('fitting: mode')\n"
        "    time.sleep(0.4)\n"
    )
    terminal, other = pty.openpty()
    process = subprocess.Popen([sys.executable, "-c", code], stdin=other, stdout=other, stderr=other)
    os.close(other)
    began, first, text = time.monotonic(), None, b""
    with suppress(OSError):  # the child has ended
        while part := os.read(terminal, 4096):
            first = first if first is not None else time.monotonic() - began
            text += part
    os.close(terminal)
    assert process.wait() == 0
    assert first is not None
    assert re.search(r"loading · \d s", text.decode())
    assert "fitting: mode" in text.decode()
