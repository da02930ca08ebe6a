"""Files of the user are kept: folders that are no result, interrupted samplings, files of other commands."""

import json
import shutil
import threading
from pathlib import Path

import h5py
import pytest

from imubayes.cli.main import run
from imubayes.foundations.files import only_writer
from imubayes.inference.checkpoint import steps_in
from kept_results import listed

ROOT = Path(__file__).parents[2]
CAMPAIGN, MODEL = ROOT / "data" / "accel-channel", ROOT / "models" / "accel-channel.toml"
PARTS = ("error: ", "  where:   ", "  do:      ")


@pytest.fixture
def result(accel_channel, tmp_path) -> Path:
    return Path(shutil.copytree(accel_channel, tmp_path / "result"))


@pytest.fixture
def refused(capsys):
    def check(*words: object) -> str:
        capsys.readouterr()
        status = run([str(word) for word in words])
        err = capsys.readouterr().err
        assert status == 2, err
        assert all(part in err for part in PARTS), err
        assert "unforeseen" not in err
        return err

    return check


def fit_into(out: object, *words: str) -> tuple:
    return ("fit", CAMPAIGN, "--model", MODEL, "--out", out, "--no-sample", *words)


def begun(folder: Path, steps: int) -> Path:
    """A checkpoint of so many steps, with nothing else in the folder."""
    folder.mkdir(exist_ok=True)
    with h5py.File(folder / "checkpoint.h5", "w") as file:
        for number in range(4):
            file.create_group(f"ensemble_{number}").attrs["iteration"] = steps
    return folder


def with_own_effect(folder: Path, returned: str, beside: tuple[str, ...] = ()) -> Path:
    """The model, or some of its effects, with an effect of the user's own beside it."""
    (folder / "mine.py").write_text(
        "import jax.numpy as jnp\n"
        "from imubayes import Order, Scalar, SignalEffect, Stage, parameter\n\n\n"
        "class Mine(SignalEffect):\n"
        '    """A scale factor of one\'s own."""\n\n'
        '    name = "mine"\n'
        '    stage, order, kinds = Stage.SENSOR, Order.SCALE, ("accelerometer",)\n'
        '    k: Scalar = parameter("ppm", "normal(0, 100 ppm)", (10, 300), "k")\n\n'
        "    def apply(self, signal, sample):\n"
        f"        return {returned}\n"
    )
    first, *effects = MODEL.read_text().split("[[effect]]")
    kept = [each for each in effects if not beside or any(f'"{name}"' in each for name in beside)]
    own = "[[effect]]".join([f'{first}files = ["mine.py"]\n', *kept, '\nname = "mine"\n'])
    (folder / "model.toml").write_text(own)
    return folder / "model.toml"


def test_a_folder_that_is_no_result_is_not_written_to(tmp_path, refused):
    own = tmp_path / "work"
    own.mkdir()
    (own / "model.toml").write_text("# my notes\n")
    assert "'model.toml' and no result" in refused(*fit_into(own))
    assert [one.name for one in own.iterdir()] == ["model.toml"]
    assert (own / "model.toml").read_text() == "# my notes\n"


def test_the_campaign_is_no_place_for_a_result(tmp_path, refused):
    campaign = Path(shutil.copytree(CAMPAIGN, tmp_path / "campaign"))
    there = sorted(campaign.rglob("*"))
    refused("fit", campaign, "--model", MODEL, "--out", campaign, "--no-sample")
    assert sorted(campaign.rglob("*")) == there


@pytest.mark.slow
def test_what_cannot_be_kept_is_shown(result, tmp_path, capsys):
    def said(folder: Path, *words: str) -> tuple[int, str, list[str]]:
        status = run([words[0], str(folder), *words[1:]])
        shown = capsys.readouterr()
        lines = [line for line in shown.err.splitlines() if line.startswith("warning")]
        return status, shown.out.replace(str(folder), "RESULT"), lines

    closed = Path(shutil.copytree(result, tmp_path / "closed"))
    (closed / ".lock").mkdir()  # nobody can hold this folder
    (closed / "figures").write_text("no folder")
    before = {file: file.read_bytes() for file in closed.iterdir() if file.is_file()}
    for words in (("diagnose",), ("diagnose", "--json"), ("compare",)):
        status, out, told = said(result, *words)
        assert (status, told) == (0, [])
        shown, others = said(closed, *words)[1:]
        assert len(others) == 1
        assert f"nothing of this is kept in {closed} (" in others[0]
        written = ("picture:", " more figures", "figures in", "the most important")
        assert shown.splitlines() == [line for line in out.splitlines() if not any(each in line for each in written)]
    assert {file: file.read_bytes() for file in closed.iterdir() if file.is_file()} == before


@pytest.mark.slow
def test_an_answer_about_one_effect_leaves_the_pictures_alone(result):
    (result / "figures").mkdir()
    (result / "figures" / "diagnosis.png").write_text("drawn")
    assert run(["diagnose", str(result), "--effect", "accel_quadratic"]) == 0
    assert (result / "figures" / "diagnosis.png").read_text() == "drawn"
    assert run(["diagnose", str(result)]) == 0
    picture = result / "figures" / "diagnosis.png"
    assert not picture.exists() or picture.read_bytes() != b"drawn", "of another diagnosis"


@pytest.mark.parametrize("below", ["", "folder"])
def test_a_file_is_no_place_for_a_result(tmp_path, refused, below):
    (tmp_path / "file").write_text("mine")
    assert str(tmp_path / "file") in refused(*fit_into(tmp_path / "file" / below))
    assert (tmp_path / "file").read_text() == "mine"


@pytest.mark.parametrize(
    "words",
    [
        ("fit", CAMPAIGN, "--model", MODEL, "--out", "OUT", "--no-sample"),
        ("add", "accel_quadratic", "--to", "RESULT", "--out", "OUT"),
        ("remove", "accel_bias", "--from", "RESULT", "--out", "OUT"),
        ("report", "RESULT", "--out", "OUT.html"),
        ("batch", CAMPAIGN.parent, "--model", MODEL, "--out", "OUT"),
    ],
    ids=lambda words: words[0],
)
def test_what_another_process_writes_is_refused_at_once(accel_channel, tmp_path, refused, monkeypatch, words):
    out = tmp_path / ("out.html" if "OUT.html" in words else "out")
    if out.suffix == "":
        out.mkdir()
    for name in ("imubayes.api.fitting.joint_fit", "imubayes.api.loop.refit_with",
                 "imubayes.api.loop.refit_without",
                 "imubayes_qualification.api.calibrated_unit.report_of"):  # fmt: skip
        monkeypatch.setattr(name, lambda *_, **__: pytest.fail("it began"))
    held, done = threading.Event(), threading.Event()

    def other() -> None:
        with only_writer(out):
            held.set()
            done.wait()

    thread = threading.Thread(target=other)
    thread.start()
    held.wait()
    try:
        given = [accel_channel if word == "RESULT" else out if str(word).startswith("OUT") else word for word in words]
        err = refused(*given)
    finally:
        done.set()
        thread.join()
    assert "another process is writing here" in err
    assert not out.is_dir() or not any(out.iterdir())


def test_a_result_is_replaced_and_what_stands_beside_it_stays(result):
    (result / "notes.txt").write_text("mine")
    assert run([str(word) for word in fit_into(result)]) == 0
    assert (result / "notes.txt").read_text() == "mine"


def test_an_interrupted_sampling_is_not_begun_anew(tmp_path, refused):
    folder = begun(tmp_path / "cut", 5)
    whole = (folder / "checkpoint.h5").read_bytes()
    assert "--resume" in refused(*fit_into(folder))
    for words in (("compare", folder), ("diagnose", folder), ("add", "accel_quadratic", "--to", folder, "--out", "x")):
        assert "with --resume" in refused(*words)
    assert (folder / "checkpoint.h5").read_bytes() == whole


@pytest.mark.slow
def test_one_that_came_to_nothing_or_to_a_result_is_replaced(tmp_path, result):
    assert run([str(word) for word in fit_into(begun(tmp_path / "none", 0))]) == 0
    begun(result, 5)
    summary = result / "summary.json"
    summary.write_text(summary.read_text())  # after the checkpoint: the result is of it
    assert run([str(word) for word in fit_into(result)]) == 0


def test_steps_of_what_is_no_checkpoint(tmp_path):
    (tmp_path / "checkpoint.h5").write_text("no")
    assert steps_in(tmp_path / "checkpoint.h5") == steps_in(tmp_path / "none.h5") == 0
    assert steps_in(begun(tmp_path / "cut", 7) / "checkpoint.h5") == 7


def test_an_interrupt_is_said(monkeypatch, capsys, tmp_path):
    def interrupt(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("imubayes.api.fit", interrupt)
    assert run([str(word) for word in fit_into(tmp_path / "out")]) == 130
    assert "--resume" in capsys.readouterr().err


def test_history_overwrites_no_file(result, tmp_path, refused):
    other = tmp_path / "campaign.toml"
    other.write_text("mine")
    for option in ("--export", "--html"):
        assert "is there already" in refused("history", result, option, other)
        assert other.read_text() == "mine"
    page = tmp_path / "new" / "history.html"
    for _ in range(2):  # its own page is brought up to date
        assert run(["history", str(result), "--html", str(page)]) == 0
    assert refused("history", result, "--html", tmp_path)


def test_a_damaged_result_is_not_called_interrupted(result, refused):
    begun(result, 5)
    (result / "fit.json").write_text("{")
    assert "run `imubayes fit` again with this folder as --out" in refused("diagnose", result)


def test_export_leaves_another_effect_of_that_name_alone(result, tmp_path, refused):
    models = tmp_path / "models"
    models.mkdir()
    model = with_own_effect(models, "signal * (1 + self.k)")
    out, effect = result, models / "mine.py"
    for file in (model, effect):  # as a fit with this model leaves them
        shutil.copyfile(file, out / file.name)
    listed(out)
    assert run(["history", str(out), "--export", str(models / "same.toml")]) == 0  # the same file may stand there
    edited = effect.read_text() + "# mine\n"
    effect.write_text(edited)
    assert "mine.py" in refused("history", out, "--export", models / "other.toml")
    assert effect.read_text() == edited
    assert not (models / "other.toml").exists()


def test_a_model_that_was_edited_is_noticed(result, refused):
    model = result / "model.toml"
    text = model.read_text()
    assert "normal(0, " in text
    model.write_text(text.replace("normal(0, ", "normal(0, 2", 1))
    assert "model.toml has" in refused("diagnose", result)
    assert "no longer the one that was fitted" in refused("diagnose", listed(result))
    model.write_text(text)
    listed(result)
    assert run(["diagnose", str(result), "--effect", "accel_quadratic"]) == 0


def test_a_damaged_record_is_named(result, refused):
    record = json.loads((result / "fit.json").read_text())
    for key, value in (("z", [1.0]), ("campaign", "x"), ("format", 99)):
        (result / "fit.json").write_text(json.dumps(record | {key: value}))
        assert f"key {key}" in refused("diagnose", listed(result))


@pytest.mark.parametrize(
    ("effect", "text"),
    [
        ("accel_quadratik", "allowed: accel_quadratic"),
        ("white_noise", "noise, not an effect"),
        ("accel_bias", "in the model already"),
    ],
)
def test_only_what_could_be_missing_is_asked_about(result, refused, effect, text):
    assert text in refused("diagnose", result, "--effect", effect)


def test_the_textbook_stands_beside_its_own_campaign_alone(result, refused):
    assert "not of the campaign" in refused("classical", ROOT / "data" / "redundant-imu", "--result", result)
    assert run(["classical", str(CAMPAIGN), "--result", str(result)]) == 0


@pytest.mark.parametrize("words", [("--size", "-1"), ("--size", "nan"), ("--delta-chi2", "0"), ("--draws", "-3")])
def test_what_is_planted_has_a_size(result, refused, words):
    assert "plant" in refused("plant", "--result", result, *words)


def test_a_fit_without_numbers_is_told_and_not_drawn(tmp_path, refused, capsys):
    model = with_own_effect(tmp_path, "signal + self.k * jnp.nan", ("accel_bias", "white_noise"))
    out = tmp_path / "out"
    assert run(["fit", str(CAMPAIGN), "--model", str(model), "--out", str(out), "--no-sample"]) == 1
    assert "NOT CONVERGED" in capsys.readouterr().out
    summary = json.loads((out / "summary.json").read_text())
    assert summary["chi2"] is None
    assert not summary["converged"]
    assert "predictions are not finite" in refused("compare", out)


def test_an_interrupted_batch_says_what_is_kept_of_it(monkeypatch, capsys, tmp_path):
    def interrupt(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("imubayes_archive.api.archives.batch", interrupt)
    archive = str(ROOT / "data" / "unit-archive")
    assert run(["batch", archive, "--model", "accel-channel", "--out", str(tmp_path / "units")]) == 130
    assert "the units fitted so far are kept" in capsys.readouterr().err
