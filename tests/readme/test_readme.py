"""The README does what it says: its commands run and print what it shows, its pictures and links are there."""

import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from imubayes.cli.main import run
from imubayes.foundations.units import BIAS_CONVENTION
from readme_commands import outputs, sections

ROOT = Path(__file__).parents[2]
TEXT = (ROOT / "README.md").read_text(encoding="utf-8")
DOCUMENTS = ("README.md", "data/archives.md")
COMMANDS = [(document, heading) for document in DOCUMENTS for heading in sections(document)]
# What takes long is run by `make study`: an archive is fitted in a minute, and `make demo` is the main job.
LONG = ("The main job", "Archives")
# What comes before the refit, of a campaign that other tests fit and diagnose as well; all of it by `make study`.
BEGINNING = {"The loop": "imubayes add"}
WRITTEN = {"archive": "unit=*/*.parquet", "batch": "model-*/part-*/units.parquet"}


@pytest.fixture
def like_the_repository(tmp_path, monkeypatch) -> Path:
    """A working directory with the repository's data and models, for what is written relative to it."""
    for name in ("data", "models"):
        (tmp_path / name).symlink_to(ROOT / name)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def one_line(text: str) -> str:
    """Return a text with single spaces."""
    return re.sub(r"\s+", " ", text.strip())


def is_told(line: str, said: str) -> bool:
    """Return whether an output has a line, of sampled estimates to a tenth of their standard deviation."""
    name, *_ = line.split()
    shown, printed = (re.search(rf"(?:^| ){re.escape(name)} (\S+) ± (\S+) (.*)", text) for text in (line, said))
    if not (name.endswith("]") and shown and printed):
        return line in said
    (mean, sd), (other, _) = ((float(found[1]), float(found[2])) for found in (shown, printed))
    return printed[3].startswith(shown[3]) and abs(mean - other) < 0.1 * sd


def test_an_estimate_that_moved_is_not_told():
    said = "name estimate a[gx] 54.677447 ± 0.000029 deg > 99.99 % b"
    assert is_told("a[gx] 54.677448 ± 0.000029 deg > 99.99 %", said)
    assert not is_told("a[gx] 54.677453 ± 0.000029 deg > 99.99 %", said)
    assert not is_told("a[gx] 54.677447 ± 0.000029 deg 97 %", said)
    assert not is_told("c 1.5", said)


def said_by(commands: list[str], capsys) -> dict[str, list[str]]:
    """Run commands in order; return what each printed, by its verb."""
    told: dict[str, list[str]] = {}
    for command in commands:
        status = run(shlex.split(command)[1:])
        said = capsys.readouterr()
        assert status == 0, f"{command}\n{said.err}"
        verb = command.split()[1]
        told.setdefault(verb, []).append(one_line(said.out))
        if "--out" in command:
            out = Path(command.split("--out ")[1].split()[0])
            assert out.is_file() if out.suffix else any(out.glob(WRITTEN.get(verb, "summary.json")))
    return told


def check_shown(told: dict[str, list[str]], heading: str, document: str) -> None:
    """Check that what a section shows of these commands was printed."""
    for verb, lines in outputs(document, heading).items():
        for line in lines if verb in told else ():
            assert is_told(one_line(line), told[verb][0])


@pytest.mark.parametrize(
    ("heading", "document"),
    [
        pytest.param(heading, document, id=heading, marks=pytest.mark.slow if heading in (*LONG, *BEGINNING) else ())
        for document, heading in COMMANDS
    ],
)
def test_commands_run_as_written(heading, document, like_the_repository, capsys):
    """Those of a section, in order, in a folder that looks like the repository."""
    told = said_by(sections(document)[heading], capsys)
    check_shown(told, heading, document)
    if "diagnose" in told:
        assert re.match("The model (probably )?explains the data", told["diagnose"][1])
        assert Path("results", "history.html").is_file()


@pytest.mark.parametrize(("heading", "end"), BEGINNING.items())
def test_commands_before_a_refit_run_as_written(heading, end, like_the_repository, capsys):
    commands = sections("README.md")[heading]
    first = next(place for place, command in enumerate(commands) if command.startswith(end))
    told = said_by(commands[:first], capsys)
    assert "diagnose" in told
    check_shown(told, heading, "README.md")


def test_every_output_is_one_of_a_section_that_runs():
    shown = re.findall("<!-- output of (.*) -->", TEXT)
    assert shown == [
        verb for document, heading in COMMANDS if document == "README.md" for verb in outputs(document, heading)
    ]
    assert len(shown) == 3


def test_a_command_runs_in_a_process_of_its_own(like_the_repository, command_environment):
    """As a user starts it; the others run in this process, which is spared the start."""
    command = next(one for one in sections("README.md")["The main job"] if one.startswith("imubayes check"))
    words = [sys.executable, "-m", "imubayes.cli.main", *shlex.split(command)[1:]]
    done = subprocess.run(words, env=command_environment, capture_output=True, text=True)
    assert done.returncode == 0
    assert all(re.search(r" · \d+ s$", line) for line in done.stderr.splitlines())  # progress alone
    assert "trihedral-imu" in done.stdout


def test_python_runs_as_written(like_the_repository, capsys):
    (code,) = re.findall(r"```python\n(.*?)```", TEXT, re.DOTALL)
    exec(compile(code, "README.md", "exec"), {"__name__": "__main__"})
    assert "converter_gain_drift.slope[ax]" in capsys.readouterr().out


def test_it_is_short_and_its_pictures_and_links_are_there():
    assert len(TEXT.splitlines()) <= 120
    places = re.findall(r"\]\(([^)#]*)", TEXT)
    assert len(places) > 10
    assert [place for place in places if not (ROOT / place).exists()] == []


def test_what_a_bias_is_referred_to_stands_as_everywhere():
    assert BIAS_CONVENTION in " ".join(TEXT.split())


@pytest.mark.parametrize("word", ["make demo", "make test"])
def test_the_two_commands_exist(word):
    assert f"\n{word.split()[1]}:" in (ROOT / "Makefile").read_text()
