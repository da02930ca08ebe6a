"""A mounting known to a degree beside accelerometers that resolve a microgravity: the ridge is no parabola.

The reference integrates over the tilts with NumPy; gravity and tilts are exact there, and no model is linearised.
"""

import dataclasses
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import imubayes
from imubayes.inference.laplace_proposal import LaplaceProposal, LogDensity, WeighedProposal, weigh
from imubayes.inference.nested_laplace import NestedLaplace, nested_laplace
from imubayes.inference.posterior_mode import find_mode
from imubayes.model.bind import Model
from imubayes_recordings.convert import convert

GRAVITY, TILT_DEG, BIAS_MG, NOISE_MG = 9.80665, 2.0, 50.0, 0.2
BIAS = np.array([3e-3, -2e-3, 5e-3])  # g
MODEL = """
format = 1
name = "wide"
[[effect]]
name = "accel_bias"
prior = { bias = "normal(0, 50 mg)" }
[[effect]]
name = "mounting_error"
[[effect]]
name = "white_noise"
"""


@pytest.fixture(scope="module")
def measured(tmp_path_factory) -> tuple[Path, np.ndarray]:
    """Return the campaign of a record at rest, and the mean outputs in g."""
    folder, random = tmp_path_factory.mktemp("wide"), np.random.default_rng(5)
    tilted = Rotation.from_rotvec(np.radians([1.5, -2.0, 0.0])).inv().apply([0.0, 0.0, 1.0])
    rows = tilted + BIAS + 1e-3 * NOISE_MG * random.normal(size=(4000, 3))
    table = np.column_stack([np.arange(4000) / 100, GRAVITY * rows])
    header = "time_s,ax (m/s2),ay (m/s2),az (m/s2)"
    np.savetxt(folder / "log.csv", table, delimiter=",", header=header, comments="", fmt="%.9g")
    made = convert([folder / "log.csv"], folder / "unit", latitude_deg=48.0, gravity_m_s2=GRAVITY)
    text = (made / "campaign.toml").read_text()
    text = text.replace('azimuth_deg = "unknown"', "azimuth_deg = 0.0\naxis_uncertainty_arcsec = 10.0")
    text = text.replace("uncertainty_arcmin = 0.0", f"uncertainty_arcmin = {60 * TILT_DEG}")
    (made / "campaign.toml").write_text(text)
    (folder / "model.toml").write_text(MODEL)
    return folder, rows.mean(axis=0)


@pytest.fixture(scope="module")
def proposal(measured) -> tuple[Model, NestedLaplace]:
    folder, _ = measured
    model = imubayes.bind(imubayes.load_model(folder / "model.toml"), imubayes.load_campaign(folder / "unit"))
    mode = find_mode(model.problem, *(jnp.zeros(size) for size in model.problem.size))
    assert bool(mode.converged)
    return model, nested_laplace(model.problem, mode)


def weighed(model: Model, approximation: NestedLaplace) -> WeighedProposal:
    found = weigh(LogDensity(model.problem, 1000), LaplaceProposal(approximation, model.problem), 2, 4000, 0)
    assert found is not None
    return found


@pytest.mark.slow
def test_proposals_follow_the_ridge(proposal):
    model, approximation = proposal
    assert approximation.along_ridge is not None
    assert weighed(model, approximation).acceptance > 0.9
    # The bend to second order alone, the planted fault.
    planted = weighed(model, dataclasses.replace(approximation, along_ridge=None))
    assert planted.acceptance < 0.6
    assert planted.largest > 10


@pytest.mark.slow
def test_the_vertical_bias_has_the_moments_of_the_exact_integral(measured, proposal):
    model, approximation = proposal
    mean, sd, _ = weighed(model, approximation).moments()
    place = [each.name for each in model.layout.parameters].index("accel_bias.bias[az]")
    own = model.layout.parameters[place]
    found = np.array([own.value_at(mean[place]), sd[place] * own.prior_sd]) * 1e-6  # g

    random = np.random.default_rng(6)
    tilts = Rotation.from_rotvec(np.radians(TILT_DEG) * random.normal(size=(400_000, 3)))
    left = measured[1] - tilts.inv().apply([0.0, 0.0, 1.0])
    weight = np.exp(-0.5 * np.sum((left / (1e-3 * BIAS_MG)) ** 2, axis=1))
    exact = np.average(left[:, 2], weights=weight)
    spread = np.sqrt(np.average((left[:, 2] - exact) ** 2, weights=weight))
    assert spread > 5e-4
    np.testing.assert_allclose(found[0], exact, atol=0.1 * spread)
    np.testing.assert_allclose(found[1], spread, rtol=0.1)
