"""Shipped files: examples that can be listed, copied and demonstrated, and models that are known by their names."""

import shutil
from pathlib import Path

import pytest

from imubayes.cli.main import run
from imubayes.foundations.errors import InputError
from imubayes.foundations.shipped_examples import copy_examples, example, examples, model_names, shipped
from imubayes.model.model_file import read_model
from imubayes_explorer.start import SHIPPED

ROOT = Path(__file__).parents[2]


@pytest.fixture
def place(tmp_path, monkeypatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def refused(capsys, *words: str) -> str:
    assert run(words) == 2
    return capsys.readouterr().err


def test_every_example_has_its_model_and_is_described():
    found = examples()
    folders = {folder.name for folder in (ROOT / "data").iterdir() if (folder / "campaign.toml").is_file()}
    assert set(found) == folders | {"unit-archive"}
    for each in found.values():
        assert all(shipped(part).exists() for part in (each.data, each.model, *each.others))
        assert each.summary.endswith(".")
    plans = {plan.name for plan in (ROOT / "data" / "plans").glob("*.toml")}
    assert {part.name for each in found.values() for part in each.others if part.parts[1] == "plans"} == plans


def test_no_shipped_model_brings_code():
    """Models that are named run their effect files without a question."""
    assert len(model_names()) > 10
    assert [name for name in model_names() if read_model(shipped(Path("models", f"{name}.toml"))).files] == []


def test_a_model_is_known_by_its_name(place):
    found = read_model("hidden-effects")
    assert (found.name, Path(found.where)) == ("hidden-effects", ROOT / "models" / "hidden-effects.toml")
    shutil.copyfile(ROOT / "models" / "start.toml", place / "hidden-effects")
    assert read_model("hidden-effects").name == "start"  # a file on disk wins


def test_a_folder_of_that_name_is_no_model(place):
    (place / "trihedral-imu").mkdir()
    assert read_model("trihedral-imu").name == "trihedral-imu"


def test_an_unknown_name_is_told_with_the_known_ones(place, capsys):
    said = refused(capsys, "check", str(ROOT / "data" / "accel-channel"), "--model", "accel-chanel")
    assert "no model 'accel-chanel'" in said
    assert all(name in said for name in model_names())
    assert "qualification-spec" not in said


def test_a_path_is_no_name(place):
    with pytest.raises(InputError, match=r"no file 'start\.toml'"):
        read_model("models/start.toml")


def test_the_loop_in_the_browser_begins_with_an_example():
    assert example(SHIPPED).is_campaign


def test_a_copy_is_the_example(place, capsys):
    assert run(["example", "trihedral-imu", "full-qualification", "--out", "tour"]) == 0
    said = capsys.readouterr().out
    assert "next, in tour: imubayes check data/trihedral-imu --model models/trihedral-imu.toml" in said
    for part in ("data/plans/trihedral-example.toml", "models/qualification-spec.toml", "models/trihedral-imu.toml"):
        assert (place / "tour" / part).read_bytes() == (ROOT / part).read_bytes()
    copied = {file.relative_to(place / "tour") for file in (place / "tour").rglob("*") if file.is_file()}
    assert {file.relative_to(ROOT) for file in (ROOT / "data" / "trihedral-imu").rglob("*")} - copied == {
        Path("data/trihedral-imu/runs")
    }


def test_what_was_altered_is_not_overwritten(place, capsys):
    copy_examples([example("accel-channel")], Path("tour"))
    copy_examples([example("accel-channel")], Path("tour"))  # as it is there
    altered = place / "tour" / "data" / "accel-channel" / "campaign.toml"
    altered.write_text("mine")
    assert "is there already" in refused(capsys, "example", "hidden-two", "accel-channel", "--out", "tour")
    assert altered.read_text() == "mine"
    assert not (place / "tour" / "data" / "hidden-two").exists()


def test_a_file_in_the_way_is_left(place):
    (place / "tour").mkdir()
    (place / "tour" / "data").write_text("mine")
    with pytest.raises(OSError, match="tour"):
        copy_examples([example("accel-channel")], Path("tour"))
    assert [path.name for path in (place / "tour").iterdir()] == ["data"]


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["example", "hiden-gyro", "--out", "tour"], "hidden-gyro"),
        (["example", "hidden-gyro"], "--out"),
        (["demo", "unit-archive"], "archive of units"),
        (["demo", "nothing"], "trihedral-imu"),
    ],
)
def test_what_cannot_be_copied_is_refused(place, capsys, words, named):
    assert named in refused(capsys, *words)
    assert list(place.iterdir()) == []


def test_a_demonstration_ends_with_what_to_type_next(place, capsys):
    assert run(["demo", "accel-channel", "--no-sample", "--out", "."]) == 0
    said = capsys.readouterr().out
    for command in ("fit data/accel-channel --model models/accel-channel.toml --out results/accel-channel",
                    "compare results/accel-channel", "diagnose results/accel-channel"):  # fmt: skip
        assert f"$ imubayes {command}" in said
    assert f"open this page: {place / 'results' / 'accel-channel' / 'compare.html'}" in said
    assert "imubayes demo hidden-gyro    The gyros hide something" in said
    assert (place / "results" / "accel-channel" / "diagnosis.json").is_file()
