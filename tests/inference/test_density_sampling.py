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
from imubayes.inference.chains import Settings
from imubayes.inference.convergence import nested_r_hat
from imubayes.inference.density_mode import NormalProposal, differentiable, normal_about_mode
from imubayes.inference.density_proposal import agrees, finite_starts
from imubayes.inference.ensemble_sampling import without_strays
from imubayes.inference.laplace_proposal import weigh
from imubayes.inference.user_function import CountedDensity, of_many_points

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
    """NumPy gives no gradient."""
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


def two_modes(point):
    """Return the log density of modes 10 sd apart in five dimensions, of 0.3 and 0.7 of the mass; one point (5,)."""
    first, rest = point[0], jnp.sum(point[1:] ** 2)
    low, high = jnp.log(0.3) - 0.5 * (first + 5) ** 2, jnp.log(0.7) - 0.5 * (first - 5) ** 2
    return jnp.logaddexp(low, high) - 0.5 * rest


@pytest.mark.parametrize("start", [1.0, pytest.param(-2.0, marks=pytest.mark.slow)])
def test_a_start_between_two_modes_finds_both_with_their_shares(start):
    """From here Newton steps lead to one mode, whose normal distribution holds all that its own draws see."""
    about = np.array([start, 0, 0, 0, 0]), np.full(5, 5.0)
    batched = jax.jit(jax.vmap(two_modes))
    laplace = normal_about_mode(differentiable(batched, *about), *about)
    assert abs(laplace.centre[0]) == pytest.approx(5, abs=1e-3)
    judged = weigh(lambda points: np.asarray(batched(points)), laplace, 4, 1000, 0)
    assert judged.acceptance > 0.99
    assert judged.largest < 2
    found = imubayes.sample(batched, *about)
    assert found.converged, found.message
    assert np.mean(found.draws[:, 0] < 0) == pytest.approx(0.3, abs=0.02)


def test_walkers_where_a_proposal_never_comes_are_against_it():
    def density(points):
        return -0.5 * (points**2).sum(axis=1)

    found = weigh(density, NormalProposal(np.zeros(5), np.eye(5)), 4, 1000, 0)
    walkers = np.random.default_rng(0).normal(size=(64, 5))
    assert agrees(found, walkers, density(walkers))
    # A second mode as high as the first, for three of them; if it is as low as the proposal they say nothing.
    walkers[:3, 0] += 10
    assert not agrees(found, walkers, np.where(walkers[:, 0] > 5, 0.0, density(walkers)))
    assert agrees(found, walkers, density(walkers))


def log_exponentials(points):
    """Return the log density of independent exponentials, with a hard edge at zero."""
    return jnp.where(jnp.all(points > 0, axis=1), -points.sum(axis=1), -jnp.inf)


def test_starts_are_where_the_density_is():
    """Beside an edge in five directions one start in thirty has a density; walkers do not leave the others."""
    density = CountedDensity(lambda points: np.asarray(log_exponentials(points)), 10**6)
    wide = NormalProposal(np.full(5, 0.01), 3 * np.eye(5))
    starts = finite_starts(density, wide, 64, 4, [0])
    assert [start.shape for start in starts] == 4 * [(64, 5)]
    assert np.isfinite(density(np.concatenate(starts))).all()
    assert len(np.unique(np.concatenate(starts), axis=0)) > 100
    assert density.used < 20 * 256
    assert finite_starts(CountedDensity(lambda points: np.full(len(points), -np.inf), 10**6), wide, 64, 4, [0]) == []


@pytest.mark.slow
def test_hard_edges_are_sampled():
    found = imubayes.sample(jax.jit(log_exponentials), np.ones(5), 1.0)
    assert found.converged, found.message
    assert found.evaluations <= found.most_evaluations
    np.testing.assert_allclose(found.draws.mean(axis=0), 1, atol=0.05)
    np.testing.assert_allclose(found.draws.std(axis=0), 1, atol=0.07)
    np.testing.assert_allclose(np.mean(found.draws < 0.0513, axis=0), 0.05, atol=0.01)


def regression(seed=3, rows=46):
    """Return the logarithms of seven measures of a shrub, collinear as those of mesquites are, and of its weight."""
    random = np.random.default_rng(seed)
    size = random.normal(size=(rows, 1))
    measures = size + 0.3 * random.normal(size=(rows, 5))
    design = np.concatenate([np.ones((rows, 1)), measures, random.integers(2, size=(rows, 1))], axis=1)
    return design, design @ np.array([5.0, 0.4, 1.1, 0.4, 0.4, 0.1, -0.6]) + 0.33 * random.normal(size=rows)


@pytest.mark.slow
def test_a_regression_of_eight_parameters_with_a_flat_scatter_has_its_exact_posterior():
    """Flat σ: coefficients are t distributed with n − p − 1 degrees of freedom about the least squares ones."""
    design, observed = regression()
    rows, columns = design.shape

    def density(point):
        away = (observed - design @ point[:-1]) / point[-1]
        return jnp.where(point[-1] > 0, -0.5 * away @ away - rows * jnp.log(point[-1]), -jnp.inf)

    normal = np.linalg.inv(design.T @ design)
    exact = normal @ design.T @ observed
    left = observed - design @ exact
    freedom = rows - columns - 1
    sd = np.sqrt(np.diag(normal) * (left @ left) / freedom * freedom / (freedom - 2))
    start, scale = np.append(exact + sd, 0.4), np.append(sd, 0.05)
    found = imubayes.sample(density, start, scale)
    assert found.converged, found.message
    assert found.evaluations < 300_000
    np.testing.assert_allclose((found.draws[:, :-1].mean(axis=0) - exact) / sd, 0, atol=0.06)
    np.testing.assert_allclose(found.draws[:, :-1].std(axis=0) / sd, 1, atol=0.05)


def test_a_budget_that_is_used_up_is_said_and_is_no_convergence():
    told = []

    def spike_and_slab(points):
        return np.logaddexp(-0.5 * (points**2).sum(axis=1), 46 - 0.5e4 * ((points - 3) ** 2).sum(axis=1))

    found = imubayes.sample(spike_and_slab, np.zeros(10), most_evaluations=80_000, progress=told.append)
    assert not found.converged
    assert found.most_evaluations == 80_000
    assert 70_000 < found.evaluations < 90_000
    assert "the budget was used up" in found.message
    assert "`most_evaluations`" in found.message
    assert "of 80000 evaluations" in told[-1]
    assert any("from the start" in line for line in told)
    with pytest.raises(InputError, match="allow no chain"):
        imubayes.sample(log_normal, [9.0, -2.0], most_evaluations=1000)


def branching(point):
    if point[0] < 0:
        return -float("inf")
    return -float(point[0] + 0.5 * point[1] ** 2)


@pytest.mark.parametrize(
    "single",
    [
        lambda point: -0.5 * (point[0] ** 2 + point[1] ** 2),
        lambda point: -0.5 * jnp.sum(point**2),
        lambda point: -0.5 * np.dot(point, point),
        lambda point: next(-0.5 * (a * a + b * b) for a, b in [point]),
        branching,
    ],
    ids=["indices", "sum", "numpy", "unpacked", "branches"],
)
def test_a_function_of_one_point_is_taken_as_such(single):
    points = np.random.default_rng(0).normal(size=(64, 2)) + 1
    many = of_many_points(single, points, np.ones(2))
    np.testing.assert_allclose(many(points), [float(single(point)) for point in points], rtol=1e-6)
    assert np.shape(many(points[:7])) == (7,)


def test_a_function_of_one_point_is_sampled_and_its_own_errors_are_handed_on():
    found = imubayes.sample(lambda point: -0.5 * ((point[0] - 1) ** 2 + point[1] ** 2), [0.0, 0.0])
    assert found.converged, found.message
    np.testing.assert_allclose(found.draws.mean(axis=0), [1, 0], atol=0.05)

    def broken(points):
        raise ZeroDivisionError("a fault of its own")

    with pytest.raises(ZeroDivisionError, match="of its own"):
        imubayes.sample(broken, [0.0, 0.0])
    with pytest.raises(InputError, match=r"has shape \(64, 2\)"):
        imubayes.sample(lambda points: -0.5 * points**2, [0.0, 0.0])


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
