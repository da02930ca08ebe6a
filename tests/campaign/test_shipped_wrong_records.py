"""Wrong records planted into copies of shipped campaigns: axes of a table, a reference gyro, temperatures, counts."""

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from campaign_files import Files
from record_mistakes import changed

from imubayes.campaign import inspect_campaign

DATA = Path(__file__).parents[2] / "data"
Column = Callable[[np.ndarray], np.ndarray]


def found_in(folder: Path, name: str, runs: tuple[str, ...], column: str, change: Column) -> str:
    """Return all that is said of a shipped campaign with a column of some runs changed; of all runs for none."""
    shutil.copytree(DATA / name, folder)
    files = Files(folder)
    for run in files.runs:
        if run["name"] in runs or not runs:
            changed(files, run, column, change)
    found = inspect_campaign(folder)
    assert len(found.issues or found.findings) == 1
    return " ".join(map(str, found.issues or found.findings))


@pytest.mark.parametrize(
    ("name", "run", "column", "change", "said"),
    [
        (
            "multi-axis-table", "held", "middle_angle_deg", lambda x: np.where(np.arange(20) == 12, x + 90, x),
            "row 13 of run 'held' would agree with the other rows given middle_angle_deg = 90|"
            "row 13 of run 'held' would agree with the other rows given middle_angle_deg = 89.99",
        ),
        (
            "trihedral-imu", "head-z-up-minus10C", "temperature_degC", np.abs,
            "run 'head-z-up-minus10C' would agree with the other runs given temperature_degC "
            "about -11.180 °C on average (recorded: 11.180), as if with the opposite sign",
        ),
        (
            "trihedral-imu", "rate-x-up-25C", "samples", lambda count: 100 * count,
            "run 'rate-x-up-25C' would agree with the other runs given about 10",
        ),
    ],
)  # fmt: skip
def test_one_block_names_what_is_wrong_in_a_run(
    name: str, run: str, column: str, change: Column, said: str, tmp_path: Path
) -> None:
    text = found_in(tmp_path / "campaign", name, (run,), column, change)
    assert any(each in text for each in said.split("|")), text


def test_a_reference_gyro_and_its_gyro_are_wrong_alike(tmp_path: Path) -> None:
    text = found_in(tmp_path / "campaign", "reference-gyro", (), "reference_z_deg_s", np.negative)
    assert "column 'reference_z_deg_s' is reversed in sign in all runs, or channel 'gz' is reversed in sign" in text


def test_a_factor_of_a_reference_gyro_is_that_of_its_gyro(tmp_path: Path) -> None:
    """Its scale factor in one run and that of the gyro beside it do the same."""
    text = found_in(tmp_path / "campaign", "reference-gyro", ("z-up-reverse",), "reference_z_deg_s", lambda x: 1.05 * x)
    assert "given reference_z_deg_s times 0.9523" in text
    assert "given its output of gz times 1.049" in text


@pytest.mark.slow
@pytest.mark.parametrize(
    ("runs", "change", "said"),
    [
        ((), np.negative, "column 'middle_angle_deg' has the opposite sign in all runs on table 'three-axis'"),
        (
            ("tumble",),
            lambda angle: angle + 90,
            "zero of the angle of the middle axis is off by +90 deg in run 'tumble'",
        ),
    ],
)
def test_the_middle_axis_of_a_table(runs: tuple[str, ...], change: Column, said: str, tmp_path: Path) -> None:
    assert said in found_in(tmp_path / "campaign", "multi-axis-table", runs, "middle_angle_deg", change)
