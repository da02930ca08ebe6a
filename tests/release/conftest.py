"""The wheel, and an environment that holds it, what it requires, and nothing else.

The required packages are lent by the environment of the tests, so that no index is needed: a package that only an extra
requires, or that is imported and not required, is not there.
"""

import os
import shlex
import subprocess
import sys
import sysconfig
import tarfile
import venv
from importlib import import_module, metadata
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="session")
def wheel(tmp_path_factory) -> Path:
    """The wheel, built from an unpacked source archive, as an index or a packager builds it; in the folder BUILT."""
    source, backend, here = tmp_path_factory.mktemp("source"), import_module("hatchling.build"), Path.cwd()
    place = Path(os.environ.get("BUILT") or tmp_path_factory.mktemp("built")).resolve()
    try:
        os.chdir(ROOT)
        with tarfile.open(place / backend.build_sdist(str(place))) as archive:
            archive.extractall(source, filter="data")
        os.chdir(next(source.iterdir()))
        return place / backend.build_wheel(str(place))
    finally:
        os.chdir(here)


def required(name: str, extras: frozenset[str] = frozenset(), found: set[str] | None = None) -> set[str]:
    """Return the distributions that one requires, and that these require in turn."""
    found = set() if found is None else found
    for line in metadata.requires(name) or ():
        requirement = Requirement(line)
        wanted = requirement.marker is None or any(
            requirement.marker.evaluate({"extra": extra}) for extra in extras or {""}
        )
        key = f"{canonicalize_name(requirement.name)}{sorted(requirement.extras)}"
        if wanted and key not in found:
            found |= {key, canonicalize_name(requirement.name)}
            required(requirement.name, frozenset(requirement.extras), found)
    return {each for each in found if not each.endswith("]")}


def lend(names: set[str], place: Path) -> None:
    """Link the files of distributions into another environment."""
    for name in names:
        distribution = metadata.distribution(name)
        tops = {Path(str(file)).parts[0] for file in distribution.files or () if ".." not in file.parts}
        for top in tops - {"__pycache__"}:
            link = place / top
            if not link.exists():
                link.symlink_to(Path(str(distribution.locate_file(top))))


@pytest.fixture(scope="session")
def alone(wheel, tmp_path_factory) -> Path:
    """The programs of an environment with the wheel and what it requires."""
    place = tmp_path_factory.mktemp("alone")
    venv.create(place, symlinks=True)
    paths = sysconfig.get_paths("venv", {"base": str(place), "platbase": str(place)})
    python = Path(paths["scripts"], "python")
    pip = ["-m", "pip", "--python", python, "--disable-pip-version-check", "install", "--quiet"]
    flags = ["--no-deps", "--no-index", "--ignore-installed", "--no-compile"]
    subprocess.run([sys.executable, *pip, *flags, wheel], check=True)
    lend(required("imubayes"), Path(paths["purelib"]))
    return python.parent


@pytest.fixture(scope="module")
def outside(tmp_path_factory) -> Path:
    """A folder outside the repository."""
    return tmp_path_factory.mktemp("outside")


@pytest.fixture
def finished(alone, outside, command_environment):
    """Run a command of the installed wheel outside the repository."""
    environment = {key: value for key, value in command_environment.items() if key != "PYTHONPATH"}

    def run(command: str) -> subprocess.CompletedProcess[str]:
        words = shlex.split(command)
        return subprocess.run(
            [alone / words[0], *words[1:]], cwd=outside, env=environment, capture_output=True, text=True, check=False
        )

    return run


@pytest.fixture
def ran(finished):
    """Run a command that succeeds, and return what it prints."""

    def run(command: str) -> str:
        done = finished(command)
        assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
        return done.stdout

    return run
