"""Campaign and model of `data/your-campaign.md` are accepted as written, and the fit finds what was put in."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from imubayes.cli.main import run

TEXT = (Path(__file__).parents[2] / "data" / "your-campaign.md").read_text(encoding="utf-8")
BIAS_MG, SCALE_PPM = 1.5, 80.0


def block(name: str) -> str:
    found = re.search(rf"<!-- {name}.*?-->\n```\w+\n(.*?)```", TEXT, re.DOTALL)
    assert found is not None
    return found[1]


def tumble(angles_deg: np.ndarray) -> np.ndarray:
    """Return mean outputs in mA: the axis x of the head is horizontal at zero and points down after 90 degrees."""
    felt_g = -np.sin(np.radians(angles_deg))
    return 12 + 4 * ((1 + 1e-6 * SCALE_PPM) * felt_g + 1e-3 * BIAS_MG)


@pytest.fixture
def folder(tmp_path) -> Path:
    campaign = tmp_path / "tumble"
    campaign.mkdir()
    (campaign / "campaign.toml").write_text(block("campaign.toml"))
    (tmp_path / "model.toml").write_text(block("model.toml"))
    angles = np.arange(0.0, 360.0, 30.0)
    outputs = tumble(angles) + np.random.default_rng(5).normal(0, 0.001 / np.sqrt(600), len(angles))
    header = block("tumble.csv").splitlines()[0]
    rows = [
        f"{15 + 45 * place},{angle:g},25.0,600,{output:.7f},0.00100"
        for place, (angle, output) in enumerate(zip(angles, outputs, strict=True))
    ]
    (campaign / "tumble.csv").write_text("\n".join([header, *rows]) + "\n")
    return campaign


def test_the_campaign_is_accepted(folder):
    assert run(["check", str(folder), "--model", str(folder.parent / "model.toml")]) == 0


def test_the_readings_left_out_are_those_of_the_campaign(folder, capsys):
    model = folder.parent / "model.toml"
    model.write_text(f"{model.read_text()}\n{block('set_aside')}")
    assert run(["check", str(folder), "--model", str(model)]) == 0
    model.write_text(model.read_text().replace("rows = [3, 4]", "rows = [13]"))
    assert run(["check", str(folder), "--model", str(model)]) == 2
    assert "the run has no row 13" in " ".join(capsys.readouterr().err.split())


@pytest.mark.slow  # compiles a campaign of its own
def test_the_fit_finds_what_was_put_in(folder, capsys):
    model = str(folder.parent / "model.toml")
    out = str(folder.parent / "out")
    assert run(["fit", str(folder), "--model", model, "--out", out, "--no-sample", "--json-output"]) == 0
    found = {each["name"]: each for each in json.loads(capsys.readouterr().out)["parameters"]}
    bias = found["accel_bias.bias[a1]"]
    assert abs(bias["mean"] - 1e3 * BIAS_MG) < 4 * bias["sd"]


def test_the_rows_shown_are_such_outputs():
    """Within a bias of 2 mg and some noise: the signs and the zero are those of the text."""
    rows = np.array([[float(word) for word in line.split(",")] for line in block("tumble.csv").splitlines()[1:]])
    assert np.max(np.abs(rows[:, 4] - tumble(rows[:, 1]))) < 0.02
