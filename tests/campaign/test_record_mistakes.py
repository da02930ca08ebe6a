"""What was recorded wrongly in a run, a row or two runs is named with its value; no name is forced on another value."""

from pathlib import Path

import numpy as np
import pytest
from campaign_files import Files
from fresh_setups import write_campaign
from record_mistakes import RECORD_MISTAKES, changed

from imubayes.campaign import inspect_campaign

CASES = Path(__file__).parents[3] / "shared" / "cases" / "inputs"


def all_said(folder: Path) -> str:
    found = inspect_campaign(folder)
    return " ".join(map(str, (*found.issues, *found.findings)))


@pytest.mark.parametrize(
    ("kind", "bench", "seed"),
    [
        ("heater_off", "imu", 5), ("temperatures_exchanged", "imu", 5), ("other_unit", "imu", 5),
        ("rate_without_sign", "gyro", 1), ("rates_missing", "imu", 2), ("sign_in_one_row", "triad", 3),
    ],
)  # fmt: skip
def test_a_wrong_record_is_named(kind: str, bench: str, seed: int, tmp_path: Path):
    write_campaign(tmp_path / bench, bench, seed)
    named = RECORD_MISTAKES[kind](Files(tmp_path / bench), np.random.default_rng([seed, 5]))
    assert named is not None
    text = all_said(tmp_path / bench)
    assert all(each in text for each in named), (named, text)
    assert "Fahrenheit" not in text


def test_degrees_fahrenheit_are_named_where_they_do_as_well_as_any_value(tmp_path: Path):
    write_campaign(tmp_path / "imu", "imu", 5)
    files = Files(tmp_path / "imu")
    changed(files, files.runs[0], "temperature_degC", lambda celsius: 1.8 * celsius + 32)
    text = all_said(tmp_path / "imu")
    assert "Fahrenheit" in text
    assert "mean temperature of" not in text


@pytest.mark.skipif(not CASES.is_dir(), reason="the cases are not here")
@pytest.mark.parametrize(
    ("case", "named"),
    [
        ("temperatures-exchanged", "temperatures of runs 'x-up_cold' and 'x-up_room' are exchanged"),
        ("unit2-file", "run 'x-up_room' is of another unit"),
        ("rate-without-sign", "rates in run 'x-up_room' are recorded without their sign"),
    ],
)
def test_cases_that_were_named_wrongly(case: str, named: str):
    found = inspect_campaign(CASES / case)
    (told,) = [each for each in found.findings if each.name != "unused_columns"]
    assert named in told.what
