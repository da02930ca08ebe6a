"""Poses without the motion between them: tables of means, one file a face, accelerometers alone, turns cut out."""

from pathlib import Path

import numpy as np
import pytest
import scipy
from small_files import GRAVITY
from tumble_files import NAMES, channels, tumble_log

from imubayes.campaign import load_campaign
from imubayes.campaign.reduction.free_tumble import reduce_tumble
from imubayes.campaign.reduction.pose_table import MOST_POSES, spread_over_the_sphere
from imubayes.foundations.errors import InputError
from imubayes_recordings.convert import convert, read_recordings

SCALE, BIAS = np.array([1.002, 0.997, 1.004]), np.array([0.05, -0.03, 0.2])


def poses(count: int, seed: int = 1) -> np.ndarray:
    """Specific forces of faces and random attitudes as an accelerometer with scale factors and biases reads them."""
    rng = np.random.default_rng(seed)
    directions = np.vstack([np.eye(3), -np.eye(3), rng.normal(size=(max(0, count - 6), 3))])[:count]
    return GRAVITY * directions / np.linalg.norm(directions, axis=1, keepdims=True) * SCALE + BIAS


@pytest.mark.parametrize(("count", "header"), [(6, ""), (24, "ax,ay,az"), (24, ""), (140, "ax,ay,az")])
def test_a_table_of_means(tmp_path: Path, count: int, header: str) -> None:
    means = poses(count) + np.random.default_rng(2).normal(0, 1e-4, (count, 3))
    np.savetxt(tmp_path / "means.csv", means, delimiter=",", header=header, comments="", fmt="%.6f")
    campaign = load_campaign(convert([tmp_path / "means.csv"], tmp_path / "c", gravity_m_s2=GRAVITY))
    [run] = campaign.runs
    assert [channel.name for channel in campaign.channels] == ["ax", "ay", "az"]
    np.testing.assert_allclose(run.observed, means, atol=1e-6)
    assert run.tumble is not None
    assert (len(run.tumble.start), run.tumble.flagged.any()) == (0, False)
    # Each attitude is levelled by its calibrated force.
    up = run.tumble.attitude.transpose(0, 2, 1)[:, :, 2]
    truth = (means - BIAS) / SCALE / GRAVITY
    assert np.linalg.norm(up - truth, axis=1).max() < (0.05 if count < 8 else 1e-3)
    assert any("each row is the mean of one pose" in note for note in campaign.notes)


def test_means_with_their_scatter_and_a_disturbed_one(tmp_path: Path) -> None:
    means = poses(24) / GRAVITY
    means[7] *= 1.01
    columns = np.stack([np.c_[np.sign(means[:, k]), means[:, k], np.full(24, 1e-3)] for k in range(3)], axis=1)
    header = ",".join(f"{axis}_true (g),{axis}_mean (g),{axis}_std" for axis in "xyz")
    np.savetxt(tmp_path / "m.csv", columns.reshape(24, 9), delimiter=",", header=header, comments="", fmt="%.6f")
    campaign = load_campaign(convert([tmp_path / "m.csv"], tmp_path / "c", samples=400, gravity_m_s2=GRAVITY))
    [run] = campaign.runs
    assert campaign.channels[0].per == "g"
    np.testing.assert_allclose(run.observed, np.delete(means, 7, axis=0), atol=1e-6)
    assert (run.samples == 400).all()
    np.testing.assert_allclose(run.sample_sd, 1e-3)
    assert any("row 8 excluded as disturbed" in note for note in run.notes)


def test_one_file_a_face(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    files, names = [], "t,accX,accY,accZ,gyroX,gyroY,gyroZ"
    for face, force in enumerate(poses(6)):
        rows = np.c_[0.01 * np.arange(300), force + rng.normal(0, 0.01, (300, 3)), rng.normal(0.01, 1e-3, (300, 3))]
        files.append(tmp_path / f"face{face}.csv")
        np.savetxt(files[-1], rows, delimiter=",", header=names, comments="", fmt="%.7g")
    campaign = load_campaign(convert(files, tmp_path / "c", gyro_unit="rad/s", gravity_m_s2=GRAVITY))
    [run] = campaign.runs
    np.testing.assert_allclose(run.observed[:, :3], poses(6), atol=3e-3)
    np.testing.assert_allclose(run.observed[:, 3:], 0.01, atol=3e-4)
    assert (run.samples == 300).all()
    np.testing.assert_allclose(run.sample_sd[:, :3], 0.01, rtol=0.2)


def test_accelerometers_alone_are_a_tumble_without_turns() -> None:
    columns, _ = tumble_log()
    alone = {name: columns[name] for name in ("time_s", *NAMES[:3])}
    reduced = reduce_tumble(alone, channels()[:3], GRAVITY, None, "log.csv")
    assert len(reduced.tumble.flagged) == 16
    assert len(reduced.tumble.start) == 0
    whole = reduce_tumble(columns, channels(), GRAVITY, None, "log.csv")
    np.testing.assert_allclose(reduced.numbers["az"], whole.numbers["az"], atol=2e-3)
    with pytest.raises(InputError, match="three accelerometers in different directions"):
        reduce_tumble(alone, channels()[:2], GRAVITY, None, "log.csv")


def test_a_turn_with_a_gap_is_left_out() -> None:
    columns, _ = tumble_log()
    whole = reduce_tumble(columns, channels(), GRAVITY, None, "log.csv")
    moving = np.flatnonzero(np.linalg.norm([columns[name] for name in NAMES[3:]], axis=0) > 1.0)
    middle = moving[np.searchsorted(moving, moving[0] + 50)]
    for missing, left_out in ((40, True), (3, False)):
        keep = (np.arange(len(columns["time_s"])) < middle - 20) | (
            np.arange(len(columns["time_s"])) >= middle - 20 + missing
        )
        cut = {name: values[keep] for name, values in columns.items()}
        reduced = reduce_tumble(cut, channels(), GRAVITY, None, "log.csv")
        assert not reduced.tumble.flagged.any()
        assert len(reduced.tumble.start) == len(whole.tumble.start) - left_out
        told = [note for note in reduced.notes if "turn from pose 0 to pose 1 is left out: 0.41 s are missing" in note]
        assert len(told) == left_out
        assert reduced.findings == ()


def test_turns_that_were_cut_out_are_no_wrong_unit(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    force = np.repeat(poses(20), 300, axis=0) + rng.normal(0, 0.01, (6000, 3))
    rows = np.c_[0.01 * np.arange(6000), force, rng.normal(0.002, 1e-3, (6000, 3))]
    np.savetxt(tmp_path / "log", rows, header=" ".join(("time_s", *NAMES)), fmt="%.7g")
    made = read_recordings([tmp_path / "log"], gravity_m_s2=GRAVITY)
    campaign = load_campaign(made.write(tmp_path / "c"))
    [run] = campaign.runs
    assert run.tumble is not None
    assert (run.rows, len(run.tumble.start)) == (20, 0)
    assert any("the attitude jumps from one sample to the next" in note for note in run.notes)


def test_thousands_of_poses_are_merged_by_direction(tmp_path: Path) -> None:
    """Most of the readings are of one face, as of a unit that lay on the desk; the fit is that of all directions."""
    rng = np.random.default_rng(1)
    down = np.vstack([rng.normal(size=(1500, 3)), [0, 0, 1] + 0.05 * rng.normal(size=(1500, 3))])
    down /= np.linalg.norm(down, axis=1)[:, None]
    force = down * [1.003, 0.998, 1.001] + [0.02, -0.01, 0.015] + rng.normal(0, 0.002, down.shape)
    np.savetxt(tmp_path / "means.csv", force, delimiter=",", header="ax,ay,az", comments="", fmt="%.5f")
    convert([tmp_path / "means.csv"], tmp_path / "unit", rows="means", accel_unit="g", gravity_m_s2=9.81)
    run = load_campaign(tmp_path / "unit").runs[0]
    assert run.rows == MOST_POSES
    assert sum("merged by direction into 150" in note for note in run.notes) == 1
    assert run.samples.sum() == 3000
    used = run.observed / np.linalg.norm(run.observed, axis=1)[:, None]
    # Evenly: each octant has an eighth, but for the readings that there are.
    octants = np.bincount((used > 0) @ [1, 2, 4], minlength=8) / MOST_POSES
    assert octants.min() > 0.08
    assert octants.max() < 0.25
    assert len(spread_over_the_sphere(down[:100], MOST_POSES)) == 100


def by_magnitude(force: np.ndarray, samples: np.ndarray, noise: float) -> tuple[np.ndarray, np.ndarray]:
    """Return bias and scale of three axes by |f| = 1 with their standard uncertainties, (6,) each."""

    def residual(values: np.ndarray) -> np.ndarray:
        across = np.array([[0, 0, 0], [values[6], 0, 0], [values[7], values[8], 0]])
        level = (force - values[:3]) @ (np.diag(1 / values[3:6]) + across).T
        return (np.linalg.norm(level, axis=1) - 1) * np.sqrt(samples) / noise

    found = scipy.optimize.least_squares(residual, [0, 0, 0, 1, 1, 1, 0, 0, 0])
    return found.x[:6], np.sqrt(np.diag(np.linalg.inv(found.jac.T @ found.jac)))[:6]


def test_merged_poses_hold_the_information_of_all(tmp_path: Path) -> None:
    truth = np.array([0.02, -0.01, 0.015, 1.003, 0.998, 1.001])
    scores = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        down = rng.normal(size=(3000, 3))
        down /= np.linalg.norm(down, axis=1)[:, None]
        force = down * truth[3:] + truth[:3] + rng.normal(0, 0.004, down.shape)
        np.savetxt(tmp_path / "means.csv", force, delimiter=",", header="ax,ay,az", comments="", fmt="%.5f")
        folder = tmp_path / f"unit-{seed}"
        convert([tmp_path / "means.csv"], folder, rows="means", accel_unit="g", gravity_m_s2=9.80665)
        run = load_campaign(folder).runs[0]
        found, uncertainty = by_magnitude(run.observed, run.samples, 0.004)
        _, of_all = by_magnitude(force, np.ones(len(force)), 0.004)
        np.testing.assert_allclose(uncertainty, of_all, rtol=0.1)
        scores.append((found - truth) / uncertainty)
    assert 0.7 < np.sqrt(np.mean(np.square(scores))) < 1.3
