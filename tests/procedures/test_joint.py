"""Joint fits of the further procedures on shipped campaigns: truth within its uncertainty, gradients right."""

import tomllib
from functools import cache
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

from imubayes.campaign import load_campaign
from imubayes.inference.fitted_model import Fit
from imubayes.inference.nested_laplace import posterior_precision
from imubayes.inference.posterior_mode import find_mode
from imubayes.model.bind import bind
from imubayes.model.model_file import read_model
from imubayes.model.problem import predict_many
from imubayes.procedures import classical
from imubayes.procedures.textbook import Estimate
from imubayes.responses.residual_covariates import covariates

ROOT = Path(__file__).parents[2]


@cache
def fitted(name):
    campaign = load_campaign(ROOT / "data" / name)
    model = bind(read_model(ROOT / "models" / f"{name}.toml"), campaign)
    mode = find_mode(model.problem, *(jnp.zeros(size) for size in model.problem.size))
    assert bool(mode.converged)
    document = tomllib.loads((ROOT / "data" / name / "truth.toml").read_text())
    return model, mode, document["parameters"] | document["nuisance"]


def scores(model, mode, truth):
    sd = np.sqrt(np.diag(np.linalg.inv(np.asarray(posterior_precision(model.problem, mode)))))
    true = np.array([one.z_at(truth[one.name]) for one in model.layout.parameters], dtype=float)
    return (np.asarray(mode.z) - true) / sd


@pytest.mark.parametrize("name", [pytest.param("geographic-tumble", marks=pytest.mark.slow), "reference-gyro"])
def test_the_truth_is_within_its_uncertainty(name):
    found = scores(*fitted(name))
    assert np.abs(found).max() < 4
    assert np.sqrt(np.mean(found**2)) < 1.5


@pytest.fixture(scope="module")
def servo():
    return fitted("servo-table")


@pytest.mark.slow
def test_the_servo_table_is_integrated_to_the_truth(servo):
    found = scores(*servo)
    assert np.abs(found).max() < 4
    assert np.sqrt(np.mean(found**2)) < 1.5


@pytest.mark.slow
def test_the_angle_of_a_servo_table_has_no_input_axis(servo):
    """Residuals of the angle are regressed on what the run recorded, not on rate or specific force of a channel."""
    model, mode, _ = servo
    found = covariates(Fit(model, np.asarray(mode.z), np.asarray(mode.h), optimised=True))
    assert "time_s" in {covariate.name for covariate in found}
    assert not {covariate.name for covariate in found} & {"rate_i", "force_i"}


@pytest.mark.slow
def test_the_derivative_through_the_differential_equation(servo):
    """Against central differences of two steps, extrapolated, to a part in a million of each column."""
    model, mode, _ = servo
    steps = np.array([2e-2, 1e-2])
    away = np.concatenate([steps, -steps])[:, None, None] * np.eye(len(mode.z))
    ends = predict_many(model.problem, (np.asarray(mode.z) + away).reshape(-1, len(mode.z)))
    ahead, behind = np.split(ends.reshape(4, len(mode.z), -1), 2)
    slopes = (ahead - behind) / (2 * steps[:, None, None])
    extrapolated, jacobian = (4 * slopes[1] - slopes[0]) / 3, np.asarray(mode.about.jacobian).T
    for name, found, expected in zip(model.layout.names, jacobian, extrapolated, strict=True):
        assert np.abs(expected - found).max() < 1e-6 * np.abs(found).max(), name


@pytest.mark.slow
def test_the_quarter_of_a_day_is_followed_as_well_as_the_day(servo):
    model, mode, _ = servo
    misfit = np.asarray(mode.about.misfit)
    for run in range(2):
        own = misfit[np.asarray(model.entries.run) == run] * 3600
        assert np.std(own) == pytest.approx(1.0, rel=0.06), "arcsec, the noise of the encoder"


def test_beside_a_reference_the_joint_fit_uses_more_than_matched_instants():
    model, mode, truth = fitted("reference-gyro")
    sd = np.sqrt(np.diag(np.linalg.inv(np.asarray(posterior_precision(model.problem, mode)))))
    textbook = {one.name: one for one in classical(model.campaign) if isinstance(one, Estimate)}
    gains = []
    for axis in "xyz":
        place = model.layout.index(f"gyro_scale_factor.scale[g{axis}]")
        found = float(mode.z[place]) * model.layout.parameters[place].prior.sd() * 1e6
        joint = sd[place] * model.layout.parameters[place].prior.sd() * 1e6
        assert abs(found - truth[f"gyro_scale_factor.scale[g{axis}]"]) < 3 * joint
        gains.append(textbook[f"scale_factor[g{axis}]"].sd / 1000 * 1e6 / joint)
    assert np.exp(np.mean(np.log(gains))) > 1.5
