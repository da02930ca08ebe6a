"""A static record: rows over blocks, gaps, and the Earth rate as a check of the gyros."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import polars as pl
import pytest
import static_record as generator
from kinematics import rotation

from imubayes.campaign import inspect_campaign, load_campaign
from imubayes.foundations.campaign_data import Campaign
from imubayes.procedures import classical
from imubayes.procedures.textbook import Estimate, Undetermined

SHIPPED = Path(__file__).parents[2] / "data" / "static-record"
HEAD = """\
format = 1
name = "rest"

[site]
latitude_deg = 60.0

"""
CHANNEL = """\
[[channel]]
name = "{name}"
kind = "{kind}"
input_axis = {axis}
output_unit = "{per}"
scale = 1.0
per = "{per}"

"""
RUN = """\
[[run]]
name = "rest"
procedure = "static_record"
file = "rest.{suffix}"
"""
OMEGA = 15.041067 * np.array([0.0, 0.5, np.sqrt(0.75)])  # deg/h at 60° in east, north, up
AXES = {"x": [1, 0, 0], "y": [0, 1, 0], "z": [0, 0, 1]}


def campaign(
    folder: Path, columns: dict[str, np.ndarray], axes: dict[str, list[float]], suffix: str = "csv"
) -> Campaign:
    names = [name for name in columns if name in axes]
    text = HEAD + "".join(
        CHANNEL.format(name=n, kind="gyro" if n[0] == "g" else "accelerometer", axis=axes[n],
                       per="deg/h" if n[0] == "g" else "g")
        for n in names
    ) + RUN.format(suffix=suffix)  # fmt: skip
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "campaign.toml").write_text(text)
    frame = pl.DataFrame(columns)
    frame.write_csv(folder / "rest.csv") if suffix == "csv" else frame.write_parquet(folder / "rest.parquet")
    return load_campaign(folder)


def at_rest(
    folder: Path, attitude: np.ndarray, gyros: str = "xyz", bias: Sequence[float] = (0.0, 0.0, 0.0), force: bool = True
) -> dict[str, Estimate | Undetermined]:
    """Return the classical results of a unit with a known attitude (body → local level) that the file does not say."""
    random, seconds = np.random.default_rng(1), np.arange(7200.0)
    rate, up = attitude.T @ OMEGA + np.array(bias), attitude.T @ np.array([0.0, 0.0, 1.0])
    columns = {"time_s": seconds}
    columns |= {f"g{k}": rate["xyz".index(k)] + 0.5 * random.normal(size=7200) for k in gyros}
    columns |= {f"a{k}": up["xyz".index(k)] + 1e-5 * random.normal(size=7200) for k in "xyz" if force}
    axes = {f"{kind}{k}": axis for kind in "ga" for k, axis in AXES.items()}
    results = classical(campaign(folder, columns, axes))
    return {r.name.partition("[")[0] if isinstance(r, Estimate) else "undetermined": r for r in results}


TILTED = rotation(np.array([0.2, -0.1, -np.radians(40.0)]))


def value(found: dict, name: str) -> Estimate:
    assert isinstance(found[name], Estimate)
    return found[name]


def test_the_shipped_record_is_a_run_of_blocks():
    (run,) = load_campaign(SHIPPED).runs
    assert 120 <= run.rows <= 129
    assert run.samples.sum() == 14_400
    assert np.ptp(run.samples[:-1]) <= 2
    assert np.isfinite(run.observed).all()
    assert any("blocks of" in note for note in run.notes)


def test_the_shipped_record_is_what_the_generator_writes(tmp_path: Path):
    generator.generate(tmp_path, generator.SEED)
    assert (tmp_path / "campaign.toml").read_text() == (SHIPPED / "campaign.toml").read_text()
    ours, theirs = (pl.read_parquet(folder / "runs" / "night.parquet") for folder in (tmp_path, SHIPPED))
    np.testing.assert_allclose(ours.to_numpy(), theirs.to_numpy(), rtol=1e-6)


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_no_block_spans_a_gap(tmp_path: Path, suffix: str):
    time = np.concatenate([np.arange(0.0, 1000.0, 0.5), np.arange(5000.0, 6000.0, 0.5)])
    output = np.where(time < 3000, 1.0, 2.0) + 1e-3 * np.random.default_rng(1).normal(size=len(time))
    output[100] = np.nan
    columns = {"time_s": time, "gx": output if suffix == "parquet" else pl.Series(output).fill_nan(None)}
    found = campaign(tmp_path, columns, {"gx": [1, 0, 0]}, suffix) if suffix == "csv" else None
    if found is None:
        columns["gx"] = pl.Series(output).fill_nan(None)
        found = campaign(tmp_path, columns, {"gx": [1, 0, 0]}, suffix)
    (run,) = found.runs
    # A mean across the gap would lie between the two levels.
    assert np.all(np.minimum(np.abs(run.observed - 1.0), np.abs(run.observed - 2.0)) < 0.01)
    assert run.samples.sum() == len(time)


def test_a_column_of_time_is_needed(tmp_path: Path):
    campaign(tmp_path, {"time_s": np.arange(300.0), "gx": np.random.default_rng(1).normal(size=300)}, {"gx": [1, 0, 0]})
    table = tmp_path / "rest.csv"
    table.write_text(table.read_text().replace("time_s", "power_on_s", 1))
    (issue,) = inspect_campaign(tmp_path).issues
    assert "time_s" in issue.what


def test_a_triad_measures_the_earth_rate_in_any_attitude(tmp_path: Path):
    found = at_rest(tmp_path, TILTED)
    for name, truth in (("norm", 15.041067), ("level", 15.041067 / 2), ("vertical", 15.041067 * np.sqrt(0.75))):
        estimate = value(found, f"earth_rate.{name}")
        assert 0 < estimate.sd < 0.02
        assert abs(estimate.value - truth) < 4 * estimate.sd
    # The heading of body x: east component and north component of its first column.
    heading = value(found, "heading_of_x")
    assert abs(heading.value - np.degrees(np.arctan2(TILTED[0, 0], TILTED[1, 0]))) < 4 * heading.sd
    assert isinstance(found["undetermined"], Undetermined)
    assert "7.62 deg" in found["undetermined"].sentence


def test_a_bias_along_the_vertical_shows_in_the_vertical_part_alone(tmp_path: Path):
    found = at_rest(tmp_path, TILTED, bias=TILTED.T @ np.array([0.0, 0.0, 2.0]))
    vertical, level = value(found, "earth_rate.vertical"), value(found, "earth_rate.level")
    assert vertical.value - 15.041067 * np.sqrt(0.75) == pytest.approx(2.0, abs=0.05)
    assert "+2" in vertical.decision
    assert level.value == pytest.approx(15.041067 / 2, abs=0.05)


def test_a_bias_toward_east_turns_the_heading_and_nothing_else(tmp_path: Path):
    clean = value(at_rest(tmp_path / "a", TILTED), "heading_of_x")
    found = at_rest(tmp_path / "b", TILTED, bias=TILTED.T @ np.array([0.2, 0.0, 0.0]))
    assert value(found, "heading_of_x").value - clean.value == pytest.approx(-0.2 * 7.62, abs=0.05)
    assert value(found, "earth_rate.vertical").value == pytest.approx(15.041067 * np.sqrt(0.75), abs=0.05)


def test_two_level_gyros_give_the_level_part(tmp_path: Path):
    found = at_rest(tmp_path, rotation(np.array([0.0, 0.0, 0.7])), gyros="xy")
    assert value(found, "earth_rate.level").value == pytest.approx(15.041067 / 2, abs=0.05)
    assert "earth_rate.norm" not in found


def test_gyros_that_see_too_little_say_so(tmp_path: Path):
    found = at_rest(tmp_path, TILTED, gyros="x")
    assert isinstance(found["undetermined"], Undetermined)
    assert set(found) == {"undetermined"}


def test_the_shipped_biases_agree_with_their_truth():
    """On a levelled plate the attitude is known to 2′; random walks move the means by some deg/h and some 60 ug."""
    found = {r.name: r for r in classical(load_campaign(SHIPPED)) if isinstance(r, Estimate)}
    assert found["gyro_bias.bias[gx]"].value == pytest.approx(21.00, abs=6.0)
    assert found["gyro_bias.bias[gy]"].value == pytest.approx(4.11, abs=6.0)
    assert found["accel_bias.bias[az]"].value == pytest.approx(-942.4, abs=150.0)
