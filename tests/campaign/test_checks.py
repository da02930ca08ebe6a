"""Named findings: what is odd about the data is said by name, with the right severity, and nothing else is."""

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow.csv as pacsv
import pytest
from small_files import DEGREE, EARTH, GRAVITY, write_csv

from imubayes.campaign import FINDINGS, check_campaign, inspect_campaign
from imubayes.foundations.campaign_data import Channel, Mounting, Site, Table
from imubayes.procedures.kinematics import nominal_input

Change = Callable[[dict], None]


def alter(file: Path, change: Change) -> None:
    table = pacsv.read_csv(file)
    columns = {name: table.column(name).to_numpy().copy() for name in table.column_names}
    change(columns)
    write_csv(file, columns)


def drop_seconds(columns: dict) -> None:
    keep = (columns["time_s"] < 3) | (columns["time_s"] > 5)
    for name in columns:
        columns[name] = columns[name][keep]


def freeze(columns: dict) -> None:
    columns["ax"][500:900] = columns["ax"][500]


def clip(columns: dict) -> None:
    columns["gz"] = np.minimum(columns["gz"], 80_000.0)


def reverse(columns: dict) -> None:
    columns["gz"] = -columns["gz"]


def double(columns: dict) -> None:
    columns["gz"] = 3 * columns["gz"]


def relabel(columns: dict) -> None:
    columns["segment"] = np.array(["one"] * len(columns["time_s"]))


def without_angle(columns: dict) -> None:
    columns["table_rate_deg_s"] = columns["table_rate_deg_s"] / 100
    columns["gz"] = columns["gz"] / 100
    del columns["table_angle_deg"]


def milli_g(columns: dict) -> None:
    columns["az"] = columns["az"] / 1000


@pytest.mark.parametrize(
    ("change", "name", "severity"),
    [
        (drop_seconds, "gap", "warning"),
        (freeze, "stuck_channel", "warning"),
        (clip, "saturated_channel", "warning"),
        (reverse, "table_reversed", "error"),
        # The gate tries a thousand pairs of mistakes; by the checks of a run alone it is below.
        pytest.param(double, "scale_far_from_nominal", "warning", marks=pytest.mark.slow),
        (relabel, "segment_not_constant", "warning"),
        (without_angle, "partial_turn", "warning"),
        (milli_g, "acceleration_unit", "error"),
    ],
)
def test_raw_log(small: Path, change: Change, name: str, severity: str) -> None:
    alter(small / "runs/raw.csv", change)
    read = inspect_campaign(small)
    assert {(finding.name, finding.severity, finding.run) for finding in read.findings} == {(name, severity, "raw")}
    assert read.findings[0].name in FINDINGS
    if severity == "warning":
        assert read.campaign is not None
        assert any(name in note for note in read.campaign.notes)
        assert any(name in note for note in read.campaign.runs[-1].notes)
    else:
        assert read.campaign is None


def test_a_scale_of_a_raw_log_far_from_nominal(small: Path) -> None:
    alter(small / "runs/raw.csv", double)
    found = inspect_campaign(small, judge_setup=False).findings
    assert [(each.name, each.severity, each.run) for each in found] == [("scale_far_from_nominal", "warning", "raw")]


@pytest.mark.parametrize(
    ("old", "new", "name", "severity"),
    [
        ('per = "deg/s"', 'per = "rad/s"', "channel_unit", "error"),
        # The reference reversed is the same to these data: both readings are stated.
        ("input_axis = [1.0, 0.0, 0.0]", "input_axis = [-1.0, 0.0, 0.0]", "reference_unit", "error"),
    ],
)
def test_a_gyro_is_compared_with_the_reference_beside_it(tmp_path: Path, old, new, name, severity) -> None:
    folder = Path(shutil.copytree(Path(__file__).parents[2] / "data" / "reference-gyro", tmp_path / "campaign"))
    assert not {one.name for one in check_campaign(folder)} & {"rate_unit", "sign_reversed"}
    text = (folder / "campaign.toml").read_text()
    assert old in text
    (folder / "campaign.toml").write_text(text.replace(old, new, 1))
    found = [one for one in check_campaign(folder) if one.name == name]
    assert found
    assert {one.severity for one in found} == {severity}
    assert all("'gx'" in one.what for one in found)


def test_a_run_without_any_reading_is_empty(small: Path) -> None:
    def forget(columns: dict) -> None:
        for name in ("gx", "gy", "gz", "ax", "ay", "az"):
            if name in columns:
                columns[name] = np.full(len(columns[name]), np.nan)

    file = small / "runs/rates.csv"
    alter(file, forget)
    file.write_text(file.read_text().replace("nan", ""))
    (finding,) = [one for one in check_campaign(small) if one.name == "empty_run"]
    assert (finding.severity, finding.run) == ("error", "rates")
    assert "no channel has a value" in finding.what


def test_coarse_converter_is_not_stuck(small: Path) -> None:
    def coarse(columns: dict) -> None:
        for name in ("gx", "gy", "gz", "ax", "ay", "az"):
            columns[name] = 100.0 * np.round(columns[name] / 100)

    alter(small / "runs/raw.csv", coarse)
    assert not [f for f in check_campaign(small) if f.severity == "error"]


def test_short_means_at_unknown_angle(small: Path) -> None:
    def slow(columns: dict) -> None:
        columns["time_s"] = np.arange(len(columns["time_s"])) * 2.0

    alter(small / "runs/rates.csv", slow)
    (finding,) = check_campaign(small)
    assert finding.name == "partial_turn"
    assert "20 deg/s" not in finding.where


def test_nominal_input() -> None:
    site = Site(45 * DEGREE, 0.0, GRAVITY)
    rate, angle = np.array([1.0, 0.0, 0.0]), np.array([np.nan, 0.0, np.pi / 2])
    flat = Mounting("flat", np.eye(3))
    pole = Table("pole", 0.0, 45 * DEGREE)

    def channel(kind: str, axis: list[float]) -> Channel:
        return Channel("c", kind, np.array([axis, axis, axis]), "V", 1.0, "g", 1.0)

    along = nominal_input(channel("gyro", [0, 0, 1]), pole, flat, site, rate, angle)
    np.testing.assert_allclose(along, [1 + EARTH, EARTH, EARTH], rtol=1e-12)
    across = nominal_input(channel("gyro", [0, 1, 0]), pole, flat, site, rate, angle)
    np.testing.assert_allclose(across, 0, atol=1e-18)
    # At angle 0 the table's y axis leans down from North by the colatitude.
    force = nominal_input(channel("accelerometer", [0, 1, 0]), pole, flat, site, rate, angle)
    np.testing.assert_allclose(force, [0, -GRAVITY * np.cos(45 * DEGREE), 0], atol=1e-15)
    force = nominal_input(channel("accelerometer", [1, 0, 0]), pole, flat, site, rate, angle)
    np.testing.assert_allclose(force, [0, 0, -GRAVITY * np.cos(45 * DEGREE)], atol=1e-15)
