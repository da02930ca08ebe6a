"""Options of the classical evaluation and of the carrier on the command line, and the threshold of a campaign."""

import json
import shutil
from pathlib import Path

import polars as pl
import pytest

from imubayes.cli.main import run

ROOT = Path(__file__).parents[2]
CAMPAIGN = ROOT / "data" / "accel-channel"


@pytest.fixture
def decisions(capsys):
    def found(*arguments):
        assert run(["classical", *map(str, arguments), "--json"]) == 0
        facts = json.loads(capsys.readouterr().out)
        return {one["name"]: one["decision"] for one in facts["estimates"] if one["decision"]}

    return found


def test_the_threshold_comes_from_the_option_the_campaign_or_the_default(decisions, tmp_path):
    name = "delta_k[ax,ramp-trihedral]"
    assert decisions(CAMPAIGN)[name].startswith("threshold 10 %: 0.577 g needs its own line")
    assert decisions(CAMPAIGN, "--delta-k-threshold", 200)[name].startswith("threshold 200 %: the 1 g line applies")
    own = tmp_path / "own"
    shutil.copytree(CAMPAIGN, own)
    text = (own / "campaign.toml").read_text()
    (own / "campaign.toml").write_text(
        text.replace("[site]", "[evaluation]\ndelta_k_threshold_percent = 50.0\n\n[site]", 1)
    )
    assert decisions(own)[name].startswith("threshold 50 %")
    assert decisions(own, "--delta-k-threshold", 20)[name].startswith("threshold 20 %")


def test_a_threshold_of_nothing_is_refused(capsys):
    assert run(["classical", str(CAMPAIGN), "--delta-k-threshold", "0"]) == 2
    assert "--delta-k-threshold" in capsys.readouterr().err


@pytest.mark.parametrize(
    "name",
    ["accel-channel", "polar-tumble", "reference-gyro",
     *(pytest.param(name, marks=pytest.mark.slow) for name in ("trihedral-imu", "rotation-modulation"))],
)  # fmt: skip
def test_every_estimate_states_how_its_uncertainty_was_evaluated(capsys, name):
    assert run(["classical", str(ROOT / "data" / name), "--json"]) == 0
    estimates = json.loads(capsys.readouterr().out)["estimates"]
    assert estimates
    for one in estimates:
        assert one["sd"] is not None, one["name"]
        assert one["uncertainty"].startswith("type A"), one["name"]


@pytest.mark.slow
def test_the_carrier_without_a_fit(tmp_path, capsys):
    out = tmp_path / "carrier.csv"
    assert run(["carrier", str(ROOT / "data" / "rotation-modulation"), "pyramid-unfinished", "--out", str(out)]) == 0
    assert "As recorded" in capsys.readouterr().out
    assert {"rate_z_deg_s", "force_z_g"} <= set(pl.read_csv(out).columns)
