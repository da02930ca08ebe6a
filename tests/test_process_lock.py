"""One process at a time writes to a place, and a lock ends with its process."""

import os
import resource
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from imubayes.foundations.errors import InputError
from imubayes.foundations.files import only_writer

HOLDER = """
import sys, time
from pathlib import Path
from imubayes.foundations.files import only_writer
with only_writer(Path(sys.argv[1])):
    print("held", flush=True)
    time.sleep(60)
"""


@pytest.fixture(params=["folder", "file"])
def place(request, tmp_path) -> Path:
    if request.param == "folder":
        (tmp_path / "result").mkdir()
    return tmp_path / "result"


def test_a_second_process_is_refused_until_the_first_dies(place, command_environment):
    process = subprocess.Popen(
        [sys.executable, "-c", HOLDER, str(place)], env=command_environment, stdout=subprocess.PIPE, text=True
    )
    try:
        assert process.stdout is not None
        assert process.stdout.readline() == "held\n"
        with pytest.raises(InputError, match=f"process {process.pid}") as caught, only_writer(place):
            pass
        assert caught.value.issues[0].where == str(place)
    finally:
        process.kill()
        process.communicate()
    with only_writer(place):
        pass
    assert [file for file in (place if place.is_dir() else place.parent).iterdir() if "lock" in file.name] == []


def _held_after(place: Path, patience: float) -> bool:
    with only_writer(place, patience):
        return True


def test_who_holds_a_place_may_hold_it_again_and_another_thread_not(place):
    refused, waited = [], []

    def other() -> None:
        try:
            with only_writer(place):
                pass
        except InputError as error:
            refused.append(error)

    with only_writer(place), only_writer(place):
        thread = threading.Thread(target=other)
        thread.start()
        thread.join()
        patient = threading.Thread(target=lambda: waited.append(_held_after(place, 5.0)))
        patient.start()
        time.sleep(0.2)
        assert waited == []
    patient.join()
    assert waited == [True]
    assert len(refused) == 1
    assert str(os.getpid()) in str(refused[0])
    other()
    assert len(refused) == 1


def test_a_full_disk_does_not_keep_a_place_from_being_held(tmp_path):
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, hard))  # no file of this process takes a byte
    try:
        with only_writer(tmp_path):
            assert (tmp_path / ".lock").exists()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert not any(tmp_path.iterdir())
