"""Monte Carlo errors of standard deviations and intervals against their scatter over replicates of known densities."""

import numpy as np
import pytest
from arviz_stats.base.array import array_stats

from imubayes.inference.convergence import (
    END_BAR,
    INTERVAL,
    MOST_CHANCE,
    SD_BAR,
    ChainErrors,
    end_errors,
    monte_carlo_errors,
    normal_length,
)

WALKERS, STEPS, REPLICATES = 40, 100, 300


def normal(random: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    return random.normal(size=shape)


def student(random: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    return random.standard_t(6, size=shape)


def skewed(random: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    return random.gamma(2.0, size=shape)


def correlated(random: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    """AR(1) along the steps, of correlation 0.6, begun in equilibrium."""
    found = random.normal(size=shape)
    for step in range(1, shape[-1]):
        found[..., step] = 0.6 * found[..., step - 1] + 0.8 * found[..., step]
    return found


@pytest.mark.parametrize("draw", [normal, student, skewed, correlated])
def test_errors_are_the_scatter_over_replicates(draw):
    many = draw(np.random.default_rng(1), (REPLICATES, WALKERS, STEPS))
    flat = many.reshape(REPLICATES, -1)
    spread = flat.std()
    of_sd = flat.std(axis=1).std() / spread
    of_ends = np.quantile(flat, INTERVAL, axis=1).std(axis=1) / spread
    some = np.moveaxis(many[:10], 0, -1)
    tail = [array_stats.ess(each, chain_axis=0, draw_axis=1, method="tail", prob=INTERVAL) for each in many[:10]]
    errors = monte_carlo_errors(some, np.array(tail))
    assert np.median(errors.sd) == pytest.approx(of_sd, rel=0.15)
    np.testing.assert_allclose(np.median(errors.end, axis=0), of_ends, rtol=0.25)
    # Normal tails taken for granted, the planted fault, miss those of Student's t.
    if draw is student:
        assert 1 / np.sqrt(2 * flat.shape[1]) < 0.8 * of_sd


def test_the_length_for_normal_parameters_is_what_their_errors_ask_for():
    """D parameters at that length have the probability that is allowed."""
    for dimensions in (1, 40, 500):
        count = normal_length(dimensions)
        draws = np.random.default_rng(2).normal(size=(100_000, 1))
        end = end_errors(draws, np.array([count]))
        sd = np.full(dimensions, 1 / np.sqrt(2 * count))
        errors = ChainErrors(sd, np.repeat(end, dimensions, axis=0))
        assert errors.longer() == pytest.approx(1.0, abs=0.15)
        assert errors.chance_beyond(errors.longer()) == pytest.approx(MOST_CHANCE, rel=1e-3)


def test_the_length_that_is_asked_for_keeps_the_bars():
    """Mixtures of normal distributions of kurtosis 19, as of a bias under an unknown scatter between runs."""

    def mixture(random: np.random.Generator, count: int) -> np.ndarray:
        return random.normal(size=count) * np.exp(0.68 * random.normal(size=count))

    random = np.random.default_rng(3)
    first = mixture(random, 12_000)
    effective = np.array([12_000.0])
    errors = monte_carlo_errors(first.reshape(120, 100, 1), effective)
    assert errors.sd[0] > 2.2 / np.sqrt(2 * 12_000)
    count = int(12_000 * errors.longer())
    assert count > 15_000
    true_sd, true_end = np.exp(0.68**2), np.quantile(mixture(random, 2_000_000), 0.975)
    long = [mixture(random, count) for _ in range(100)]
    beyond = [
        abs(each.std() / true_sd - 1) > SD_BAR or abs(np.quantile(each, 0.975) - true_end) > END_BAR * true_sd
        for each in long
    ]
    assert np.mean(beyond) <= 0.04
    # A fifth of the length, the planted fault, breaks them.
    short = [each[: count // 5] for each in long]
    assert np.mean([abs(each.std() / true_sd - 1) > SD_BAR for each in short]) > 0.1


def test_the_worst_interval_is_named():
    exact = ChainErrors(np.array([0.01, 0.03]), np.array([[0.01, 0.01], [0.02, 0.02]]))
    assert exact.inexact_ends(("a", "b")) == []
    inexact = ChainErrors(np.array([0.01, 0.01]), np.array([[0.01, 0.05], [0.02, 0.02]]))
    words = "the Monte Carlo error of the 95 % interval of a is 0.05 of its standard deviation"
    assert inexact.inexact_ends(("a", "b")) == [words]
