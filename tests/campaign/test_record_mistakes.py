"""A wrong record of a run, a row or two runs is named with its value; no name is forced on another value."""

from pathlib import Path

import numpy as np
import pytest
from applied_remedies import apply_remedy
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
        ("output_off", "triad", 3), ("output_stuck", "triad", 3), ("output_copied", "triad", 3),
        ("rate_times", "gyro", 1),
        ("decimal_of_a_rate", "gyro", 2),
        ("rates_in_reverse", "gyro", 3), ("rates_of_five_rows", "gyro", 3), ("all_of_a_kind_in_a_run", "imu", 3),
        ("column_in_volt", "gyro", 3), ("sign_about_an_offset", "gyro", 3), ("offset_not_stated", "gyro", 3),
        ("kinds_exchanged", "imu", 3),
    ],
)  # fmt: skip
def test_a_wrong_record_is_named(kind: str, bench: str, seed: int, tmp_path: Path):
    write_campaign(tmp_path / bench, bench, seed)
    named = RECORD_MISTAKES[kind](Files(tmp_path / bench), np.random.default_rng([seed, 5]))
    assert named is not None
    text = all_said(tmp_path / bench)
    assert all(each in text for each in named), (named, text)
    assert "Fahrenheit" not in text


@pytest.mark.parametrize(
    ("kind", "bench", "seed"),
    [
        ("rates_in_reverse", "gyro", 4), ("column_in_volt", "gyro", 4), ("sign_about_an_offset", "gyro", 4),
        ("offset_not_stated", "gyro", 4), ("decimal_of_a_rate", "gyro", 4), ("rate_times", "gyro", 4),
        ("output_off", "triad", 4), ("sign_in_one_row", "triad", 4), ("scale_ten_times", "triad", 4),
    ],
)  # fmt: skip
def test_the_line_that_is_asked_for_lets_the_campaign_agree(kind: str, bench: str, seed: int, tmp_path: Path):
    write_campaign(tmp_path / bench, bench, seed)
    RECORD_MISTAKES[kind](Files(tmp_path / bench), np.random.default_rng([seed, 5]))
    found = inspect_campaign(tmp_path / bench)
    remedies = [each.remedy for each in (found.issues or found.findings) if "turn longer" not in each.remedy]
    assert remedies
    for remedy in remedies:
        assert apply_remedy(Files(tmp_path / bench), remedy), remedy
    assert all_said(tmp_path / bench) == ""


def test_degrees_fahrenheit_are_named_where_they_do_as_well_as_any_value(tmp_path: Path):
    write_campaign(tmp_path / "imu", "imu", 5)
    files = Files(tmp_path / "imu")
    changed(files, files.runs[0], "temperature_degC", lambda celsius: 1.8 * celsius + 32)
    text = all_said(tmp_path / "imu")
    assert "Fahrenheit" in text


@pytest.mark.skipif(not CASES.is_dir(), reason="the cases are not here")
@pytest.mark.parametrize(
    ("case", "named"),
    [
        (
            "temperatures-exchanged",
            "given temperature_degC exchanged with that of run 'x-up_room'",
        ),
        ("unit2-file", "run 'x-up_room' would agree with the other runs given errors of its own in all channels"),
        ("rate-without-sign", "rates in run 'x-up_room' are recorded without their sign"),
    ],
)
def test_cases_that_were_named_wrongly(case: str, named: str):
    found = inspect_campaign(CASES / case)
    (told,) = [each for each in found.findings if each.name != "unused_columns"]
    assert named in told.what


def _edited(folder: Path, bench: str, seed: int, **scale: float) -> Files:
    write_campaign(folder, bench, seed)
    files = Files(folder)
    for channel in files.document["channel"]:
        channel["scale"] = float(channel["scale"]) * scale.get(str(channel["name"]), 1.0)
    files.save()
    return files


@pytest.mark.parametrize("wrong", [("ay",), ("ax", "ay", "az")])
def test_a_decimal_place_is_one_block_and_no_unit(tmp_path: Path, wrong: tuple[str, ...]):
    _edited(tmp_path / "triad", "triad", 3, **dict.fromkeys(wrong, 0.1))
    (issue,) = inspect_campaign(tmp_path / "triad").issues
    assert "m/s²" not in issue.what
    assert all(f"scale = 16384 for '{name}'" in issue.remedy for name in wrong)


def test_sums_in_the_place_of_means_are_named_in_their_run(tmp_path: Path):
    files = _edited(tmp_path / "triad", "triad", 3)
    run = files.runs[1]
    for name in ("ax", "ay", "az"):
        changed(files, run, name, lambda mean: 600 * mean)
    (issue,) = inspect_campaign(tmp_path / "triad").issues
    assert f"600 times too large in run '{run['name']}' (sums instead of means)" in issue.what


def test_two_channels_along_one_axis_are_named_with_the_axis_of_one(tmp_path: Path):
    files = _edited(tmp_path / "triad", "triad", 3)
    files.document["channel"][1]["input_axis"] = [1.0, 0.0, 0.0]
    files.document["channel"][1]["output_axis"] = [0.0, 0.0, 1.0]
    files.save()
    (issue,) = inspect_campaign(tmp_path / "triad").issues
    assert "channel 'ay' responds along [0.0, 1.0, 0.0]" in issue.what


def test_standard_errors_are_told_from_deviations(tmp_path: Path):
    files = _edited(tmp_path / "triad", "triad", 3)
    for run in files.runs:
        for name in ("ax", "ay", "az"):
            changed(files, run, f"{name}_sd", lambda sd: sd / 600**0.5)
    (told,) = inspect_campaign(tmp_path / "triad").findings
    assert told.name == "standard_errors"
    assert "√samples, 24.5" in told.what


def test_samples_a_hundred_times_too_many_are_named_with_the_run(tmp_path: Path):
    files = _edited(tmp_path / "imu", "imu", 2)
    run = next(each for each in files.runs if each["procedure"] == "rate_table")
    changed(files, run, "samples", lambda count: 100 * count)
    (told,) = inspect_campaign(tmp_path / "imu").findings
    assert (told.name, told.run) == ("samples_unlike", run["name"])
    assert "100 times too many" in told.what


def test_deviations_without_the_number_of_samples_are_told(tmp_path: Path):
    files = _edited(tmp_path / "triad", "triad", 3)
    for run in files.runs:
        files.edit(run, lambda columns: columns.__delitem__("samples"))
    told = inspect_campaign(tmp_path / "triad", judge_setup=False).findings
    assert {each.run for each in told if each.name == "samples_missing"} == {run["name"] for run in files.runs}


def test_a_date_in_the_future_is_told(tmp_path: Path):
    files = _edited(tmp_path / "triad", "triad", 3)
    files.document["run"][-1]["start"] = files.document["run"][-1]["start"].replace(year=2962)
    files.save()
    (told,) = inspect_campaign(tmp_path / "triad").findings
    assert (told.name, told.run) == ("start_in_future", files.runs[-1]["name"])
