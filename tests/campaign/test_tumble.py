"""Poses and motion of a free tumble, on a tumble whose motion is known exactly and on real recordings."""

import shutil
import tomllib
from pathlib import Path

import desk_imu
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from small_files import GRAVITY
from tumble_files import NAMES, channels, tumble_log
from tumble_recordings import Recording

from imubayes.campaign import check_campaign, load_campaign
from imubayes.campaign.reduction.free_tumble import reduce_tumble
from imubayes.campaign.reduction.magnitude_calibration import fit_magnitude
from imubayes.campaign.reduction.rests import Rest, trim_rests
from imubayes.campaign.reduction.static_poses import coning, rotation_over, step_edges, step_means

DESK = Path(__file__).parents[2] / "data" / "desk-imu"


def test_poses_and_rows() -> None:
    columns, attitude = tumble_log()
    reduced = reduce_tumble(columns, channels(), GRAVITY, None, "log.csv")
    tumble = reduced.tumble
    assert len(tumble.flagged) == 16
    assert not tumble.flagged.any()
    assert reduced.findings == ()
    np.testing.assert_array_equal(tumble.start, np.arange(15))
    np.testing.assert_array_equal(tumble.stop, np.arange(1, 16))
    assert (reduced.numbers["samples"] > 250).all()
    assert reduced.numbers["ax_sd"] == pytest.approx(0.02, rel=0.15)
    middle = np.searchsorted(columns["time_s"], reduced.numbers["time_s"])
    level = attitude[middle].transpose(0, 2, 1)[:, :, 2] * GRAVITY
    np.testing.assert_allclose(np.stack([reduced.numbers[n] for n in NAMES[:3]], 1), level, atol=6e-3)


def test_gravity_is_carried_from_pose_to_pose() -> None:
    columns, attitude = tumble_log(noise=False)
    force = np.stack([columns[name] for name in NAMES[:3]], axis=1)
    columns |= dict(zip(NAMES, (force + 1e-4 * np.random.default_rng(1).normal(size=force.shape)).T, strict=False))
    reduced = reduce_tumble(columns, channels(), GRAVITY, 9.0, "log.csv")
    tumble = reduced.tumble
    middle = np.searchsorted(columns["time_s"], reduced.numbers["time_s"])
    true = attitude[middle]
    for index, (before, after) in enumerate(zip(tumble.start, tumble.stop, strict=True)):
        rate = tumble.readings[index][:, 3:] - 0.01
        turned = rotation_over(rate, tumble.step[index], tumble.coning[index])
        assert Rotation.from_matrix(turned.T @ true[before].T @ true[after]).magnitude() < 2e-6
    # The attitudes are right but for one common heading.
    common = true[0] @ tumble.attitude[0].T
    errors = Rotation.from_matrix(tumble.attitude.transpose(0, 2, 1) @ common.T @ true).magnitude()
    assert np.max(errors) < 5e-4
    assert tumble.step.max() <= 0.101
    padding = tumble.step == 0
    assert not tumble.readings[padding].any()
    assert not tumble.coning[padding].any()


def test_disturbed_pose_is_flagged_and_bridged() -> None:
    columns, _ = tumble_log(twist_in=5)
    reduced = reduce_tumble(columns, channels(), GRAVITY, None, "log.csv")
    assert list(np.flatnonzero(reduced.tumble.flagged)) == [5]
    assert list(reduced.tumble.pose) == [pose for pose in range(16) if pose != 5]
    assert len(reduced.numbers["samples"]) == 15
    assert (4, 6) in list(zip(reduced.tumble.start, reduced.tumble.stop, strict=True))
    assert "pose 5" in reduced.notes[-1]
    assert "disturbed" in reduced.notes[-1]


def test_force_of_wrong_length_is_an_outlier() -> None:
    rng = np.random.default_rng(0)
    force = rng.normal(size=(20, 3))
    force *= GRAVITY / np.linalg.norm(force, axis=1, keepdims=True)
    force = force * [1.01, 0.99, 1.002] + [0.1, -0.05, 0.2] + rng.normal(size=force.shape) * 1e-3
    force[7] *= 1.01
    fit = fit_magnitude(force, GRAVITY)
    assert list(np.flatnonzero(fit.outliers)) == [7]
    np.testing.assert_allclose(np.diag(fit.matrix), 1 / np.array([1.01, 0.99, 1.002]), atol=1e-3)
    np.testing.assert_allclose(fit.offset, [0.1, -0.05, 0.2], atol=5e-3)


def test_coning_makes_a_coarse_step_exact() -> None:
    def wobble(time: np.ndarray) -> np.ndarray:
        return np.stack([2 * np.cos(50 * time), 2 * np.sin(50 * time), 0 * time], axis=1)

    time = np.arange(500) * 1e-3
    edges = np.array([0, 100, 200, 350, 499])
    true = np.eye(3)
    for turn in Rotation.from_rotvec(wobble((np.arange(4990) + 0.5) * 1e-4) * 1e-4).as_matrix():
        true = true @ turn
    length, mean = step_means(time, wobble(time), edges)
    correction = coning(time, wobble(time), edges)
    np.testing.assert_allclose(rotation_over(mean, length, correction), true, atol=1e-5)
    assert Rotation.from_matrix(true.T @ rotation_over(mean, length, 0 * correction)).magnitude() > 1e-3


def test_steps_are_short_when_fast() -> None:
    time = np.arange(0, 2, 0.01)
    rate = np.zeros((len(time), 3))
    rate[100:, 0] = 6.0
    edges = step_edges(time, rate, 10, 190)
    assert edges[0] == 10
    assert edges[-1] == 190
    assert (np.diff(edges) > 0).all()
    lengths = np.diff(time[edges])
    assert lengths[0] == pytest.approx(0.1, rel=0.2)
    assert lengths[-1] < 0.031


def test_wrong_units_are_named() -> None:
    columns, _ = tumble_log()
    in_g = columns | {name: columns[name] / GRAVITY for name in NAMES[:3]}
    names = [f.name for f in reduce_tumble(in_g, channels(), GRAVITY, None, "log.csv").findings]
    assert names == ["acceleration_unit"]
    in_degrees = columns | {name: np.rad2deg(columns[name]) / 57.3**2 for name in NAMES[3:]}
    names = [f.name for f in reduce_tumble(in_degrees, channels(), GRAVITY, None, "log.csv").findings]
    assert names == ["rate_unit"]


@pytest.mark.parametrize(("factor", "severity"), [(0.5, "error"), (0.7, "warning"), (2.0, "error")])
def test_a_wrong_range_of_the_gyros_is_told_from_exchanged_axes(factor: float, severity: str) -> None:
    columns, _ = tumble_log()
    scaled = columns | {name: factor * columns[name] for name in NAMES[3:]}
    [finding] = reduce_tumble(scaled, channels(), GRAVITY, None, "log.csv").findings
    assert (finding.name, finding.severity) == ("scale_far_from_nominal", severity)
    told = finding.what.partition("with the rates ")[2].split()[0]
    assert float(told) == pytest.approx(1 / factor, rel=0.02)


def test_a_scale_factor_that_full_turns_add_up_is_no_finding() -> None:
    made = Recording(4)
    for number in range(10):
        made.turn(6 * np.pi * np.eye(3)[number % 3], 12.0)
        made.to(Rotation.random(rng=made.rng))
        made.rest()
    columns = made.columns(errors=False)
    scaled = columns | {name: 1.06 * columns[name] for name in NAMES[3:]}
    assert reduce_tumble(scaled, channels(), GRAVITY, None, "log.csv").findings == ()


@pytest.fixture(scope="module")
def desk() -> str:
    return (DESK / "campaign.toml").read_text()


@pytest.mark.parametrize("channel", ["ax", "az", "gx", "gy"])
def test_a_reversed_axis_is_named(tmp_path: Path, desk: str, channel: str) -> None:
    folder = Path(shutil.copytree(DESK, tmp_path / "desk"))
    head, tail = desk.split(f'name = "{channel}"', 1)
    axis, rest = tail.split("input_axis = ", 1)
    line, rest = rest.split("\n", 1)
    turned = line.replace("1.0", "-1.0")
    assert turned != line
    (folder / "campaign.toml").write_text(f'{head}name = "{channel}"{axis}input_axis = {turned}\n{rest}')
    (finding,) = check_campaign(folder)
    assert (finding.name, finding.severity) == ("sign_reversed", "warning")
    assert f"with '{channel}' reversed" in finding.what


def test_exchanged_axes_come_with_their_lines(tmp_path: Path, desk: str) -> None:
    folder = Path(shutil.copytree(DESK, tmp_path / "desk"))
    assert not check_campaign(folder)
    exchanged = desk.replace('name = "gx"', 'name = "-"').replace('name = "gy"', 'name = "gx"')
    (folder / "campaign.toml").write_text(exchanged.replace('name = "-"', 'name = "gy"'))
    (finding,) = check_campaign(folder)
    assert finding.name == "axes_do_not_fit"
    assert "with the axes of gyros exchanged it is" in finding.what
    assert "'gy': input_axis = [0, 1, 0]; 'gx': input_axis = [1, 0, 0]" in finding.remedy


@pytest.mark.parametrize("seed", [1, 3])
def test_no_pose_reaches_into_a_turn_that_noisy_accelerometers_hide(tmp_path: Path, seed: int) -> None:
    desk_imu.generate(tmp_path, seed)
    moves = tomllib.loads((tmp_path / "truth.toml").read_text())["nuisance"]
    [run] = load_campaign(tmp_path).runs
    half = (run.samples - 1) / 2 / desk_imu.SAMPLE_RATE
    time = run.covariates["time"]
    first, last = time - half, time + half
    assert len(time) == desk_imu.POSES
    assert np.all(last[:-1] < moves["move_start_s"])
    assert np.all(first[1:] > moves["move_end_s"])


def test_the_gyros_trim_a_rest_at_both_ends() -> None:
    rate = np.random.default_rng(1).normal(0.3, 0.001, (400, 3))
    rate[:40, 0] += 0.2 * (1 - np.arange(40) / 40) ** 2
    rate[-60:, 1] += 0.2 * (np.arange(60) / 60) ** 2
    [rest] = trim_rests([Rest(0, 400)], rate, 0.01)
    assert 35 <= rest.start <= 60
    assert 320 <= rest.stop <= 350
    assert trim_rests([Rest(60, 330)], rate, 0.01) == [Rest(60, 330)]
