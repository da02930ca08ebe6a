"""Noise that remembers: the filter against the dense covariance, and share and correlation found again."""

import numpy as np
import pytest

from imubayes.adequacy.gauss_markov import GRID, WHITE, InnovationsFilter, MarkovNoise, restricted_log_likelihoods

SERIES = np.array([[0, 1, 2, 3, 4], [5, 6, 7, 9, 9], [8, 9, 9, 9, 9]])


def covariance(count, memory):
    apart = np.abs(np.subtract.outer(np.arange(count), np.arange(count)))
    return memory.share * memory.correlation**apart + (1 - memory.share) * np.eye(count)


@pytest.mark.parametrize("memory", [MarkovNoise(0.5, 0.8), MarkovNoise(1.0, 0.6), MarkovNoise(0.2, 0.95)])
def test_innovations_are_the_cholesky_solution_of_each_record(memory):
    columns = np.random.default_rng(1).normal(size=(9, 4))
    by = InnovationsFilter(SERIES, np.full(3, memory.share), np.full(3, memory.correlation))
    white, log_determinant = by.filtered(columns)
    expected, total = np.empty_like(columns), 0.0
    for row in SERIES:
        own = row[row < 9]
        dense = covariance(len(own), memory)
        expected[own] = np.linalg.solve(np.linalg.cholesky(dense), columns[own])
        total += np.linalg.slogdet(dense)[1]
    np.testing.assert_allclose(white, expected, atol=1e-12)
    assert log_determinant == pytest.approx(total, abs=1e-12)


def test_what_does_not_remember_stays_as_it_is():
    columns = np.random.default_rng(1).normal(size=(9, 4))
    by = InnovationsFilter(SERIES, np.zeros(3), np.zeros(3))
    np.testing.assert_array_equal(by(columns), columns)


def found(memory, seed, runs=12, rows=60):
    """The memory found in residuals of a linear model with an offset, a line and a parabola, run by run."""
    random = np.random.default_rng(seed)
    root = np.linalg.cholesky(covariance(rows, memory))
    noise = (root @ random.normal(size=(rows, runs))).T.reshape(-1)
    time = np.tile(np.linspace(-1, 1, rows), runs)
    basis, _ = np.linalg.qr(np.stack([time**power for power in range(3)], axis=1))
    series = np.arange(runs * rows).reshape(-1, rows)
    return GRID[int(np.argmax(restricted_log_likelihoods(noise - basis @ (basis.T @ noise), basis, series)))]


@pytest.mark.parametrize("memory", [MarkovNoise(0.5, 0.8), MarkovNoise(1.0, 0.5)])
def test_share_and_correlation_are_found_again(memory):
    """What matters of them is the noise at low frequency: 1 − c + c·(1 + φ)/(1 − φ)."""

    def slow(one):
        return 1 - one.share + one.share * (1 + one.correlation) / (1 - one.correlation)

    assert np.median([slow(found(memory, seed)) for seed in range(6)]) == pytest.approx(slow(memory), rel=0.35)


def test_white_noise_is_found_to_forget():
    each = [found(WHITE, seed) for seed in range(6)]
    assert np.median([one.share * one.correlation for one in each]) < 0.08
