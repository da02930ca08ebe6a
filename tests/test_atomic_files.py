"""What a process that died left behind is removed by the next one; what a living one writes stays."""

import os
import subprocess
import sys
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
