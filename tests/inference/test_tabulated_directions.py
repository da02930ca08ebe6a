"""Weak directions whose marginal is tabulated: exact maps, and the heading of a free tumble."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from imubayes.campaign import load_campaign
from imubayes.inference.laplace_proposal import LaplaceProposal, LogDensity, weigh
from imubayes.inference.nested_laplace import nested_laplace
from imubayes.inference.posterior_mode import find_mode
from imubayes.inference.tabulated_density import tabulate
from imubayes.inference.tabulated_directions import TabulatedDirections
from imubayes.model.bind import bind
from imubayes.model.model_file import read_model
from small_campaign import campaign, spec

ROOT = Path(__file__).parents[2]
KNOTS = np.linspace(-8.0, 8.0, 17)


@pytest.fixture(scope="module")
def shape() -> TabulatedDirections:
    """Two directions of five: one wide and flat, one skewed."""
    heights = np.stack([-0.25 * KNOTS**2 - 0.01 * KNOTS**4, -np.logaddexp(-1.5 * KNOTS, 0.7 * KNOTS)])
    directions = np.linalg.qr(np.random.default_rng(1).normal(size=(5, 2)))[0]
    return TabulatedDirections(directions, tabulate(np.tile(KNOTS, (2, 1)), heights, np.ones(2)))


@pytest.fixture(scope="module")
def factor() -> np.ndarray:
    root = np.random.default_rng(2).normal(size=(5, 5))
    return np.linalg.cholesky(root @ root.T + np.eye(5))


def test_the_map_is_exact(shape: TabulatedDirections, factor):
    """Its inverse gives the vector back, and the density is that of the change of variables."""

    def mapped(normal):
        (there,), (excess,) = shape.shaped(factor[None], normal[None])
        (back,), (same,) = shape.normalised(factor[None], there[None])
        steps = 1e-6 * np.concatenate([np.eye(5), -np.eye(5)])
        around = shape.shaped(np.tile(factor, (10, 1, 1)), normal + steps)[0]
        jacobian = (around[:5] - around[5:]).T / 2e-6
        return there, excess, back, same, np.linalg.slogdet(jacobian)[1]

    for normal in np.random.default_rng(3).normal(size=(40, 5)):
        there, excess, back, same, log_determinant = mapped(normal)
        np.testing.assert_allclose(back, normal, atol=1e-9)
        assert float(same) == pytest.approx(float(excess), abs=1e-12)
        expected = 0.5 * float(there @ there - normal @ normal) - float(log_determinant)
        assert float(excess) == pytest.approx(expected, abs=1e-8)


def test_steps_along_a_direction_have_its_marginal(shape: TabulatedDirections, factor):
    """The step is L⁻ᵀ times the whitened one; what is independent of the first direction keeps its width."""
    normal = np.random.default_rng(4).normal(size=(20_000, 5))
    whitened, _ = shape.shaped(np.tile(factor, (len(normal), 1, 1)), normal)
    covariance = np.linalg.inv(np.asarray(factor @ factor.T))
    first = np.asarray(shape.directions)[:, 0]
    along = (
        np.linalg.solve(np.asarray(factor).T, np.asarray(whitened).T).T @ first / np.sqrt(first @ covariance @ first)
    )
    density = np.exp(-0.25 * np.linspace(-8, 8, 4001) ** 2 - 0.01 * np.linspace(-8, 8, 4001) ** 4)
    wide = np.sqrt(np.average(np.linspace(-8, 8, 4001) ** 2, weights=density))
    assert along.std() == pytest.approx(wide, rel=0.02)
    assert wide > 1.15


@pytest.mark.slow
def test_a_linear_model_has_no_such_direction():
    model = bind(spec("gyro_bias", noise=("white_noise", "run_scatter")), campaign())
    mode = find_mode(model.problem, *(np.zeros(size) for size in model.problem.size))
    assert nested_laplace(model.problem, mode).shape is None


@pytest.mark.slow
def test_the_heading_of_a_free_tumble_has_its_whole_width():
    """Gyros that hardly resolve the Earth rate: the normal marginal, the planted fault, leaves a heavy tail."""
    model = bind(read_model(ROOT / "models" / "desk-imu.toml"), load_campaign(ROOT / "data" / "desk-imu"))
    problem = model.problem
    mode = find_mode(problem, *(np.zeros(size) for size in problem.size))
    approximation = nested_laplace(problem, mode)
    assert approximation.shape is not None
    place = model.layout.names.index("tumble_heading.heading[tumble]")
    assert abs(float(approximation.shape.directions[place, 0])) > 0.9
    plain = replace(approximation, shape=None)
    density = LogDensity(problem, 100)
    good, bad = (weigh(density, LaplaceProposal(each, problem), 4, 500, 0) for each in (approximation, plain))
    assert good is not None
    assert bad is not None
    width = [each.moments()[1][place] / each.points[..., place].std() for each in (good, bad)]
    # The weighted draws are as wide as those of the proposal.
    assert width[0] == pytest.approx(1.0, abs=0.12)
    assert width[1] > 1.18
    assert good.acceptance > bad.acceptance + 0.04
    assert good.largest < bad.largest


@pytest.mark.slow
def test_steps_have_the_covariance_of_stretched_normal_ones(shape: TabulatedDirections, factor):
    """Of exact widths the linear map makes the covariance of the drawn steps; without it, widths are off by a tenth."""
    normal = np.random.default_rng(6).normal(size=(200_000, 5))
    whitened, _ = shape.shaped(np.tile(factor, (len(normal), 1, 1)), normal)
    steps = np.linalg.solve(np.asarray(factor).T, whitened.T)
    plain = np.linalg.inv(np.asarray(factor @ factor.T))
    stretch = shape.stretch(factor)
    predicted, scale = stretch @ plain @ stretch.T, np.sqrt(np.diagonal(plain))
    np.testing.assert_allclose(np.cov(steps) / np.outer(scale, scale), predicted / np.outer(scale, scale), atol=0.02)
    assert np.abs((predicted - plain) / np.outer(scale, scale)).max() > 0.1
