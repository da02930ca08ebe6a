"""Turns of a unit by hand through an angle that is stated: gyros alone, or beside accelerometers."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
import scipy.io

import imubayes
from imubayes.foundations.errors import InputError
from imubayes_recordings.convert import convert, read_recordings
from imubayes_recordings.convert.proposed_effects import propose_effects

SCALE, BIAS, NOISE, HZ = np.array([1.01, 0.99, 1.005]), np.array([0.002, -0.001, 0.003]), 1e-3, 100
FULL = tuple((axis, sense * 360.0) for axis in range(3) for sense in (1, -1, 2))


def turned(turns: Sequence[tuple[int, float]], seed: int = 1, error: float = 0.0) -> np.ndarray:
    """Return times and rates of turns about x, y, z through angles in deg, with rests between, (N, 4)."""
    rng, parts = np.random.default_rng(seed), [np.zeros((5 * HZ, 3))]
    for axis, angle in turns:
        seconds = 2.0 + rng.uniform(0, 1.5)
        shape = np.sin(np.linspace(0, np.pi, round(seconds * HZ))) ** 2  # as a hand moves
        rate = np.zeros((len(shape), 3))
        rate[:, axis] = np.radians(angle + error * rng.normal()) * shape / shape.sum() * HZ
        parts += [rate, np.zeros((round(rng.uniform(2, 4) * HZ), 3))]
    rate = np.concatenate(parts) * SCALE + BIAS
    rate += rng.normal(0, NOISE, rate.shape)
    return np.column_stack([np.arange(len(rate)) / HZ, rate])


def write(file: Path, values: np.ndarray, header: str = "time_s,gx (rad/s),gy (rad/s),gz (rad/s)") -> Path:
    np.savetxt(file, values, delimiter=",", header=header, comments="", fmt="%.9g")
    return file


def test_each_turn_is_a_row_of_the_stated_angle(tmp_path: Path) -> None:
    file = write(tmp_path / "turns.csv", turned([*FULL, (0, 271.0)]))
    made = read_recordings([file], turn_deg=360.0, turn_uncertainty_deg=0.5).campaign
    assert [run["name"] for run in made.document["run"]] == ["turns-x", "turns-y", "turns-z"]
    assert {run["turn_uncertainty_deg"] for run in made.document["run"]} == {0.5}
    for axis, letter in enumerate("xyz"):
        rows = made.tables[f"runs/turns-{letter}.csv"]
        angles = rows["table_rate_deg_s"] * rows["samples"] / HZ
        np.testing.assert_allclose(angles[angles != 0], [360, -360, 720])
        outputs = np.stack([rows[name] for name in ("gx", "gy", "gz")], axis=1) - BIAS
        nominal = np.radians(rows["table_rate_deg_s"])[:, None] * np.eye(3)[axis] * SCALE
        np.testing.assert_allclose(outputs, nominal, atol=6 * NOISE / np.sqrt(200))
        assert (np.isnan(rows["gx_sd"]) == (angles != 0)).all()
    # The turn that is none through a full circle, nor from rest to rest about one axis, is named.
    assert sum("turn left out: 273.7 deg about gx" in note for note in made.document["notes"]) == 1


def test_matrices_of_gyros_stated_together_are_the_runs_of_a_session(tmp_path: Path) -> None:
    """Turns about three axes, one matrix each in one file."""
    turns = {f"turn{axis}": turned([(place, 360.0), (place, -360.0)], seed=place) for place, axis in enumerate("XYZ")}
    scipy.io.savemat(tmp_path / "three.mat", turns)
    columns = {"time_s": 1, "gx": 2, "gy": 3, "gz": 4}
    with pytest.raises(InputError, match="3 topics hold channels") as caught:
        read_recordings([tmp_path / "three.mat"], turn_deg=360.0, columns=columns)
    assert "stated together: --topic turnX --topic turnY" in caught.value.issues[0].remedy
    made = read_recordings([tmp_path / "three.mat"], turn_deg=360.0, columns=columns, topic=tuple(turns)).campaign
    assert [run["name"] for run in made.document["run"]] == ["turns-x-1", "turns-y-2", "turns-z-3"]


@pytest.mark.parametrize(("unit", "per_radian"), [("rad/s", 1.0), ("deg/s", 57.29578)])
def test_the_unit_follows_from_the_stated_turns(tmp_path: Path, unit: str, per_radian: float) -> None:
    values = turned(FULL) * [1.0, *[per_radian] * 3]
    made = read_recordings([write(tmp_path / "log.csv", values, "time_s,gx,gy,gz")], turn_deg=360.0).campaign
    assert made.options.gyro_unit == unit
    assert made.guesses["gyro_unit"].startswith("turns of 360 deg integrate to ")


@pytest.mark.compiled
def test_the_angles_are_no_better_than_they_are_stated(tmp_path: Path) -> None:
    file = write(tmp_path / "turns.csv", turned(FULL))
    campaign = imubayes.load_campaign(convert([file], tmp_path / "unit", turn_deg=360.0))
    proposal = propose_effects(campaign)
    specs = {each.spec.name: each.spec for each in proposal.effects}
    assert {"gyro_bias", "gyro_scale_factor", "mounting_error", "encoder_noise"} <= set(specs)
    assert specs["encoder_noise"].prior == {"sigma": "lognormal(0.7071 deg, 0.5)"}


def test_accelerometers_keep_what_is_not_a_stated_turn(tmp_path: Path) -> None:
    rates = turned([(2, 360.0), (0, 90.0), (2, -360.0)])
    force = np.zeros((len(rates), 3)) + np.random.default_rng(2).normal(0, 0.01, (len(rates), 3))
    angle = np.cumsum((rates[:, 1] - BIAS[0]) / SCALE[0]) / HZ
    force[:, 1:] += 9.81 * np.column_stack([np.sin(angle), np.cos(angle)])
    names = "time_s,gx (rad/s),gy (rad/s),gz (rad/s),ax (m/s^2),ay (m/s^2),az (m/s^2)"
    file = write(tmp_path / "unit.csv", np.column_stack([rates, force]), names)
    made = read_recordings([file], turn_deg=360.0, gravity_m_s2=9.81).campaign
    assert [(run["name"], run["procedure"]) for run in made.document["run"]] == [
        ("recording", "free_tumble"), ("turns-z", "rate_table"),
    ]  # fmt: skip
    rest = made.tables["runs/recording.csv"]
    # The turns about z are reported once, as rows; the one about x is left to gravity.
    assert np.ptp(np.cumsum(rest["gz"] - BIAS[2])) / HZ < 0.1
    assert np.ptp(np.cumsum(rest["gx"] - BIAS[0])) / HZ == pytest.approx(1.01 * np.pi / 2, abs=0.01)


@pytest.mark.parametrize(
    ("options", "turns", "said"),
    [
        ({}, FULL, "without accelerometers the angle is unknown"),
        ({"turn_deg": 90.0}, [(0, 40.0)], "no turn is one through 90 deg: 40.38 deg about gx"),
        ({"turn_deg": 360.0}, [], "the unit never turns"),
        ({"turn_deg": -360.0}, FULL, "turn_deg = -360.0 is not positive"),
    ],
)
def test_what_is_no_stated_turn_is_refused(tmp_path: Path, options: dict, turns: Sequence, said: str) -> None:
    with pytest.raises(InputError, match=said):
        convert([write(tmp_path / "turns.csv", turned(turns))], tmp_path / "unit", **options)
    assert not (tmp_path / "unit").exists()


def test_a_run_without_turns_states_no_uncertainty_of_them(tmp_path: Path) -> None:
    file = write(tmp_path / "turns.csv", turned(FULL))
    folder = convert([file], tmp_path / "unit", turn_deg=360.0)
    text = (folder / "campaign.toml").read_text().replace('"rate_table"', '"static_record"', 1)
    (folder / "campaign.toml").write_text(text)
    with pytest.raises(InputError, match="states turn_uncertainty_deg, but has no turns"):
        imubayes.load_campaign(folder)


@pytest.mark.slow  # 16 fits of one shape
def test_scale_factors_cover_the_truth_with_the_angle_that_a_hand_reaches(tmp_path: Path) -> None:
    pulls = []
    for seed in range(16):
        here = tmp_path / str(seed)
        here.mkdir()
        made = imubayes.new(here / "unit", [write(here / "turns.csv", turned(FULL, seed, 1.0))], turn_deg=360.0)
        result = imubayes.fit(made.folder, made.model, here / "fit", sample=False)
        for line in result.summary.parameters:
            if line.name.startswith("gyro_scale_factor.scale"):
                assert line.mean is not None
                assert line.sd is not None
                pulls.append((line.mean - 1e6 * (SCALE["xyz".index(line.name[-2])] - 1)) / line.sd)
    spread = float(np.sqrt(np.mean(np.square(pulls))))
    print(f"pull of 48 scale factors: {spread:.2f} (0.80 to 1.20 in 95 % of studies)")
    assert 0.7 < spread < 1.3


@pytest.mark.parametrize(("seed", "rest_s"), [(0, 3.0), (1, 3.0), (2, 0.8), (3, 0.4)])
def test_gyros_in_counts_have_their_scale_by_the_stated_turns(tmp_path: Path, seed: int, rest_s: float) -> None:
    """Each axis of its own sensitivity; some turns are of two rounds, and the last axis is not turned at all."""
    random, hz, counts = np.random.default_rng(seed), 50, np.array([16.4, 16.1, 16.3])
    parts = [np.zeros((6 * hz, 3))]
    for axis in (0, 1):
        for rounds in (1, -1, 2, -1, 1, -2):
            shape = 1 - np.cos(2 * np.pi * (np.arange(4 * hz) + 0.5) / (4 * hz))
            turn = np.zeros((4 * hz, 3))
            turn[:, axis] = shape * (360 * rounds + random.normal()) / 4
            parts += [turn, np.zeros((round(rest_s * hz), 3))]
    rate = np.concatenate(parts)
    recorded = np.round(counts * (rate + np.array([0.6, -0.4, 0.3]) + random.normal(0, 0.05, rate.shape)))
    rows = np.c_[np.arange(len(rate)) * 1000 // hz, recorded]
    np.savetxt(tmp_path / "log.csv", rows, delimiter=",", header="ms,gx,gy,gz", comments="", fmt="%d")
    read = read_recordings([tmp_path / "log.csv"], gyro_unit="count", turn_deg=360, latitude_deg=48)
    scale = np.array([channel["scale"] for channel in read.campaign.document["channel"]]) / np.degrees(1)
    offset = np.array([channel["offset"] for channel in read.campaign.document["channel"]])
    np.testing.assert_allclose(scale[:2], counts[:2], rtol=5e-3)
    np.testing.assert_allclose(scale[2], scale[:2].mean(), rtol=1e-3)
    np.testing.assert_allclose(offset, counts * [0.6, -0.4, 0.3], atol=0.5)
    given = read_recordings([tmp_path / "log.csv"], gyro_unit="count", turn_deg=360, latitude_deg=48, gyro_scale=[930])
    assert [channel["scale"] for channel in given.campaign.document["channel"]] == [930.0] * 3
    said = "\n".join(given.campaign.document["notes"])
    assert "nominal scale of the gyros as stated: 930, 930, 930 count per rad/s; offset estimated from turns" in said
    assert "deg/s; the biases of a fit are in addition to it" in said


def test_a_small_motion_about_an_axis_is_no_turn_of_its_scale(tmp_path: Path) -> None:
    """The unit is put down between the turns: 20 deg about z alone, which is no whole part of a turn."""
    counts = np.round(np.c_[turned([(0, 360.0), (2, 20.0), (1, -360.0), (0, 360.0)])] * [1000, 900, 900, 900])
    np.savetxt(tmp_path / "log.csv", counts, delimiter=",", header="ms,gx,gy,gz", comments="", fmt="%d")
    made = read_recordings([tmp_path / "log.csv"], gyro_unit="count", turn_deg=360, latitude_deg=48).campaign
    scale = np.array([channel["scale"] for channel in made.document["channel"]])
    np.testing.assert_allclose(scale[:2], 900 * SCALE[:2], rtol=1e-2)
    np.testing.assert_allclose(scale[2], scale[:2].mean(), rtol=1e-3)


def test_turns_with_short_rests_are_no_partial_turns(tmp_path: Path) -> None:
    """From row to row less time passes than the turn takes, since the rests beside it are short."""
    file = write(tmp_path / "turns.csv", turned([(2, 360.0), (2, -360.0)]))
    folder = convert([file], tmp_path / "unit", turn_deg=360.0)
    assert not [each for each in imubayes.load_campaign(folder).runs[0].notes if "partial_turn" in each]
