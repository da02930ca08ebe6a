"""The loop as a user goes through it: fit, diagnose, add, history, select, export; and what is refused."""

import json
import re
import sys
import tomllib
from pathlib import Path

import pytest

from imubayes.cli.main import run
from page_outline import assert_accessible

ROOT = Path(__file__).parents[2]
LACKING = "converter_offset_drift"


@pytest.fixture(scope="module")
def place(tmp_path_factory) -> Path:
    """A result whose model lacks an effect, and the diagnosis that led to the next one."""
    folder = tmp_path_factory.mktemp("loop")
    effects = (ROOT / "models" / "accel-channel.toml").read_text().split("[[effect]]")
    kept = [one for one in effects if f'name = "{LACKING}"' not in one]
    (folder / "model.toml").write_text("[[effect]]".join(kept))
    campaign = str(ROOT / "data" / "accel-channel")
    words = ["fit", campaign, "--model", str(folder / "model.toml"), "--out", str(folder / "first"), "--no-sample"]
    assert run(words) == 0
    return folder


def said(capsys, *words: str | Path) -> tuple[int, str, str]:
    status = run([str(word) for word in words])
    captured = capsys.readouterr()
    # Lines of progress, "fitting: mode · 3 s", come as slowly as the machine is.
    return status, captured.out, re.sub(r"^.* · \d+ s\n", "", captured.err, flags=re.MULTILINE)


def state_of(folder: Path) -> dict[str, tuple[int, bytes]]:
    """Return time and content of everything in a folder; its own time indicates files that came and went."""
    files = (folder, *folder.rglob("*"))
    return {str(file): (file.stat().st_mtime_ns, file.read_bytes() if file.is_file() else b"") for file in files}


@pytest.mark.slow
def test_the_loop(place, capsys):
    first, second = place / "first", place / "second"
    status, out, err = said(capsys, "diagnose", first, "--json")
    assert (status, err) == (0, "")
    found = json.loads(out)
    assert LACKING in found["groups"][0]["effects"]
    assert found["next"].startswith("imubayes add ")
    assert (first / "figures" / "diagnosis.png").is_file()
    status, out, _ = said(capsys, "diagnose", first)
    assert out.splitlines()[0] == found["sentence"]
    assert any(line.startswith("next: imubayes add") for line in out.splitlines())
    status, out, err = said(capsys, "diagnose", first, "--python")
    assert (status, out) == (2, "")
    assert "there is no effect class to print" in err

    before = state_of(first)
    status, out, _ = said(capsys, "add", LACKING, "--to", first, "--out", second, "--channels", "ax", "--json")
    assert status == 0
    assert state_of(first) == before, "the parent may be read-only"
    added = json.loads(out)
    assert added["taken"]
    assert added["held_out"]["verdict"] == "helps"
    names = {one["name"] for one in tomllib.loads((second / "model.toml").read_text())["effect"]}
    assert LACKING in names

    page = place / "history.html"
    status, out, _ = said(capsys, "history", second, "--html", page, "--json")
    assert_accessible(page.read_text(encoding="utf-8"))
    nodes = json.loads(out)["nodes"]
    assert [one["selected"] for one in nodes] == [False, True]
    # What is predicted, observed and drawn is one figure: χ² at the noise known beforehand.
    drops = found["groups"][0]["delta_chi2"], added["predicted"]["delta_chi2"], added["observed"]["delta_chi2"]
    assert drops == pytest.approx([nodes[0]["chi2"] - nodes[1]["chi2"]] * 3, rel=0.05)
    predicted, channel = found["groups"][0]["residual"], added["channels"][0]
    assert predicted["before"] == pytest.approx(1e6 * channel["before"], rel=0.05)
    assert predicted["after"] == pytest.approx(1e6 * channel["after"], rel=0.05)
    assert nodes[1]["rms"][0]["rms"] == channel["after"]
    text = page.read_text()
    assert "color-scheme: light dark" in text
    assert text.count('src="data:image/png;base64,') == text.count("<img ") >= 3
    assert not re.search(r'(?:src|href)="(?!data:)|<script|<link|@import|url\(', text)

    status, out, _ = said(capsys, "history", second, "--select", first, "--export", place / "chosen.toml")
    assert status == 0
    assert (place / "chosen.toml").read_text() == (first / "model.toml").read_text()
    assert said(capsys, "add", LACKING, "--to", first, "--out", second)[0] == 2


@pytest.mark.slow
def test_planting_on_the_command_line(place, capsys):
    words = ["plant", "--result", place / "first", "--effects", "converter_offset_drift_quadratic", "--draws", "1"]
    status, out, _ = said(capsys, *words, "--json")
    assert status == 0
    found = json.loads(out)
    assert found["null"]["draws"] == 1
    assert found["effects"][0]["delta_chi2"] == pytest.approx(50, rel=0.03)


@pytest.mark.parametrize(
    "words",
    [
        ["diagnose", "none"],
        ["add", "accel_bias", "--to", "none", "--out", "out"],
        ["add", "--to", "none", "--out", "out"],
        ["history", "none"],
        ["history"],
        ["plant"],
        ["plant", "data/none", "--model", "none.toml"],
    ],
    ids=" ".join,
)
def test_unusable_command_lines(capsys, tmp_path, monkeypatch, words):
    monkeypatch.chdir(tmp_path)
    status, out, err = said(capsys, *words)
    assert status == 2, out
    assert all(part in err for part in ("error: ", "  where:   ", "  do:      "))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_a_refit_that_is_not_taken_has_status_1(place, capsys, monkeypatch, tmp_path):
    refit = sys.modules["imubayes.loop.refit"]
    monkeypatch.setattr(refit, "observed_delta_chi2", lambda *_: -4.0)
    status, _, err = said(capsys, "add", LACKING, "--to", place / "first", "--out", tmp_path / "worse")
    assert status == 1
    assert "fits worse" in err


def test_help_has_an_example(capsys):
    for command in ("diagnose", "add", "history", "plant"):
        status, out, _ = said(capsys, command, "--help")
        assert status == 0
        assert "Example: imubayes" in out
