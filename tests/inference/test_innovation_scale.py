"""Proposals for correlated noise: the ridge of its scale and correlation is straight, and no tail is missed."""

import functools
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
import pytest

from imubayes.campaign import load_campaign
from imubayes.inference.nested_laplace import NestedLaplace, nested_laplace, to_normals, to_points
from imubayes.inference.posterior_mode import Mode, find_mode
from imubayes.model.bind import Model, bind
from imubayes.model.model_file import read_model

ROOT = Path(__file__).parents[2]
DRAWS = 2000


@functools.cache
def made() -> tuple[Model, Mode, NestedLaplace]:
    model = bind(read_model(ROOT / "models/static-record.toml"), load_campaign(ROOT / "data/static-record"))
    mode = find_mode(model.problem, *(np.zeros(size) for size in model.problem.size))
    return model, mode, nested_laplace(model.problem, mode)


@functools.cache
def normals() -> np.ndarray:
    return np.random.default_rng(0).normal(size=(DRAWS, sum(made()[0].problem.size)))


def points(proposal: NestedLaplace) -> tuple[np.ndarray, np.ndarray]:
    return to_points(proposal, made()[0].problem, normals())


def effective_share(proposal: NestedLaplace) -> float:
    """Return the effective number of weighted draws of a proposal, as a share."""
    drawn, density = points(proposal)
    log_weight = np.asarray(jax.jit(jax.vmap(made()[0].log_density))(drawn) - density)
    weight = np.exp(log_weight - log_weight.max())
    return float(weight.sum() ** 2 / np.sum(weight**2) / DRAWS)


@pytest.mark.slow
def test_nearly_every_proposal_counts():
    assert effective_share(made()[2]) > 0.9


@pytest.mark.slow
def test_without_the_ridge_proposals_miss_tails():
    bent = replace(made()[2], ridge=None)
    assert effective_share(bent) < 0.5


@pytest.mark.slow
def test_a_point_and_its_standard_normal_vector_belong_together():
    problem, proposal = made()[0].problem, made()[2]
    drawn, density = points(proposal)
    back, again = to_normals(proposal, problem, drawn)
    np.testing.assert_allclose(back, normals(), atol=1e-9)
    np.testing.assert_allclose(again, density, atol=1e-9)


@pytest.mark.slow
def test_the_scale_of_the_innovations_is_the_same_along_the_ridge():
    model, mode, proposal = made()
    names = [str(name) for name in model.parameter_names][model.problem.size[0] :]
    scale, correlation = names.index("white_noise.sigma[gz]"), names.index("correlated_noise.correlation[gz]")
    innovations = []
    for step in (-1.0, 0.0, 0.5):
        h = proposal.scales(model.problem, mode.h + step * (np.arange(len(mode.h)) == correlation))
        values = model.problem.hyper_priors.values(h)
        innovations.append(float(values[scale] * np.sqrt(1 - values[correlation] ** 2)))
        assert h[correlation] == mode.h[correlation] + step
    np.testing.assert_allclose(innovations, innovations[1], rtol=1e-9)
