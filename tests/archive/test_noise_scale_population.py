"""The population of a noise scale: bounded by many units that do not determine it, and found if they do."""

import numpy as np
import pytest

from imubayes_archive.population.noise_scale_population import ScaleLikelihoods, scale_population

PRIOR = (-0.6, 1.1)


def likelihoods(scatter: np.ndarray, noise: float, pairs: int, seed: int) -> ScaleLikelihoods:
    """Return the likelihoods of units whose runs differ by a scatter and by noise, from `pairs` differences each."""
    random = np.random.default_rng(seed)
    grid = np.tile(np.linspace(-6.0, 2.0, 60), (len(scatter), 1))
    differences = random.normal(0, np.sqrt(2 * scatter**2 + noise**2), (pairs, len(scatter)))
    variance = 2 * np.exp(2 * grid)[None] + noise**2
    rows = np.sum(-0.5 * differences[:, :, None] ** 2 / variance - 0.5 * np.log(variance), axis=0)
    return ScaleLikelihoods.of(grid, rows, PRIOR)


def test_scales_that_single_units_do_not_determine_are_known_from_all():
    values = []
    for seed in range(6):
        found = scale_population(likelihoods(np.full(12, 0.3), 0.05, 1, seed), PRIOR)
        mean, sd = found.posterior.of_centre()
        assert sd < 0.4
        values.append((mean - np.log(0.3)) / sd)
    assert np.sqrt(np.mean(np.square(values))) < 1.8


def test_a_scatter_below_the_noise_is_bounded_from_above_alone():
    found = scale_population(likelihoods(np.full(12, 1e-3), 0.1, 1, 3), PRIOR)
    mean, sd = found.posterior.of_centre()
    assert mean < np.log(0.1)
    assert sd > 0.3  # nothing bounds it from below but its prior


def test_units_differ_if_their_scatter_does():
    scatter = np.exp(np.random.default_rng(5).normal(-1.0, 0.4, 40))
    found = scale_population(likelihoods(scatter, 0.02, 12, 5), PRIOR)
    spread, sd = found.posterior.of_scale()
    assert spread == pytest.approx(0.4, abs=3 * sd)
    z = (found.mean - np.log(scatter)) / found.sd
    assert np.sqrt(np.mean(z**2)) == pytest.approx(1.0, abs=0.3)


def test_the_prior_of_a_unit_does_not_hold_its_own_data():
    scatter = np.full(12, 0.1)
    scatter[0] = 3.0
    found = scale_population(likelihoods(scatter, 0.02, 3, 0), PRIOR)
    assert found.others_mean[0] < np.log(0.4)
    assert found.mean[0] > found.others_mean[0] + 1
