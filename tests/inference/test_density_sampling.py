"""`imubayes.sample`: the sampler on a log density of the user's own."""

import arviz_plots
import matplotlib.pyplot as plt
import numpy as np
import pytest

import imubayes
from imubayes.errors import InputError
from imubayes.inference.convergence import nested_r_hat

COVARIANCE = np.array([[4.0, 1.2], [1.2, 1.0]])
MEAN = np.array([10.0, -3.0])


def log_normal(points: np.ndarray) -> np.ndarray:
    """Return the log density of a correlated normal."""
    away = points - MEAN
    return -0.5 * np.einsum("ni,ij,nj->n", away, np.linalg.inv(COVARIANCE), away)


@pytest.fixture(scope="module")
def samples(tmp_path_factory):
    file = tmp_path_factory.mktemp("own") / "checkpoint.h5"
    return imubayes.sample(log_normal, [9.0, -2.0], [2.0, 1.0], ["a", "b"], checkpoint=file), file


def test_mean_and_covariance_are_found(samples):
    found, _ = samples
    assert found.converged, found.message
    error = 1 / np.sqrt(found.chains.diagnosis.ess_bulk.min())
    assert np.all(np.abs(found.draws.mean(axis=0) - MEAN) < 4 * error * np.sqrt(np.diag(COVARIANCE)))
    np.testing.assert_allclose(np.cov(found.draws.T), COVARIANCE, rtol=0.25)


def test_the_tree_has_a_variable_per_name(samples):
    found, _ = samples
    posterior = found.posterior.posterior
    assert set(posterior.data_vars) == {"a", "b"}
    np.testing.assert_allclose(posterior["a"].mean(), found.draws[:, 0].mean())
    ensembles, steps, walkers, _ = found.chains.points.shape
    assert posterior["a"].shape == found.posterior.sample_stats["lp"].shape == (ensembles, walkers * steps)
    assert np.all(nested_r_hat(found.chains.points) < 1.01)
    arviz_plots.plot_dist(found.posterior)
    plt.close("all")


def test_a_checkpoint_is_continued_and_one_of_other_names_refused(samples):
    found, file = samples
    again = imubayes.sample(log_normal, [9.0, -2.0], [2.0, 1.0], ["a", "b"], checkpoint=file, resume=True)
    np.testing.assert_array_equal(again.chains.points, found.chains.points)
    with pytest.raises(InputError, match="of another fit"):
        imubayes.sample(log_normal, [9.0, -2.0], names=["a", "c"], checkpoint=file, resume=True)


@pytest.mark.parametrize(
    ("density", "names", "complaint"),
    [
        (log_normal, ["a"], "1 names for 2 parameters"),
        (lambda points: 0.0, [], "has shape"),
        (lambda points: np.full(len(points), -np.inf), [], "not finite"),
    ],
)
def test_what_cannot_be_sampled_is_refused(density, names, complaint):
    with pytest.raises(InputError, match=complaint):
        imubayes.sample(density, [0.0, 0.0], names=names)
