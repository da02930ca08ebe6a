# pyright: reportMissingImports=false
"""Records of any value are named by run or row: temperatures, outputs and rates of rows, seats, axes, references.

Each campaign differs from a valid one by one entry.
"""

import json
import shutil
from pathlib import Path

import numpy as np
import polar_tumble
import pytest
from campaign_files import Files
from fresh_setups import write_campaign
from kinematics import about
from record_mistakes import changed, temperatures
from simulate import write_simulated

from imubayes.campaign import inspect_campaign
from imubayes.campaign.stream_checks import Finding

DATA = Path(__file__).parents[2] / "data"


def told(folder: Path) -> list[Finding]:
    return [each for each in inspect_campaign(folder).findings if each.name != "partial_turn"]


def fresh(folder: Path, bench: str, seed: int) -> Files:
    write_campaign(folder, bench, seed)
    return Files(folder)


def shipped(folder: Path, name: str) -> Files:
    shutil.copytree(DATA / name, folder)
    return Files(folder)


def in_row(files: Files, run: dict, column: str, row: int, value: float) -> None:
    """Write a value in a row, from 1."""

    def edit(columns: dict[str, list[str]]) -> None:
        columns[column][row - 1] = f"{value:.9g}"

    files.edit(run, edit)


def test_the_temperature_of_a_row_is_named(tmp_path: Path):
    files = fresh(tmp_path / "triad", "triad", 3)
    run = files.runs[1]
    true = temperatures(files, run)[4]
    others = np.concatenate([temperatures(files, each) for each in files.runs])
    in_row(files, run, "temperature_degC", 5, others[np.argmax(np.abs(others - true))])
    (found,) = told(files.folder)
    record = found.record
    assert record is not None
    assert (record.run, record.row, record.quantity) == (run["name"], 5, "temperature_degC")
    assert abs(record.agreeing[0] - true) < 4 * record.sd[0]


def test_an_output_that_is_many_times_as_large_as_all_others_is_named_by_its_row(tmp_path: Path):
    files = fresh(tmp_path / "triad", "triad", 3)
    in_row(files, files.runs[0], "ax", 6, 10 * 16384.0 * 3)
    (found,) = told(files.folder)
    assert "row 6 of run" in found.what
    assert "its output of ax changed by" in found.what


def test_an_impossible_rate_is_one_error_with_the_line_to_write(tmp_path: Path):
    files = fresh(tmp_path / "gyro", "gyro", 1)
    run = files.of("rate_table")[0]
    in_row(files, run, "table_rate_deg_s", 4, 4.5e7)
    (issue,) = inspect_campaign(files.folder).issues
    assert "faster than any table turns" in issue.what
    assert "write" in issue.remedy
    assert "row 4" in issue.remedy


@pytest.mark.slow  # 2 s
def test_one_angle_of_an_axis_that_carries_another_is_named_beside_rows_that_turn(tmp_path: Path):
    files = shipped(tmp_path / "table", "multi-axis-table")
    run = next(each for each in files.runs if each["name"] == "upright")
    in_row(files, run, "middle_angle_deg", 8, 189.0)
    (found,) = told(files.folder)
    record = found.record
    assert record is not None
    assert (record.row, record.quantity) == (8, "middle_angle_deg")
    assert abs(record.agreeing[0] - 180) < 0.05


def _optical(folder: Path) -> Path:
    """Write a polar tumble of a gyro that does not respond to g."""
    plan = polar_tumble.plan(3)
    values = {name: 0.0 if "_g_" in name or "drift" in name else value for name, value in plan.draw(3).items()}
    write_simulated(folder, plan, 3, values=values)
    return folder


def test_a_gyro_that_g_does_not_move_is_valid_about_the_polar_axis(tmp_path: Path):
    assert told(_optical(tmp_path / "polar")) == []


@pytest.mark.parametrize(
    ("plant", "named"),
    [
        ("columns", "'reference_x_deg_s', 'reference_y_deg_s' are exchanged"),
        pytest.param("outputs", "the outputs of runs", marks=pytest.mark.slow),  # 2 s
    ],
)
def test_what_is_exchanged_beside_a_reference_gyro_is_named(tmp_path: Path, plant: str, named: str):
    files = shipped(tmp_path / "reference", "reference-gyro")
    one, other = (each for each in files.runs if each["name"].startswith("x-up"))
    columns = ("reference_x_deg_s", "reference_y_deg_s")
    held: dict[str, list[str]] = {}

    def rename(cells: dict[str, list[str]]) -> None:
        cells[columns[0]], cells[columns[1]] = cells[columns[1]], cells[columns[0]]

    def take(cells: dict[str, list[str]]) -> None:
        before = {name: cells[name] for name in ("gx", "gy", "gz")}
        cells.update(held)
        held.update(before)

    if plant == "columns":
        files.edit(one, rename)
    else:
        for run in (one, other, one):
            files.edit(run, take)
    (issue,) = inspect_campaign(files.folder).issues
    assert named in issue.what


@pytest.mark.slow  # 2 s
def test_outputs_less_their_offsets_are_named(tmp_path: Path):
    files = shipped(tmp_path / "imu", "redundant-imu")
    for name in ("g1", "g2", "g3", "g4"):
        changed(files, files.runs[2], name, lambda values: values - 2500)
    (issue,) = inspect_campaign(files.folder).issues
    assert "rate-y-up-day1" in issue.what
    assert "changed by (2500.0, 2500.0, 2500.0, 2500.0) mV" in issue.what


def test_deviations_in_another_unit_are_named(tmp_path: Path):
    files = fresh(tmp_path / "triad", "triad", 3)
    for name in ("ax", "ay", "az"):
        changed(files, files.runs[1], f"{name}_sd", lambda sd: 1000 * sd)
    (found,) = told(files.folder)
    assert (found.name, found.run) == ("deviations_unlike", files.runs[1]["name"])
    assert "1000 times as large" in found.what


def test_rates_of_a_run_by_two_per_cent_are_named_without_a_model(tmp_path: Path):
    files = shipped(tmp_path / "imu", "redundant-imu")
    changed(files, files.runs[1], "table_rate_deg_s", lambda rate: 1.02 * rate)
    (found,) = told(files.folder)
    assert found.run == files.runs[1]["name"]
    assert "table_rate_deg_s times 0.9803" in found.what


@pytest.mark.slow  # 2 s
def test_any_orientation_of_a_mounting_is_found(tmp_path: Path):
    files = shipped(tmp_path / "imu", "redundant-imu")
    true = np.array(files.document["mounting"][1]["body_to_table"], dtype=float)
    files.document["mounting"][1]["body_to_table"] = (about(0, np.radians(20)) @ true).tolist()
    files.save()
    (issue,) = inspect_campaign(files.folder).issues
    written = json.loads(issue.remedy.split("body_to_table = ")[1].split(" for ")[0])
    assert np.allclose(written[2], true[2], atol=5e-3), issue.remedy


@pytest.mark.slow  # 2 s
def test_any_direction_of_an_input_axis_is_found(tmp_path: Path):
    files = shipped(tmp_path / "imu", "redundant-imu")
    files.document["channel"][0]["input_axis"] = [0.0, 0.816496477, 0.577350416]
    files.save()
    (issue,) = inspect_campaign(files.folder).issues
    assert "channel 'g1' responds along [0.81" in issue.what


@pytest.mark.slow  # 4 s
def test_a_latitude_that_is_near_the_stated_one_is_named_before_that_of_the_other_hemisphere(tmp_path: Path):
    files = shipped(tmp_path / "imu", "full-qualification")
    true = float(files.document["site"]["latitude_deg"])
    files.document["site"]["latitude_deg"] = true - 8
    files.save()
    (issue,) = inspect_campaign(files.folder).issues
    assert f"write latitude_deg = {true:.0f}" in issue.remedy
