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


def output_of(program: str, environment: dict[str, str]) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False, env=environment)


def test_all_public_names_are_there_without_extras(command_environment):
    done = output_of(PROGRAM.replace("{extras!r}", repr(set(EXTRAS))), command_environment)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize(
    ("file", "start", "package"), [("log.ulg", b"ULog\x01\x12\x35", "pyulog"), ("log.tdms", b"TDSm", "npTDMS")]
)
def test_a_recording_that_needs_an_extra_names_it(tmp_path, command_environment, file, start, package):
    (tmp_path / file).write_bytes(start + bytes(64))
    program = PROGRAM.replace("{extras!r}", repr(set(EXTRAS)))
    program += (
        f"from imubayes.cli.main import run\nsys.exit(run(['convert', {str(tmp_path / file)!r}, '--out', 'c']))\n"
    )
    done = output_of(program, command_environment)
    assert done.returncode == 2
    assert package in done.stderr
    assert "Traceback" not in done.stderr
