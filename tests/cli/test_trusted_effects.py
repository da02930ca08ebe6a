"""Effect files are code: what comes along with a result or a plan runs only if the user trusts it, as it is."""

import json
import shutil
from pathlib import Path

import pytest

from display.synthetic_results import summary_of, trihedral_residuals, write_folder
from imubayes.cli.main import run
from imubayes.foundations.errors import InputError
from imubayes.model.effect_registry import names_in
from imubayes.model.model_file import read_carried_model
from imubayes.results.folder_files import trust
from imubayes.results.history_tree import CampaignPlaces, FitRecord
from kept_results import listed

ROOT = Path(__file__).parents[2]
CAMPAIGN, MODEL = ROOT / "data" / "accel-channel", ROOT / "models" / "accel-channel.toml"
EFFECT = '''"""An effect that says that it was run."""

from pathlib import Path

from imubayes import Order, Scalar, SignalEffect, Stage, parameter

(Path(__file__).parent / "was-run").touch()


class Mine(SignalEffect):
    """A scale factor of one's own."""

    name = "mine_{number}"
    stage, order, kinds = Stage.SENSOR, Order.SCALE, ("accelerometer",)
    k: Scalar = parameter("ppm", "normal(0, 100 ppm)", (10, 300), "k")

    def apply(self, signal, sample):
        return signal * (1 + self.k)
'''


@pytest.fixture(autouse=True)
def configuration(tmp_path, monkeypatch) -> Path:
    """Nothing is trusted yet."""
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "configuration"))
    return tmp_path / "configuration" / "imubayes" / "trusted.json"


@pytest.fixture
def received(tmp_path, request) -> Path:
    """A result folder from elsewhere, whose model brings an effect that no other test has run."""
    residuals = trihedral_residuals(temperatures=(25,), channels=("gx",))
    folder = write_folder(tmp_path / "received", residuals, summary_of(residuals, sampled=False))
    record = FitRecord(
        campaign=CampaignPlaces(given=str(CAMPAIGN)), data_hash="", model_hash="", z={}, h={}, converged=True,
        message="", seed=0, campaign_notes=(),
    )  # fmt: skip
    (folder / "fit.json").write_text(record.json_text())
    number = abs(hash(request.node.name))
    (folder / "mine.py").write_text(EFFECT.replace("{number}", str(number)))
    first, rest = MODEL.read_text().split("[[effect]]", 1)
    own = f'[[effect]]\nname = "mine_{number}"\n\n'
    (folder / "model.toml").write_text(f'{first}files = ["mine.py"]\n\n{own}[[effect]]{rest}')
    return listed(folder)


@pytest.mark.parametrize(
    "words",
    [
        ("diagnose", "RESULT"),
        ("report", "RESULT", "--out", "OUT.html"),
        ("add", "accel_quadratic", "--to", "RESULT", "--out", "OUT"),
        ("remove", "mine", "--from", "RESULT", "--out", "OUT"),
        ("refit", "RESULT", "--model", str(MODEL), "--out", "OUT"),
        ("plant", "--result", "RESULT"),
        ("export", "RESULT", "--out", "OUT.json"),
        ("apply", "RESULT", str(CAMPAIGN), "--out", "OUT.csv"),
    ],
    ids=lambda words: words[0],
)
def test_a_received_effect_is_not_run(received, tmp_path, capsys, words):
    places = {"RESULT": str(received), "OUT": str(tmp_path / "out")}
    given = [word.replace("OUT", places["OUT"]) if word.startswith("OUT") else places.get(word, word) for word in words]
    assert run(given) == 2
    said = capsys.readouterr().err
    assert "'mine.py' is Python code that came with the input" in said
    assert "--trust" in said
    assert not (received / "was-run").exists()
    assert not (tmp_path / "out").exists()


def test_a_trusted_effect_runs_now_and_later(received, capsys, configuration):
    assert run(["diagnose", str(received), "--trust"]) == 2  # the record is made up
    assert "not trusted" not in capsys.readouterr().err
    assert (received / "was-run").exists()
    assert len(json.loads(configuration.read_text())["sha256"]) == 1


def test_what_is_trusted_is_the_text_of_a_file(received, tmp_path):
    with pytest.raises(InputError, match=r"'mine\.py' is Python code"):
        read_carried_model(received / "model.toml")
    assert trust(received) == (received / "mine.py",)
    assert read_carried_model(received / "model.toml").files == (str(received / "mine.py"),)
    moved = Path(shutil.copytree(received, tmp_path / "moved"))
    assert read_carried_model(moved / "model.toml").files
    with (moved / "mine.py").open("a") as file:
        file.write("# one line more\n")
    with pytest.raises(InputError, match="not trusted"):
        read_carried_model(moved / "model.toml")
    trust(moved / "mine.py")
    assert read_carried_model(moved / "model.toml").files
    assert read_carried_model(received / "model.toml").files


def test_what_the_user_named_may_run_again_in_this_process(received):
    names_in(received / "mine.py")
    assert read_carried_model(received / "model.toml").files


def test_a_plan_brings_no_code_either(received, tmp_path, capsys):
    plan = (ROOT / "data" / "plans" / "accel-channel-example.toml").read_text()
    file = tmp_path / "plan.toml"
    file.write_text(plan.replace("../../models/accel-channel.toml", str(received / "model.toml")))
    assert run(["simulate", str(file), "--out", str(tmp_path / "out")]) == 2
    assert "not trusted" in capsys.readouterr().err
    assert not (received / "was-run").exists()


@pytest.mark.parametrize("name", ["../mine.py", "/etc/mine.py", "a/../../mine.py"])
def test_effect_files_lie_with_their_model(received, name):
    file = received / "model.toml"
    file.write_text(file.read_text().replace('"mine.py"', f'"{name}"'))
    with pytest.raises(InputError, match="files") as caught:
        read_carried_model(file)
    assert "in the same folder or below" in caught.value.issues[0].allowed
