"""A record that turns about the vertical is no record at rest, whatever gravity says; drift, a knock and a step are."""

from pathlib import Path

import numpy as np
import pytest

from imubayes.campaign import inspect_campaign
from imubayes.foundations.errors import InputError
from imubayes_recordings.convert import read_recordings

RATE_HZ, GRAVITY = 50, 9.81


def table_log(column: str, factor: float = 1.0, levels: tuple[float, ...] = (0, 50, 100, 0, -50, -100, 0)) -> str:
    """A seat on a vertical axis: levels of 6 s with ramps of 1 s; `factor` is the unit of the column per deg/s."""
    random, rate, before = np.random.default_rng(5), [], 0.0
    for level in levels:
        rate += [*np.linspace(before, level, RATE_HZ, endpoint=False), *np.full(6 * RATE_HZ, level)]
        before = level
    turning = np.array(rate, dtype=float)
    noise, bias = random.normal(0, 0.08, (len(turning), 3)), np.array([0.5, -0.3, 0.2])
    gyros = np.outer(turning, [0.01, -0.02, 1.008]) + bias + noise
    force = np.array([0.2, -0.1, GRAVITY]) + random.normal(0, 0.02, (len(turning), 3))
    return _text(column, turning * factor, gyros, force)


def _text(column: str, extra: np.ndarray, gyros: np.ndarray, force: np.ndarray) -> str:
    rows = np.c_[np.arange(len(gyros)) / RATE_HZ, extra, gyros, force]
    names = ("time_s", column, "gx_dps", "gy_dps", "gz_dps", "ax", "ay", "az")
    return "\n".join([",".join(names), *(",".join(f"{value:.6g}" for value in row) for row in rows)]) + "\n"


def at_rest(drift: float = 0.0, step: float = 0.0, knock: float = 0.0, seconds: int = 600) -> str:
    random, count = np.random.default_rng(6), seconds * RATE_HZ
    time = np.arange(count) / RATE_HZ
    gyros = random.normal(0, 0.1, (count, 3)) + np.outer(1 - np.exp(-time / 200), [0.3, -0.2, drift])
    gyros[count // 2 :, 2] += step
    gyros[count // 3 : count // 3 + 10] += knock
    force = np.array([0.2, -0.1, GRAVITY]) + random.normal(0, 0.02, (count, 3))
    return _text("status", random.integers(0, 3, count).astype(float), gyros, force)


def read(folder: Path, text: str, **options):
    (folder / "log.csv").write_text(text)
    return read_recordings([folder / "log.csv"], gravity_m_s2=GRAVITY, latitude_deg=48, **options)


@pytest.mark.parametrize(
    ("column", "factor"), [("table_rate", 1.0), ("rate_cmd_dps", 1.0), ("ref_rate", np.pi / 180), ("tacho", 1 / 6)]
)
def test_a_column_that_a_gyro_follows_is_named_and_read_where_it_is_stated(tmp_path: Path, column, factor) -> None:
    with pytest.raises(InputError) as refused:
        read(tmp_path, table_log(column, factor))
    [issue] = refused.value.issues
    assert "the gyros turn by up to 101" in issue.what
    assert (
        f"column '{column}' is not read, and gz is proportional to it by a factor of {1.008 / factor:.4g}"[:-1]
        in issue.what
    )
    assert f"--column table_rate_deg_s='{column}'" in issue.remedy
    if factor == 1:
        stated = read(tmp_path, table_log(column), columns={"table_rate_deg_s": column})
        assert stated.campaign.document["run"][0]["procedure"] == "rate_table"


def test_without_such_a_column_the_turns_are_asked_for(tmp_path: Path) -> None:
    text = "\n".join(
        ",".join(cell for place, cell in enumerate(line.split(",")) if place != 1)
        for line in table_log("x").splitlines()
    )
    with pytest.raises(InputError, match="--turn-deg 360") as refused:
        read(tmp_path, text)
    assert "is not read" not in refused.value.issues[0].what


def checked(folder: Path, text: str) -> set[str]:
    read(folder, at_rest(seconds=60), procedure="static_record").write(folder / "campaign")
    lines = [line.split(",") for line in text.splitlines()]
    table = [",".join(cell for name, cell in zip(lines[0], line, strict=True) if name != "status") for line in lines]
    [file] = (folder / "campaign" / "runs").iterdir()
    file.write_text("\n".join([table[0].replace("_dps", ""), *table[1:]]) + "\n")
    inspection = inspect_campaign(folder / "campaign", judge_setup=False)
    return {finding.name for finding in inspection.findings}


def test_a_constant_rate_that_is_no_bias_is_a_turn(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="the gyros turn by up to 101"):
        read(tmp_path, table_log("status", 0.0, (100,)).replace("time_s", "t"))


def test_a_campaign_that_calls_it_a_static_record_is_refused(tmp_path: Path) -> None:
    assert "turns_at_rest" in checked(tmp_path, table_log("status"))


@pytest.mark.parametrize("fault", [{}, {"drift": 6.0}, {"step": 0.4}, {"knock": 30.0}], ids=str)
def test_drift_a_step_and_a_knock_are_no_turns(tmp_path: Path, fault) -> None:
    assert read(tmp_path, at_rest(**fault)).campaign.document["run"][0]["procedure"] == "static_record"
    assert "turns_at_rest" not in checked(tmp_path, at_rest(**fault))
