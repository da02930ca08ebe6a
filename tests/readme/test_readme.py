"""The README does what it says: its commands run as written, its effect is fitted, its pictures are there."""

import json
import re
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest

from imubayes.cli.main import run
from imubayes.foundations.units import BIAS_CONVENTION
from readme_commands import sections

ROOT = Path(__file__).parents[2]
TEXT = (ROOT / "README.md").read_text()
COMMANDS = sections("README.md") | sections("data/archives.md")


def test_what_a_bias_is_referred_to_stands_as_everywhere():
    assert BIAS_CONVENTION in " ".join(TEXT.split())


def test_there_are_commands():
    assert sum(map(len, COMMANDS.values())) >= 8


# What takes long is run by `make study`: a whole qualification compiles for a minute, an archive is fitted in one.
LONG = ("Procedures", "Archives")
WRITTEN = {"convert": "mapping.toml", "archive": "unit=*/*.parquet", "batch": "model-*/part-*/units.parquet"}


@pytest.fixture
def like_the_repository(tmp_path, monkeypatch) -> Path:
    """A working directory with the repository's data and models, for what is written relative to it."""
    for name in ("data", "models"):
        (tmp_path / name).symlink_to(ROOT / name)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize(
    "heading", [pytest.param(one, marks=pytest.mark.slow) if one in LONG else one for one in COMMANDS]
)
def test_commands_run_as_written(heading, like_the_repository, capsys):
    """Those of a section, in order, in a folder that looks like the repository."""
    told: dict[str, list[str]] = {}
    for command in COMMANDS[heading]:
        status = run(shlex.split(command)[1:])
        said = capsys.readouterr()
        assert status == 0, f"{command}\n{said.err}"
        words = command.removeprefix("imubayes ").split()
        verb = " ".join(words[: 2 if words[0] == "batch" and words[1].isalpha() else 1])
        told.setdefault(verb, []).append(one_line(said.out))
        if "--out" in command:
            out = Path(command.split("--out ")[1].split()[0])
            assert out.is_file() if out.suffix else any(out.glob(WRITTEN.get(verb, "summary.json")))
    if heading == "Procedures":  # its diagnosis is of another result than the one that is shown
        return
    for verb in {"diagnose", "add", "batch diagnose"} & set(told):
        # What the README shows is what the command prints.
        shown = re.search(rf"<!-- output of {verb} -->\n```text\n(.*?)```", TEXT, re.DOTALL)
        assert shown is not None
        for line in shown[1].splitlines():
            assert one_line(line) in told[verb][0]
    if "diagnose" in told:
        assert re.match("The model (probably )?explains the data", told["diagnose"][1])
        assert Path("results", "history.html").is_file()


def one_line(text: str) -> str:
    """Return a text with single spaces."""
    return re.sub(r"\s+", " ", text.strip())


def test_a_command_runs_in_a_process_of_its_own(like_the_repository, command_environment):
    """As a user starts it; the others run in this process, which is spared the start."""
    command = next(one for commands in COMMANDS.values() for one in commands if one.startswith("imubayes check"))
    words = [sys.executable, "-m", "imubayes.cli.main", *shlex.split(command)[1:]]
    done = subprocess.run(words, env=command_environment, capture_output=True, text=True)
    assert done.returncode == 0
    assert all(re.search(r" · \d+ s$", line) for line in done.stderr.splitlines())  # progress alone
    assert "trihedral-imu" in done.stdout


def test_pictures_are_there():
    for name in re.findall(r"!\[.*?\]\((.*?)\)", TEXT):
        assert (ROOT / name).is_file()


def test_python_runs_as_written(like_the_repository, capsys):
    blocks = re.findall(r"```python\n(.*?)```", TEXT, re.DOTALL)
    code = "\n".join(block for block in blocks if "SignalEffect" not in block)
    names: dict[str, Any] = {"__name__": "__main__"}
    exec(compile(code, "README.md", "exec"), names)
    assert "converter_gain_drift" in capsys.readouterr().out
    assert names["samples"].converged


def test_the_users_effect_is_fitted(tmp_path, capsys):
    """The class of the README, in one file beside the model, is fitted and finds nothing in data without it."""
    code = next(block for block in re.findall(r"```python\n(.*?)```", TEXT, re.DOTALL) if "SignalEffect" in block)
    assert len(code.strip().splitlines()) <= 18
    (tmp_path / "my_effect.py").write_text(code)
    model = (ROOT / "models" / "hidden-effects.toml").read_text()
    name = re.search(r'name = "(gyro_\w+)"', code)
    assert name is not None
    first = model.index("[[effect]]")
    added = f'[[effect]]\nname = "{name[1]}"\n\n'
    mine = tmp_path / "mine.toml"
    mine.write_text(model[:first] + 'files = ["my_effect.py"]\n\n' + added + model[first:])
    words = ["fit", str(ROOT / "data" / "hidden-none"), "--model", str(mine), "--out", str(tmp_path / "out")]
    assert run([*words, "--no-sample", "--json-output"]) == 0
    found = {one["name"]: one for one in json.loads(capsys.readouterr().out)["parameters"]}
    for channel in ("gx", "gy", "gz"):
        asymmetry = found[f"{name[1]}.asymmetry[{channel}]"]
        assert abs(asymmetry["mean"]) < 4 * asymmetry["sd"]
    assert tomllib.loads((tmp_path / "out" / "model.toml").read_text())["files"] == ["my_effect.py"]
    assert (tmp_path / "out" / "my_effect.py").read_text() == code


@pytest.mark.parametrize("word", ["make demo", "make test"])
def test_the_two_commands_exist(word):
    assert f"\n{word.split()[1]}:" in (ROOT / "Makefile").read_text()
