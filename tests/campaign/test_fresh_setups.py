"""Times, units and files of fresh campaigns: a mistake is named with unit and run, and what is right is not doubted.

The campaigns are simulated in `fresh_setups`, and their shares over many seeds are those of `tests/study`.
"""

import shutil
from collections.abc import Callable
from datetime import timedelta
from pathlib import Path

import numpy as np
import pytest
from campaign_files import Files
from fresh_setups import KINDS, TIMES, write_campaign
from seeded_mistakes import says

from imubayes.campaign import inspect_campaign

CASES = Path(__file__).parents[3] / "shared" / "cases" / "inputs"
Change = Callable[[dict[str, list[str]]], None]
ZEROS = (0.0, pytest.param(90.0, marks=pytest.mark.slow), 143.7)


def said_of(folder: Path) -> dict[str, str]:
    """Return the findings of a campaign by name, with severity and text, the last of each."""
    return {each.name: str(each) for each in inspect_campaign(folder, judge_setup=False).findings}


@pytest.fixture(params=("triad", "gyro", "imu"))
def fresh(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    write_campaign(tmp_path / request.param, request.param, 3)
    return tmp_path / request.param


def times(factor: float, start: float = 0.0) -> Change:
    def change(columns: dict[str, list[str]]) -> None:
        columns["time_s"] = [f"{start + factor * float(cell):.15g}" for cell in columns["time_s"]]

    return change


def test_a_fresh_campaign_has_no_findings(fresh: Path):
    found = inspect_campaign(fresh)
    assert found.campaign is not None
    assert found.findings == ()


@pytest.mark.parametrize("unit", TIMES)
def test_the_unit_of_time_is_named(fresh: Path, unit: str):
    files = Files(fresh)
    for run in files.runs:
        files.edit(run, times(TIMES[unit]))
    found = said_of(fresh)
    assert set(found) == {"time_unit"}
    assert f"in {unit}s in runs" in found["time_unit"]
    assert all(f"'{run['name']}'" in found["time_unit"] for run in files.runs)


@pytest.mark.parametrize("unit", TIMES)
def test_the_run_of_another_unit_of_time_is_named(fresh: Path, unit: str):
    files = Files(fresh)
    files.edit(files.runs[1], times(TIMES[unit]))
    assert f"in {unit}s in run '{files.runs[1]['name']}'" in said_of(fresh)["time_unit"]


def test_long_rows_in_milliseconds_show_in_runs_that_overlap(fresh: Path):
    """Rows of ten seconds of a fast converter look like rows of three hours less a bit; the next run began before."""
    files = Files(fresh)

    def change(columns: dict[str, list[str]]) -> None:
        columns["samples"] = ["20000"] * len(columns["samples"])
        columns["time_s"] = [f"{9_500.0 * row:g}" for row in range(len(columns["samples"]))]

    for run in files.runs:
        files.edit(run, change)
    assert "milliseconds" in said_of(fresh)["time_unit"]
    for run in files.document["run"]:
        del run["start"]
    files.save()
    assert said_of(fresh) == {}


def test_a_soak_of_hours_is_no_unit(fresh: Path):
    """The temperature changes from row to row."""
    files = Files(fresh)

    def change(columns: dict[str, list[str]]) -> None:
        rows = len(columns["samples"])
        columns["time_s"] = [f"{14_400.0 * row:g}" for row in range(rows)]
        columns["temperature_degC"] = [f"{20 + 2 * row:g}" for row in range(rows)]

    for run in files.document["run"]:
        del run["start"]
    files.save()
    for run in files.runs:
        files.edit(run, change)
    assert said_of(fresh) == {}


def test_times_of_an_epoch_are_an_error(fresh: Path):
    files = Files(fresh)
    for run in files.runs:
        files.edit(run, times(1.0, start=1.78e9))
    found = said_of(fresh)
    assert set(found) == {"time_origin"}
    assert found["time_origin"].startswith("error: ")


@pytest.mark.parametrize(("share", "severity"), [(0.9, "error"), (0.2, "warning"), (0.0, "")])
def test_runs_that_overlap_are_named(fresh: Path, share: float, severity: str):
    files = Files(fresh)
    lasts: list[float] = []
    files.edit(files.runs[0], lambda columns: lasts.append(float(columns["time_s"][-1])))
    files.edit(files.runs[1], times(0.0))
    files.edit(files.runs[1], lambda columns: columns.update(
        time_s=[f"{value:.6g}" for value in np.linspace(1, lasts[0], len(columns["time_s"]))]
    ))  # fmt: skip
    first, second = files.document["run"][0], files.document["run"][1]
    second["start"] = first["start"] + timedelta(seconds=(1 - share) * lasts[0])
    files.save()
    found = said_of(fresh)
    assert set(found) == ({"runs_overlap"} if severity else set())
    assert not severity or found["runs_overlap"].startswith(f"{severity}: ")
    assert not severity or f"'{first['name']}' and '{second['name']}'" in found["runs_overlap"]


@pytest.mark.parametrize(("how", "share"), [("name", 1.0), ("copy", 1.0), ("rows", 1.0), ("rows", 0.6)])
def test_data_that_are_read_twice_are_an_error(fresh: Path, how: str, share: float):
    files = Files(fresh)
    first, second = files.runs[0], files.runs[1]
    if how == "name":
        files.document["run"][1]["file"] = first["file"]
        files.save()
    elif how == "copy":
        shutil.copy(fresh / first["file"], fresh / second["file"])
    else:
        copied: dict[str, list[str]] = {}
        files.edit(first, copied.update)

        def mix(columns: dict[str, list[str]]) -> None:
            rows = round(share * min(len(copied["samples"]), len(columns["samples"])))
            for name in set(columns) - {"time_s"}:
                columns[name][:rows] = copied[name][:rows]

        files.edit(second, mix)
    found = said_of(fresh)
    assert found["same_data"].startswith("error: ")
    assert f"'{first['name']}' and '{second['name']}'" in found["same_data"]


def test_readings_of_a_coarse_converter_may_repeat(fresh: Path):
    """Whole codes, of which noise moves a mean by less than one, are the same in every run of a seat."""
    files = Files(fresh)
    names = {str(channel["name"]) for channel in files.document["channel"]}
    for channel in files.document["channel"]:
        channel["noise"] = 0.2
    files.save()
    first, second = (
        run
        for run in files.runs
        if run["mounting"] == files.runs[0]["mounting"] and run["procedure"] == files.runs[0]["procedure"]
    )
    shutil.copy(fresh / first["file"], fresh / second["file"])

    def change(columns: dict[str, list[str]]) -> None:
        for name in names:
            columns[name] = [f"{float(cell):.0f}" for cell in columns[name]]
            columns.pop(f"{name}_sd")
        columns["samples"] = ["1"] * len(columns["samples"])

    for run in (first, second):
        files.edit(run, change)
    assert "same_data" not in said_of(fresh)


@pytest.mark.parametrize("seed", range(4))
def test_the_unit_of_temperature_is_named(fresh: Path, seed: int):
    planted = KINDS["temperature_unit"](Files(fresh), np.random.default_rng(seed))
    assert planted is not None
    text = " ".join(map(str, inspect_campaign(fresh).findings))
    assert says(planted, text)


@pytest.mark.parametrize("zero", ZEROS)
@pytest.mark.parametrize(("unit", "factor"), [("rad", np.pi / 180), ("gon", 1 / 0.9), ("turns", 1 / 360)])
def test_the_unit_of_angles_is_named_whatever_the_zero_of_the_table(
    tmp_path: Path, zero: float, unit: str, factor: float
):
    files = _with_zero(tmp_path / "triad", zero)
    for run in files.runs:
        files.edit(run, lambda columns: columns.update(
            table_angle_deg=[f"{float(cell) * factor:.9g}" for cell in columns["table_angle_deg"]]
        ))  # fmt: skip
    found = inspect_campaign(tmp_path / "triad")
    assert all("table_angle_deg" in issue.where or "table_angle_deg" in issue.what for issue in found.issues)
    assert found.issues
    assert unit in " ".join(issue.what + issue.remedy for issue in found.issues)


@pytest.mark.parametrize("zero", ZEROS)
@pytest.mark.parametrize("with_zero", [False, True])
def test_a_scale_that_counts_backwards_is_named_whatever_its_zero(tmp_path: Path, zero: float, with_zero: bool):
    """Also if its zero was read on the scale as it is: both signs are to be reversed then."""
    files = _with_zero(tmp_path / "triad", zero)
    for run in files.runs:
        files.edit(run, lambda columns: columns.update(
            table_angle_deg=[f"{-float(cell):g}" for cell in columns["table_angle_deg"]]
        ))  # fmt: skip
    if with_zero:
        files.document["table"][0]["zero_angle_deg"] = -zero
        files.save()
    (issue,) = inspect_campaign(tmp_path / "triad").issues
    assert "turns against the stated sense" in issue.what
    assert ("zero_angle_deg" in issue.remedy.split("(or")[0]) == (with_zero and zero > 0)


def _with_zero(folder: Path, zero: float) -> Files:
    """Write a campaign of a triad whose table reads `zero` at its zero."""
    write_campaign(folder, "triad", 0)
    files = Files(folder)
    by = zero - float(files.document["table"][0]["zero_angle_deg"])
    files.document["table"][0]["zero_angle_deg"] = zero
    files.save()
    for run in files.runs:
        files.edit(run, lambda columns: columns.update(
            table_angle_deg=[f"{float(cell) + by:g}" for cell in columns["table_angle_deg"]]
        ))  # fmt: skip
    return files


@pytest.mark.skipif(not CASES.is_dir(), reason="the cases are not here")
@pytest.mark.parametrize(
    ("case", "name", "named"),
    [
        ("time-ms", "time_unit", "milliseconds"), ("same-file-twice", "same_data", "'B1' and 'B2'"),
        ("angle-rad", "angle_in_radians", "table_angle_deg"),
    ],
)  # fmt: skip
def test_cases_that_passed(case: str, name: str, named: str):
    assert named in said_of(CASES / case)[name]
