"""Accelerometers alone that are waved: windows with |f| = g, and what the hand accelerates as noise."""

import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import imubayes
from imubayes.campaign.reduction.pose_table import MOST_POSES
from imubayes.foundations.campaign_data import Campaign, Run
from imubayes.foundations.errors import InputError

sys.path.insert(0, str(Path(__file__).parents[1] / "campaign"))
from motion_recordings import GRAVITY, random_unit, waved

AXES = {"ax": [1, 0, 0], "ay": [0, 1, 0], "az": [0, 0, 1]}
STILL = {"toward_o": "normal(0, 0.001 arcsec)", "toward_p": "normal(0, 0.001 arcsec)"}
MODEL = {
    "name": "waved",
    "effect": [
        "accel_bias",
        "accel_scale_factor",
        {"name": "accel_misalignment", "channels": ["ax"], "prior": STILL},
        {"name": "accel_misalignment", "channels": ["ay"], "prior": {"toward_p": STILL["toward_p"]}},
        {"name": "accel_misalignment", "channels": ["az"]},
        {"name": "white_noise", "prior": {"sigma": "lognormal(1 noise, 0.2)"}},
        "hand_acceleration",
    ],
}


def log_of(seed: int, seconds: float = 60.0, reach: float = 0.01, **more) -> dict[str, np.ndarray]:
    """Return the log of three accelerometers."""
    columns = waved(random_unit(np.random.default_rng(300 + seed)), seed, seconds=seconds, reach=reach, **more)
    return {name: values for name, values in columns.items() if name[0] != "g"}


def campaign_of(columns: dict[str, np.ndarray], procedure: str = "slow_motion") -> Campaign:
    known = {"output_unit": "m/s^2", "per": "m/s^2", "scale": 1.0}
    channels = [{"name": name, "kind": "accelerometer", "input_axis": axis} | known for name, axis in AXES.items()]
    if "gz" in columns:
        known = {"output_unit": "rad/s", "per": "rad/s", "scale": 1.0}
        channels.append({"name": "gz", "kind": "gyro", "input_axis": [0, 0, 1]} | known)
    content = {
        "format": 1, "name": "waved", "site": {"latitude_deg": 48.0, "height_m": 0.0, "gravity_m_s2": GRAVITY},
        "unit": {"serial": "1", "grade": "consumer"}, "channel": channels,
        "run": [{"name": "waved", "procedure": procedure}],
    }  # fmt: skip
    return imubayes.build_campaign(content, {"waved": columns})


@cache
def waved_run() -> Run:
    return campaign_of(log_of(1)).runs[0]


def test_each_window_is_a_pose_of_its_own() -> None:
    run = waved_run()
    assert run.tumble is not None
    assert run.tumble.in_motion
    assert not run.tumble.carried
    assert run.tumble.turns == 0
    assert len(set(run.tumble.pose.tolist())) == run.rows <= MOST_POSES
    assert np.isfinite(run.observed).all()
    assert np.sqrt(np.mean(run.sample_sd**2)) == pytest.approx(0.02, rel=0.1)  # of the samples, not the motion


def test_the_value_of_a_window_is_that_at_its_centre() -> None:
    """A unit that turns steadily, read without noise: the means of its windows would be short by a thousandth."""
    time = (np.arange(6000) + 0.5) / 100.0
    about = np.radians(60.0) * time
    lean = 0.9 * np.sin(0.11 * time)
    force = GRAVITY * np.stack([np.cos(about) * np.cos(lean), np.sin(about) * np.cos(lean), np.sin(lean)], axis=1)
    run = campaign_of({"time_s": time, **dict(zip(AXES, force.T, strict=True))}).runs[0]
    length = np.linalg.norm(run.observed, axis=1)
    assert length == pytest.approx(GRAVITY, rel=3e-5)


def test_a_knock_is_left_out_and_counted() -> None:
    columns = log_of(2)
    there = np.abs(columns["time_s"] - 20.0) < 0.3
    assert not any("knocked" in note for note in campaign_of(columns).runs[0].notes)
    knocked = columns | {"ax": columns["ax"] + np.where(there, 40.0, 0.0)}
    notes = campaign_of(knocked).runs[0].notes
    assert any("knocked" in note for note in notes)


def test_one_attitude_is_refused() -> None:
    columns = log_of(1)
    still = {name: np.full_like(values, 5.0) for name, values in columns.items()} | {"time_s": columns["time_s"]}
    rng = np.random.default_rng(1)
    still |= {name: 5.66 + rng.normal(0, 0.02, len(columns[name])) for name in AXES}
    with pytest.raises(InputError, match="windows are all of one attitude"):
        campaign_of(still)


def test_a_log_that_turns_too_fast_for_its_rate_is_refused() -> None:
    columns = log_of(1)
    slow = {name: values[::25] for name, values in columns.items()}
    with pytest.raises(InputError, match="more slowly, or record faster"):
        campaign_of(slow)


def test_a_short_log_is_refused() -> None:
    with pytest.raises(InputError, match="of motion without gaps"):
        campaign_of({name: values[:400] for name, values in log_of(1).items()})


def test_a_rotation_without_gyros_is_refused_with_the_procedures_that_need_none() -> None:
    columns = log_of(1)
    with pytest.raises(InputError, match="needs gyros about three axes") as raised:
        campaign_of(columns | {"gz": 0.1 * columns["ax"]}, "free_rotation")
    assert "slow_motion" in raised.value.issues[0].remedy


@pytest.mark.slow
def test_the_accelerometers_are_recovered_within_their_uncertainties() -> None:
    """Bias and scale factor of three channels, of a hand whose acceleration nobody stated."""
    errors = random_unit(np.random.default_rng(301))
    campaign = campaign_of(log_of(1))
    fitted = imubayes.fit(campaign, imubayes.build_model(MODEL), sample=False)
    assert fitted.converged
    size = np.linalg.norm(np.eye(3) + errors.accel_tilt, axis=1)
    for place, name in enumerate(AXES):
        bias, scale = fitted[f"accel_bias.bias[{name}]"], fitted[f"accel_scale_factor.scale[{name}]"]
        assert abs(bias.mean * 9.80665e-6 - errors.accel_bias[place] / size[place]) < 4 * bias.sd * 9.80665e-6
        assert abs(scale.mean * 1e-6 - ((1 + errors.accel_scale[place]) * size[place] - 1)) < 4 * scale.sd * 1e-6
        assert bias.sd < 3000
    hand = fitted["hand_acceleration.sigma[all]"]
    assert hand.from_data is not None
    assert hand.from_data > 0.9
