"""A wrong rate of one run and a mistyped value of one row are named before any fit, with the value that would agree."""

import re
from pathlib import Path

import numpy as np
import pytest
from campaign_files import Files
from fresh_setups import write_campaign
from valid_campaigns import KINDS, valid_campaign

from imubayes.campaign import Inspection, inspect_campaign
from imubayes.campaign.setup_gate import wrong_rows as rows
from imubayes.campaign.setup_gate.equipment_mistakes import Scope, TimeShift

RATES = (0, 10, -10, 20, -20, 50, -50, 100, -100, 150, -150, 200, -200, 0)
HEADS = [seed for seed in range(9000, 9040) if KINDS[seed % len(KINDS)] == "head"]
_HEADER = """format = 1
name = "one gyro"
[site]
latitude_deg = 48.0
height_m = 100.0
[unit]
serial = "G"
[[channel]]
name = "g"
kind = "gyro"
input_axis = [0.0, 0.0, 1.0]
output_unit = "mV"
scale = 25.0
per = "deg/s"
[[table]]
name = "rate"
azimuth_deg = 0.0
elevation_deg = 90.0
"""
_RUN = """[[mounting]]
name = "{name}"
body_to_table = {matrix}
uncertainty_arcmin = 10.0
[[run]]
name = "{name}"
procedure = "rate_table"
file = "{name}.csv"
table = "rate"
mounting = "{name}"
"""


def two_runs(folder: Path, factors: dict[str, float]) -> Inspection:
    """Inspect a gyro on a vertical table, upright and upside down, its recorded rates wrong by a factor in each run."""
    folder.mkdir(parents=True)
    random, document = np.random.default_rng(7), _HEADER
    earth = np.degrees(7.292115e-5) * np.sin(np.radians(48.0))
    for sense, (name, factor) in zip((1.0, -1.0), factors.items(), strict=True):
        matrix = [[1.0, 0.0, 0.0], [0.0, sense, 0.0], [0.0, 0.0, sense]]
        document += _RUN.format(name=name, matrix=matrix)
        lines = ["time_s,table_rate_deg_s,samples,g,g_sd"]
        for place, rate in enumerate(RATES):
            value = 25.0 * 1.0007 * sense * (rate + earth) + 0.4 + random.normal(0, 0.2) / np.sqrt(800)
            lines.append(f"{20 + 40 * place},{rate * factor:.9g},800,{value:.6f},0.2")
        (folder / f"{name}.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    (folder / "campaign.toml").write_text(document, encoding="utf-8")
    return inspect_campaign(folder)


@pytest.mark.parametrize(("run", "factor"), [("up", 1.01), ("down", 0.98), ("up", 1.05), ("down", 1.1)])
def test_a_rate_wrong_by_a_factor_in_one_run_is_named_with_the_factor(tmp_path: Path, run: str, factor: float) -> None:
    found = two_runs(tmp_path / "campaign", {"up": 1.0, "down": 1.0} | {run: factor})
    assert {finding.name for finding in found.findings} == {"table_rate"}
    told = re.search(
        rf"run '{run}' would agree with the other runs given \S+ times ([\d.]+) ± ", str(found.findings[0])
    )
    assert told, str(found.findings[0])
    assert float(told[1]) == pytest.approx(1 / factor, abs=2e-4)


def test_of_two_runs_that_differ_by_what_a_scale_factor_may_be_both_are_named(tmp_path: Path) -> None:
    (finding,) = two_runs(tmp_path / "campaign", {"up": 1.01, "down": 1.0}).findings
    assert "cannot determine" in finding.what
    assert "'up' would agree with the other runs given table_rate_deg_s times 0.990" in finding.what
    assert (
        "'down' would agree with the other runs given table_rate_deg_s times 1.00" in finding.what
        or "times 1.01" in finding.what
    )


def test_right_rates_and_the_same_factor_in_both_runs_pass(tmp_path: Path) -> None:
    assert not two_runs(tmp_path / "right", {"up": 1.0, "down": 1.0}).findings
    assert not two_runs(tmp_path / "same", {"up": 1.002, "down": 1.002}).findings


def test_a_shift_by_no_row_is_no_shift() -> None:
    scope = Scope("run", "up", (0,))
    assert not any(TimeShift(scope, whole).possible(size) for whole in (True, False) for size in (0.0, -0.004, 0.2))
    assert all(TimeShift(scope, whole).possible(size) for whole in (True, False) for size in (-0.5, 1.0))


def mistyped(folder: Path, seed: int) -> tuple[str, int, float] | None:
    """Draw a valid campaign and change one angle of a dividing head by degrees; return run, row from 1, and angle."""
    valid_campaign(folder, seed)
    files, random = Files(folder), np.random.default_rng([seed, 5])
    runs = [run for run in files.of("dividing_head") if files.has(run, "table_angle_deg")]
    run, changed = runs[random.integers(len(runs))], []

    def change(columns: dict[str, list[str]]) -> None:
        cells = columns["table_angle_deg"]
        row = int(random.integers(len(cells)))
        changed.extend([row + 1, float(cells[row])])
        cells[row] = repr(float(cells[row]) + float(random.choice([-1, 1]) * random.uniform(2, 20)))

    files.edit(run, change)
    return str(run["name"]), *changed


@pytest.mark.parametrize("seed", HEADS[:3])
def test_an_angle_mistyped_by_degrees_is_named_by_run_and_row(tmp_path: Path, seed: int) -> None:
    run, row, angle = mistyped(tmp_path / "campaign", seed)
    found = [each for each in inspect_campaign(tmp_path / "campaign").findings if each.name == "row_disagrees"]
    assert [each.run for each in found] == [run]
    record = found[0].record
    assert record is not None
    assert (record.form, record.quantity, record.row) == ("offset", "table_angle_deg", row)
    assert abs((record.agreeing[0] - angle + 180) % 360 - 180) < 0.3


@pytest.mark.parametrize(("bench", "column"), [("triad", "table_angle_deg"), ("gyro", "table_rate_deg_s")])
def test_two_rows_that_are_exchanged_are_named(tmp_path: Path, bench: str, column: str) -> None:
    write_campaign(tmp_path / bench, bench, 5)
    files = Files(tmp_path / bench)
    run = next(run for run in files.runs if files.has(run, column))
    first, second = 5, 8

    def exchange(columns: dict[str, list[str]]) -> None:
        cells = columns[column]
        cells[first], cells[second] = cells[second], cells[first]

    files.edit(run, exchange)
    found = [each for each in inspect_campaign(tmp_path / bench).findings if each.name == "row_disagrees"]
    told = [int(re.search(r"row (\d+) of run", each.what)[1]) for each in found]  # type: ignore[index]
    assert sorted(told) == [first + 1, second + 1]
    assert {each.run for each in found} == {run["name"]}


def test_no_row_of_a_valid_campaign_is_named(tmp_path: Path) -> None:
    for seed in HEADS[:2]:
        valid_campaign(tmp_path / str(seed), seed)
        assert "row_disagrees" not in {each.name for each in inspect_campaign(tmp_path / str(seed)).findings}


@pytest.mark.slow  # the gate then tries a thousand pairs of mistakes
def test_without_the_derivative_no_row_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The planted fault of these tests."""
    mistyped(tmp_path / "campaign", HEADS[0])
    monkeypatch.setattr(rows, "_columns", lambda view, row, wrong: iter(()))
    assert "row_disagrees" not in {each.name for each in inspect_campaign(tmp_path / "campaign").findings}
