"""Classical evaluation of poses in unknown attitudes: |f| = g, against closed forms and a simulation of numpy alone."""

from pathlib import Path

import numpy as np
import pytest

import imubayes
from imubayes.procedures.free_tumble import tumble_test
from imubayes.procedures.textbook import Estimate, Undetermined
from imubayes_recordings.convert import convert

GRAVITY, SCALE, BIAS = 9.81, np.array([1.004, 0.997, 1.002]), np.array([0.03, -0.02, 0.1])
TILT = np.array([[1.0, 0.0, 0.0], [0.004, 1.0, 0.0], [-0.003, 0.006, 1.0]])


def evaluated(folder: Path, forces: np.ndarray, noise: float = 0.0, seed: int = 1) -> list:
    """Return the evaluation of means of 400 samples in poses of these specific forces, (poses, 3) m/s²."""
    axes = TILT / np.linalg.norm(TILT, axis=1, keepdims=True)
    sd = np.full(forces.shape, 20 * noise)
    means = SCALE * (forces @ axes.T + BIAS) + np.random.default_rng(seed).normal(0, noise, forces.shape)
    header = "ax,ay,az,samples,ax_sd,ay_sd,az_sd"
    rows = np.column_stack([means, np.full(len(means), 400.0), sd])
    np.savetxt(folder / "means.csv", rows, delimiter=",", header=header, comments="", fmt="%.12g")
    campaign = imubayes.load_campaign(convert([folder / "means.csv"], folder / "unit", gravity_m_s2=GRAVITY))
    return tumble_test(campaign, campaign.runs)


def numbers(found: list) -> dict[str, Estimate]:
    return {each.name: each for each in found if isinstance(each, Estimate)}


def test_six_faces_give_sums_and_differences(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(globals(), "TILT", np.eye(3))
    forces = GRAVITY * np.vstack([np.eye(3), -np.eye(3)])
    found = numbers(evaluated(tmp_path, forces))
    for place, name in enumerate(("ax", "ay", "az")):
        up, down = SCALE[place] * (GRAVITY + BIAS[place]), SCALE[place] * (-GRAVITY + BIAS[place])
        assert found[f"scale_factor[{name}]"].value == pytest.approx((up - down) / 2 / GRAVITY, abs=1e-9)
        bias = (up + down) / 2 / SCALE[place] / GRAVITY * 1e6
        assert found[f"accel_bias.bias[{name}]"].value == pytest.approx(bias, abs=1e-3)


def test_thirty_attitudes_give_the_truth_beside_misalignments(tmp_path: Path) -> None:
    directions = np.random.default_rng(4).normal(size=(30, 3))
    forces = GRAVITY * directions / np.linalg.norm(directions, axis=1, keepdims=True)
    found = numbers(evaluated(tmp_path, forces, 0.002))
    for place, name in enumerate(("ax", "ay", "az")):
        scale, bias = found[f"scale_factor[{name}]"], found[f"accel_bias.bias[{name}]"]
        assert abs(scale.value - SCALE[place]) < 3.5 * scale.sd < 0.001
        assert abs(bias.value - BIAS[place] / GRAVITY * 1e6) < 3.5 * bias.sd < 700
        assert "9 parameters" in scale.method


def test_one_half_of_the_faces_is_told_to_be_too_few(tmp_path: Path) -> None:
    found = evaluated(tmp_path, GRAVITY * np.repeat(np.eye(3), 5, axis=0), 0.002)
    [left] = [each for each in found if isinstance(each, Undetermined)]
    assert "15 poses do not determine 6 parameters" in left.sentence
    assert not numbers(found)
