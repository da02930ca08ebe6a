"""`imubayes.sample`: the sampler on a log density of the user's own."""

import arviz_plots
import emcee
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import pytest

import imubayes
from imubayes.foundations.errors import InputError
from imubayes.inference.convergence import nested_r_hat
from imubayes.inference.density_mode import differentiable, normal_about_mode
from imubayes.inference.ensemble_sampling import Settings, without_strays

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


YEARS = np.arange(1952.0, 2014.0)
TEMPERATURES = -60 + 0.035 * YEARS + 1.1 * np.random.default_rng(5).normal(size=len(YEARS))


def log_ridge(point, xp=jnp):
    """Return the log density of intercept, slope and log σ of a line far from the origin; points (…, 3)."""
    scatter = xp.exp(point[..., 2:])
    away = (TEMPERATURES - point[..., :1] - point[..., 1:2] * YEARS) / scatter
    return -0.5 * xp.sum(away**2, axis=-1) - len(YEARS) * point[..., 2]


RIDGE = ([-60.0, 0.035, 0.1], [15.0, 0.0075, 0.1], ["intercept", "slope", "log_sd"])


def require_ridge(found):
    """Require the exact marginal of the slope: Student's t with n − 2 degrees of freedom for a flat prior of log σ."""
    assert found.converged, found.message
    centred = YEARS - YEARS.mean()
    slope = centred @ TEMPERATURES / (centred @ centred)
    residual = TEMPERATURES - TEMPERATURES.mean() - slope * centred
    freedom = len(YEARS) - 2
    sd = np.sqrt(residual @ residual / (centred @ centred) / (freedom - 2))
    draws = found.draws[:, 1]
    np.testing.assert_allclose((draws.mean(), draws.std()), (slope, sd), atol=0.15 * sd)
    assert np.exp(found.draws[:, 2]).max() < 3


@pytest.mark.slow
def test_a_ridge_is_sampled_from_its_mode_and_covariance():
    require_ridge(imubayes.sample(jax.jit(jax.vmap(log_ridge)), *RIDGE))


@pytest.mark.slow
def test_a_ridge_that_jax_cannot_differentiate_leaves_no_walker_behind():
    require_ridge(imubayes.sample(lambda points: log_ridge(points, np), *RIDGE))


@pytest.mark.parametrize("dimensions", [10, *(pytest.param(each, marks=pytest.mark.slow) for each in (2, 50))])
def test_normal_densities_converge(dimensions):
    scale = np.arange(1.0, dimensions + 1)
    found = imubayes.sample(lambda points: -0.5 * ((points / scale[None]) ** 2).sum(axis=1), 0.3 * scale, scale)
    assert found.converged, found.message
    np.testing.assert_allclose(found.draws.mean(axis=0) / scale, 0, atol=0.05)
    np.testing.assert_allclose(found.draws.std(axis=0) / scale, 1, atol=0.05)


def log_funnel(points):
    """Return the log density of Neal's funnel in ten dimensions; its neck is a thousandth as wide as its mouth."""
    neck = points[:, :1]
    return -(neck[:, 0] ** 2) / 18 - 0.5 * (points[:, 1:] ** 2 * jnp.exp(-neck)).sum(axis=1) - 4.5 * neck[:, 0]


def log_banana(points):
    """Return the log density of a normal one that is bent along a parabola (Haario et al. 1999)."""
    return -0.5 * (points[:, 0] ** 2 / 100 + (points[:, 1] + 0.1 * points[:, 0] ** 2 - 10) ** 2)


SHAPES = pytest.mark.parametrize(
    ("density", "start", "scale"),
    [(log_funnel, np.zeros(10), 3.0), (log_banana, [0.0, 10.0], [10.0, 14.0])],
    ids=["funnel", "banana"],
)


@pytest.mark.slow
@SHAPES
def test_shapes_that_the_moves_cannot_follow_do_not_converge(density, start, scale):
    """NumPy tells no gradient."""
    found = imubayes.sample(
        lambda points: np.asarray(density(points)), start, scale, settings=Settings(most_steps=1200)
    )
    assert not found.converged


@pytest.mark.slow
@SHAPES
def test_gradients_follow_shapes_that_the_moves_cannot(density, start, scale):
    found = imubayes.sample(jax.jit(density), start, scale, settings=Settings(most_steps=15_000))
    assert found.converged, found.message
    first, true = found.draws[:, 0], 3.0 if density is log_funnel else 10.0
    # Four standard errors at the 400 effective draws of a verdict.
    assert abs(first.mean()) < 0.2 * true
    assert first.std() == pytest.approx(true, rel=0.15)
    # The neck, which ensemble moves never enter, and the ends of the banana.
    assert np.mean(first < -5 / 3 * true) == pytest.approx(0.0478, abs=0.02)


@pytest.mark.slow
def test_gradient_moves_keep_a_density_and_resume(tmp_path):
    """A funnel of two parameters: the share of its neck, and a chain that goes on where it was interrupted."""
    log_density = jax.jit(lambda x: -(x[:, 0] ** 2) / 18 - 0.5 * x[:, 1] ** 2 * jnp.exp(-x[:, 0]) - 0.5 * x[:, 0])
    file = tmp_path / "chain.h5"
    part, whole = Settings(least_steps=300, most_steps=300), Settings(least_steps=600, most_steps=600)
    imubayes.sample(log_density, [0.0, 0.0], 3.0, settings=part, checkpoint=file)
    told = []
    found = imubayes.sample(
        log_density, [0.0, 0.0], 3.0, settings=whole, checkpoint=file, resume=True, progress=told.append
    )
    assert int(told[0].split()[2]) > 300
    assert np.mean(found.draws[:, 0] < -5) == pytest.approx(0.0478, abs=0.03)
    assert found.draws[:, 0].std() == pytest.approx(3, rel=0.2)


@pytest.mark.slow
def test_two_modes_within_the_starts_are_both_sampled():
    def density(points):
        return jnp.logaddexp(-0.5 * (points**2).sum(axis=1), -0.5 * ((points - 5) ** 2).sum(axis=1))

    about = np.zeros(2), np.ones(2)
    assert normal_about_mode(differentiable(density, *about), *about) is not None
    found = imubayes.sample(jax.jit(density), [0.0, 0.0])
    assert found.converged, found.message
    assert 0.4 < np.mean(found.draws[:, 0] > 2.5) < 0.6
    assert "a mode that no walker came near" in found.blind_to


def test_the_normal_about_a_mode_has_its_covariance():
    precision = jnp.asarray(np.linalg.inv(COVARIANCE))

    def density(points):
        away = points - MEAN[None]
        return -0.5 * jnp.einsum("ni,ij,nj->n", away, precision, away)

    about = MEAN + 30, np.array([100.0, 0.01])
    laplace = normal_about_mode(differentiable(density, *about), *about)
    np.testing.assert_allclose(laplace.centre, MEAN, atol=1e-6)
    np.testing.assert_allclose(laplace.axes @ laplace.axes.T, COVARIANCE, rtol=1e-6)
    normal = np.random.default_rng(0).normal(size=(5, 2))
    points, height = laplace.to_point(normal)
    np.testing.assert_allclose(laplace.to_normal(points)[0], normal, atol=1e-9)
    np.testing.assert_allclose(np.ptp(height - np.asarray(density(points))), 0, atol=1e-6)
    assert differentiable(log_normal, MEAN, np.ones(2)) is None


def test_only_walkers_that_stay_far_below_are_drawn_anew():
    random = np.random.RandomState(0)
    height = -random.chisquare(2, size=(15, 64))
    height[:, 3], height[:-1, 5] = -300, -300
    state = emcee.State(random.normal(size=(64, 2)), log_prob=height[-1].copy(), random_state=random.get_state())
    found = without_strays(state, height)
    moved = np.flatnonzero(np.any(found.coords != state.coords, axis=1))
    assert moved.tolist() == [3]
    assert np.any(np.all(state.coords == found.coords[3], axis=1))
    assert found.log_prob[3] > -50
