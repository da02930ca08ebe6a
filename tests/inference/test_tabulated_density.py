"""Tabulated densities against SciPy's distributions."""

import numpy as np
import pytest
from scipy import stats

from imubayes.inference.scale_density import scale_probes
from imubayes.inference.tabulated_density import from_normal, log_density, tabulate, to_normal

KNOTS = np.linspace(-8, 8, 33)


def table_of(density, knots: np.ndarray = KNOTS):
    return tabulate(knots[None], density(knots)[None], np.ones(1))


def test_a_skewed_density():
    table = table_of(lambda x: np.maximum(stats.skewnorm.logpdf(x, 3.0), -200.0))
    at = np.array([-0.5, 0.0, 0.7, 1.5, 3.0])
    normal = np.array([np.asarray(to_normal(table, np.array([x])))[0] for x in at])
    np.testing.assert_allclose(stats.norm.cdf(normal), stats.skewnorm.cdf(at, 3.0), atol=5e-3)
    np.testing.assert_allclose(table.sd(), stats.skewnorm.std(3.0), rtol=1e-2)


def test_a_cliff_between_knots_makes_no_maximum() -> None:
    """A scale that the data bound from above: a cubic spline swings up before the fall, and the mass is there."""
    outwards = np.array([0.6, 1.3, 2.0, 2.7, 3.5, 4.5, 6.0, 8.0])
    knots = np.concatenate([-outwards[::-1], [0.0], outwards])

    def density(x: np.ndarray) -> np.ndarray:
        return np.maximum(-0.5 * x**2 - 40.0 * np.maximum(x - 0.5, 0.0) ** 3, -200.0)

    table = table_of(density, knots)
    fine = np.linspace(-8, 8, 4001)
    mass = np.exp(density(fine))
    below = mass[fine < 0].sum() / mass.sum()
    assert stats.norm.cdf(np.asarray(to_normal(table, np.zeros(1)))[0]) == pytest.approx(below, abs=0.03)
    assert np.argmax(table.log_density[0]) == np.argmin(np.abs(table.knots[0]))


@pytest.mark.slow
def test_two_modes_keep_their_masses():
    table = table_of(lambda x: np.logaddexp(np.log(0.8) - 0.5 * (x + 3) ** 2, np.log(0.2) - 0.5 * (x - 3) ** 2))
    u = stats.norm.ppf((np.arange(4000) + 0.5) / 4000)
    draws = np.array([np.asarray(from_normal(table, np.array([each])))[0] for each in u[::20]])
    assert np.mean(draws > 0) == pytest.approx(0.2, abs=0.01)


@pytest.mark.parametrize("normal", [-12.0, -5.0, -1.0, -1e-9, 0.0, 0.3, 4.0, 9.0])
def test_the_map_is_undone_far_out_too(normal):
    table = table_of(lambda x: -0.5 * (x - 1) ** 2 - np.log1p(np.exp(-x)))
    there = from_normal(table, np.array([normal]))
    np.testing.assert_allclose(np.asarray(to_normal(table, there))[0], normal, rtol=1e-6, atol=1e-6)


def test_the_density_is_the_derivative_of_the_map():
    table = table_of(lambda x: -0.5 * np.abs(x) ** 1.5)
    for normal in (-9.0, -2.0, 0.4, 6.0):
        step = 1e-5
        low, high = (float(np.asarray(from_normal(table, np.array([normal + s])))[0]) for s in (-step, step))
        middle = from_normal(table, np.array([normal]))
        expected = stats.norm.logpdf(normal) - np.log((high - low) / (2 * step))
        assert float(np.asarray(log_density(table, middle))[0]) == pytest.approx(expected, abs=1e-4)


def test_scales_are_drawn_about_their_mode_with_the_covariance_of_their_marginal():
    mode, information = np.array([0.5, -1.0]), np.array([[4.0, 3.0], [3.0, 9.0]])
    probes = scale_probes(mode, information)
    away = probes.points - mode
    density = probes.tabulated(-0.5 * np.einsum("ni,ij,nj->n", away, information, away))
    normal = np.random.default_rng(0).normal(size=(20_000, 2))
    steps = density.steps(normal)
    drawn = density.scales(steps)
    np.testing.assert_allclose(drawn.mean(axis=0), mode, atol=0.02)
    np.testing.assert_allclose(np.cov(drawn.T), np.linalg.inv(information), rtol=0.1)
    assert density.scales(np.array([1.0, 0.0]))[0] == pytest.approx(mode[0] + 1.0)
    np.testing.assert_allclose(density.normals(steps), normal, atol=1e-6)
    exact = -0.5 * np.einsum("ni,ij,nj->n", drawn - mode, information, drawn - mode)
    exact += 0.5 * np.log(np.linalg.det(information)) - np.log(2 * np.pi)
    assert np.median(np.abs(density.log_density(steps) - exact)) < 0.02
