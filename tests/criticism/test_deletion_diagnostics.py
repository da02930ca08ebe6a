"""Runs left out, against least squares by brute force with the whole covariance."""

from dataclasses import replace

import numpy as np
import pytest

from imubayes.adequacy.deletion_diagnostics import LinearFit, WeightedFit, disagreeing_runs

RUNS, ROWS, CHANNELS, PARAMETERS = 5, 8, 2, 4
SCATTER = 0.7


def places() -> tuple[np.ndarray, np.ndarray]:
    """Return run and channel of each output."""
    run, _, channel = np.meshgrid(np.arange(RUNS), np.arange(ROWS), np.arange(CHANNELS), indexing="ij")
    return run.ravel(), channel.ravel()


def covariance(run: np.ndarray, channel: np.ndarray) -> np.ndarray:
    """White noise and an offset of each run and channel, which all rows of it share."""
    group = run * CHANNELS + channel
    return np.diag(np.where(channel == 0, 1.0, 2.0)) + SCATTER**2 * (group[:, None] == group[None, :])


def drawn(seed: int) -> tuple[LinearFit, np.ndarray]:
    """Return a model with data drawn from its own prior and noise, and the covariance."""
    random, (run, channel) = np.random.default_rng(seed), places()
    sigma = covariance(run, channel)
    jacobian = random.normal(size=(len(run), PARAMETERS))
    misfit = jacobian @ random.normal(size=PARAMETERS) + np.linalg.cholesky(sigma) @ random.normal(size=len(run))
    inverse = np.linalg.inv(sigma)
    return LinearFit(
        jacobian, misfit, inverse @ jacobian, inverse @ misfit, np.ones(PARAMETERS), np.zeros(PARAMETERS),
        run, channel, np.ones(len(run), dtype=bool),
    ), sigma  # fmt: skip


def without(linear: LinearFit, run: int) -> WeightedFit:
    return linear.fit(linear.whole - linear.of_run(run))


def chi2_of(linear: LinearFit, sigma: np.ndarray, kept: np.ndarray) -> float:
    """Return the least χ² with the parameters integrated out."""
    whole = (sigma + linear.jacobian @ linear.jacobian.T)[np.ix_(kept, kept)]
    lower = np.linalg.cholesky(whole)
    left = np.linalg.solve(lower, linear.misfit[kept])
    return float(left @ left)


def test_the_whole_and_each_run_left_out_have_the_chi2_of_brute_force() -> None:
    linear, sigma = drawn(1)
    every = np.ones(len(linear.misfit), dtype=bool)
    assert linear.fit(linear.whole).chi2 == pytest.approx(chi2_of(linear, sigma, every))
    for run in range(RUNS):
        assert without(linear, run).chi2 == pytest.approx(chi2_of(linear, sigma, linear.run != run))


def test_the_noise_of_a_channel_is_that_which_its_rows_show() -> None:
    """χ² over degrees of freedom, at least 1; twice the noise is four times the variance."""
    linear, sigma = drawn(2)
    assert linear.fit(linear.whole).noise_ratios == pytest.approx(np.ones(CHANNELS), abs=0.6)
    random = np.random.default_rng(3)
    more = np.where(linear.channel == 1, np.sqrt(3 * 2.0) * random.normal(size=len(linear.misfit)), 0.0)
    louder = replace(linear, misfit=linear.misfit + more, pulled=np.linalg.solve(sigma, linear.misfit + more))
    ratios = louder.fit(louder.whole).noise_ratios
    assert 2 < ratios[1] < 6
    assert ratios[0] < 2
    # A run does not count among its others.
    assert without(louder, 0).equations.count.tolist() == [(RUNS - 1) * ROWS] * CHANNELS


def test_degrees_of_freedom_are_outputs_less_parameters() -> None:
    linear, _ = drawn(5)
    linear = replace(linear, precision=np.full(PARAMETERS, 1e-9))
    assert linear.fit(linear.whole).freedom.sum() == pytest.approx(len(linear.misfit) - PARAMETERS, abs=1e-4)


def test_no_run_disagrees_by_chance_and_a_changed_one_does() -> None:
    """P-values of 200 sound campaigns are those of chance; a change of three standard deviations in a run is found."""
    sound = [min(disagreeing_runs(drawn(seed)[0]).values()) for seed in range(200)]
    # Bonferroni over the runs, and noise that the others show if it is larger, both on the safe side.
    assert np.mean(np.array(sound) < np.log(0.05)) < 0.08
    assert min(sound) > np.log(1e-4)
    linear, sigma = drawn(8)
    random = np.random.default_rng(9)
    change = np.where(linear.run == 3, 3 * random.normal(size=len(linear.misfit)), 0.0)
    changed = replace(linear, misfit=linear.misfit + change, pulled=np.linalg.solve(sigma, linear.misfit + change))
    found = disagreeing_runs(changed)
    assert min(found, key=lambda run: found[run]) == 3
    assert found[3] < np.log(1e-5)
    # The others still agree, and none of them is blamed.
    assert all(found[run] > np.log(0.01) for run in found if run != 3)


def test_where_all_runs_scatter_no_run_is_blamed() -> None:
    """The noise that the others show is what a run is judged at: something is missing in the model, and no run is."""
    linear, sigma = drawn(10)
    more = linear.misfit + 5 * np.random.default_rng(11).normal(size=len(linear.misfit))
    scattered = replace(linear, misfit=more, pulled=np.linalg.solve(sigma, more))
    assert min(disagreeing_runs(scattered).values()) > np.log(0.01)
