"""Files left by a process that died are removed by the next one; those that a living one writes stay."""

import os
import shutil
import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path

import pytest

from imubayes.foundations.files import new_folder, replacing, write_text


@pytest.fixture(scope="module")
def dead() -> int:
    """Return the number of a process that has ended."""
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    return process.pid


@pytest.mark.parametrize("writing", [replacing, new_folder])
def test_leftovers_of_the_dead_go(tmp_path, dead, writing: Callable[[Path], AbstractContextManager[Path]]):
    target = tmp_path / "out[1]"
    left, other, living = (
        tmp_path / f".{name}.part" for name in (f"out[1].{dead}", f"out.{dead}", f"out[1].{os.getppid()}")
    )
    for place in (left, other, living):
        place.mkdir()
        (place / "half").write_text("half")
    with writing(target) as scratch:
        scratch.mkdir(exist_ok=True) if writing is new_folder else scratch.write_text("whole")
    assert target.exists()
    assert not left.exists()
    assert other.exists(), "of another place"
    assert living.exists()


def test_an_error_leaves_what_was_there(tmp_path):
    file = tmp_path / "file"
    write_text(file, "old")

    def fail() -> None:
        with replacing(file) as scratch:
            scratch.write_text("half")
            raise RuntimeError("no more")

    with pytest.raises(RuntimeError):
        fail()
    assert [(each.name, each.read_text()) for each in tmp_path.iterdir()] == [("file", "old")]


@pytest.mark.parametrize("writing", [replacing, new_folder])
def test_threads_do_not_remove_what_the_other_writes(tmp_path, writing: Callable[[Path], AbstractContextManager[Path]]):
    """The second thread begins and ends while the first one writes."""
    target = tmp_path / "out"

    def write(text: str) -> None:
        with writing(target) as scratch:
            file = scratch / "file" if scratch.is_dir() else scratch
            file.write_text(text)
            if text == "first":
                second = threading.Thread(target=write, args=("second",))
                second.start()
                second.join()
                assert file.read_text() == "first"
                (shutil.rmtree if target.is_dir() else os.remove)(target)

    write("first")
    file = target / "file" if target.is_dir() else target
    assert file.read_text() == "first"
    assert [each.name for each in tmp_path.iterdir()] == ["out"]


def test_the_leftover_of_a_thread_of_a_dead_process_goes(tmp_path, dead):
    left, living = (tmp_path / f".out.{process}.140062.part" for process in (dead, os.getppid()))
    left.write_text("half")
    living.write_text("half")
    write_text(tmp_path / "out", "whole")
    assert (left.exists(), living.exists()) == (False, True)
