"""The package without its extras: every public name is there, and what needs an extra says which."""

import subprocess
import sys

import pytest

# The packages of the page are asked for by tests/explore.
EXTRAS = (
    "asammdf",
    "nptdms",
    "pymavlink",
    "pyulog",
    "rosbags",
    "typst",
    "distributed",
)
PROGRAM = """
import faulthandler, sys
from importlib.abc import MetaPathFinder
faulthandler.dump_traceback_later(100, exit=True)

class Missing(MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {extras!r}:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Missing())
import imubayes
for name in imubayes.__all__:
    getattr(imubayes, name)
"""


RECORDINGS = {"log.ulg": (b"ULog\x01\x12\x35", "pyulog"), "log.tdms": (b"TDSm", "npTDMS")}
CONVERT = """
from imubayes.cli.main import run
for file in sys.argv[1:]:
    print(run(["convert", file, "--out", "c"]), flush=True)
print(run(["batch", "units", "--model", "accel-channel", "--out", "o", "--workers", "2"]), flush=True)
print(run(["batch", "units", "--model", "accel-channel", "--out", "o"]), flush=True)
"""


@pytest.mark.compiled  # processes
@pytest.mark.slow
def test_all_public_names_are_there_without_extras_and_a_recording_that_needs_one_names_it(
    tmp_path, command_environment
):
    """In one process, as its start takes most of the time."""
    for file, (start, _) in RECORDINGS.items():
        (tmp_path / file).write_bytes(start + bytes(64))
    program = PROGRAM.replace("{extras!r}", repr(set(EXTRAS))) + CONVERT
    words = [sys.executable, "-c", program, *RECORDINGS]
    done = subprocess.run(words, capture_output=True, text=True, check=False, env=command_environment, cwd=tmp_path)
    assert done.stdout.split() == ["2", "2", "2", "2"], done.stderr
    assert "Traceback" not in done.stderr
    said = done.stderr.split("error: ")[1:]
    named = [*(package for _, package in RECORDINGS.values()), "imubayes[cluster]", "there is no such folder"]
    assert all(package in text for package, text in zip(named, said, strict=True)), said
