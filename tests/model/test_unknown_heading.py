"""A recording of a unit that somebody put on a bench: no interval may claim to know where north is, or what is level.

The simulator has the Earth rate and gravity in level axes, a heading and two tilts; it shares no code with the models.
"""

from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import imubayes
from imubayes.inference.nested_laplace import posterior_precision
from imubayes.inference.posterior_mode import find_mode
from imubayes_recordings.convert import convert

LATITUDE, RATE, GRAVITY = np.radians(48.0), 15.041067, 9.80665  # deg/h, m/s²
GYRO_BIAS, ACCEL_BIAS = np.array([5.0, -8.0, 12.0]), np.array([0.03, -0.02, 0.05])  # deg/h, m/s²
SAMPLES, NOISE = 2000, (0.0004, 0.002)
MODEL = """
format = 1
name = "bench"
[[effect]]
name = "gyro_bias"
[[effect]]
name = "accel_bias"
prior = { bias = "normal(0, 50 mg)" }
[[effect]]
name = "white_noise"
"""


def recorded(folder: Path, seed: int, *, face_down: bool = False) -> Path:
    """Write a log at 100 Hz of a unit at rest, at any heading and level to 1°, and return its campaign."""
    random = np.random.default_rng(seed)
    heading = Rotation.from_euler("z", random.uniform(0, 360), degrees=True)
    put = Rotation.from_euler("x", 180 * face_down, degrees=True)
    to_body = (heading * put * Rotation.from_rotvec(np.radians(random.normal(size=3)))).inv()
    earth = to_body.apply(RATE * np.array([0.0, np.cos(LATITUDE), np.sin(LATITUDE)]))
    gyros = (earth + GYRO_BIAS) / 3600 + NOISE[0] * random.normal(size=(SAMPLES, 3))
    accels = to_body.apply([0.0, 0.0, GRAVITY]) + ACCEL_BIAS + NOISE[1] * random.normal(size=(SAMPLES, 3))
    folder.mkdir(parents=True)
    rows = np.column_stack([np.arange(SAMPLES) / 100, accels, gyros])
    header = "time_s,ax (m/s2),ay (m/s2),az (m/s2),gx (deg/s),gy (deg/s),gz (deg/s)"
    np.savetxt(folder / "log.csv", rows, delimiter=",", header=header, comments="", fmt="%.9g")
    return convert([folder / "log.csv"], folder / "unit", latitude_deg=48.0, gravity_m_s2=GRAVITY)


@pytest.fixture(scope="module")
def pulls(tmp_path_factory) -> np.ndarray:
    """Return (estimate − truth) / sd of the six biases of eight records."""
    base = tmp_path_factory.mktemp("bench")
    (base / "model.toml").write_text(MODEL)
    found = []
    for seed in range(8):
        campaign = imubayes.load_campaign(recorded(base / str(seed), seed, face_down=seed % 2 == 1))
        model = imubayes.bind(imubayes.load_model(base / "model.toml"), campaign)
        mode = find_mode(model.problem, *(jnp.zeros(size) for size in model.problem.size))
        assert bool(mode.converged)
        sd = np.sqrt(np.diag(np.linalg.inv(np.asarray(posterior_precision(model.problem, mode)))))
        places = {each.name: place for place, each in enumerate(model.layout.parameters)}
        truth = {f"gyro_bias.bias[g{a}]": b for a, b in zip("xyz", GYRO_BIAS, strict=True)}
        truth |= {f"accel_bias.bias[a{a}]": 1e6 * b / GRAVITY for a, b in zip("xyz", ACCEL_BIAS, strict=True)}
        found.append([])
        for name, value in truth.items():
            own, place = model.layout.parameters[places[name]], places[name]
            found[-1].append((own.value_at(float(mode.z[place])) - value) / (sd[place] * own.prior_sd))
    return np.array(found)


@pytest.mark.slow
def test_intervals_contain_what_nobody_stated(pulls):
    assert np.abs(pulls[:, :5]).max() < 3.5
    # What tilts take off the vertical component has an exponential distribution, whose tail is longer.
    assert np.abs(pulls[:, 5]).max() < 5.0


def test_they_are_no_wider_than_that(pulls):
    # Level gyros err by a component of a unit vector of any direction: pulls of 1 rms, √2 at most.
    assert 0.6 < np.sqrt(np.mean(pulls[:, :2] ** 2)) < 1.4
    assert np.abs(pulls[:, :2]).max() < 1.6
