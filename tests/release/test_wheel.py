"""The wheel works alone: built from the source archive, in an environment without the repository and without extras.

`make release-check` runs these tests, the long ones as well.
"""

import re
import tomllib
import zipfile
from email.parser import Parser
from pathlib import Path

import pytest
from packaging.metadata import Metadata

import imubayes
from readme_commands import sections

ROOT = Path(__file__).parents[2]
MOST_EXAMPLES = 1_000_000  # bytes of the wheel


def test_the_metadata_are_valid(wheel):
    with zipfile.ZipFile(wheel) as archive:
        text = archive.read(next(name for name in archive.namelist() if name.endswith(".dist-info/METADATA"))).decode()
    found = Metadata.from_email(text, validate=True)
    assert Parser().parsestr(text)["Description-Content-Type"] == "text/markdown"
    assert found.license_expression == "Apache-2.0"
    assert str(found.version) == imubayes.__version__


def test_every_place_states_the_same_version():
    newest = re.search(r"^## \[(\d+\.\d+\.\d+)\]", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    cited = re.search(r"^version: (\S+)$", (ROOT / "CITATION.cff").read_text(), re.MULTILINE)
    assert newest is not None
    assert cited is not None
    assert {newest[1], cited[1]} == {imubayes.__version__}
    assert tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["dynamic"] == ["version"]


def test_examples_are_few_enough(wheel):
    with zipfile.ZipFile(wheel) as archive:
        entries = archive.infolist()
    examples = [entry for entry in entries if entry.filename.startswith("imubayes/examples/")]
    assert 100_000 < sum(entry.compress_size for entry in examples) <= MOST_EXAMPLES
    # Nothing else is in the wheel, and nothing that makes or tests it.
    assert {entry.filename.partition("/")[0] for entry in entries if ".dist-info/" not in entry.filename} == {
        "imubayes",
        "imubayes_archive",
        "imubayes_explorer",
        "imubayes_qualification",
        "imubayes_recordings",
    }
    assert not [entry.filename for entry in examples if entry.filename.endswith((".py", ".ipynb", ".png"))]


def test_the_wheel_stands_alone(ran, alone, outside):
    """It is the installed package that runs, and its examples are found and copied without a repository."""
    place = ran("python -c 'import imubayes; print(imubayes.__file__)'").strip()
    assert Path(place).is_relative_to(alone.parent)
    listed = ran("imubayes example")
    assert all(name in listed for name in ("trihedral-imu", "hidden-gyro", "desk-imu", "accel-channel", "unit-archive"))
    assert "static-record" not in listed  # too large for a wheel; its plan simulates another
    ran("imubayes example accel-channel --out tour")
    checked = ran("imubayes check tour/data/accel-channel --model accel-channel")
    assert "accel-channel" in checked
    assert not (outside / "accel-channel").exists()


@pytest.mark.slow
def test_the_demonstration_runs(ran, outside):
    said = ran("imubayes demo --no-sample --out demo")
    page = re.search(r"^open this page: (.*)$", said, re.MULTILINE)
    assert page is not None
    assert Path(page[1]).read_text(encoding="utf-8").startswith("<!doctype html>")
    assert "gyro_scale_asymmetry is missing on" in said
    assert (outside / "demo" / "results" / "hidden-gyro" / "diagnosis.json").is_file()


@pytest.mark.slow
def test_the_commands_of_the_readme_run(ran, outside):
    ran("imubayes example hidden-gyro trihedral-imu --out .")
    for command in (command for commands in sections("README.md").values() for command in commands):
        ran(command)
    assert (outside / "results" / "history.html").is_file()
