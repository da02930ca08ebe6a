"""The log density against SciPy, whitening against a dense Cholesky factor, sparse against dense derivatives."""

from dataclasses import replace
from functools import cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from imubayes.inference.laplace_marginal import knowledge
from imubayes.inference.laplace_proposal import LogDensity
from imubayes.inference.parameter_fit import linearise
from imubayes.model.bind import Model, bind
from imubayes.model.likelihood import entry_log_likelihood, log_density, residuals
from imubayes.model.noise_covariance import whiten, whitener
from imubayes.model.problem import predict, predict_with_jacobian, prior_widths
from imubayes.simulation.simulate import simulate
from small_campaign import campaign, full_model, simulated, spec, tumble_campaign

# One program instead of a hundred operations that are each compiled by themselves.
density, whitened, known = (eqx.filter_jit(each) for each in (log_density, residuals, knowledge))
law = eqx.filter_jit(entry_log_likelihood)


def point(model: Model, seed: int) -> tuple[jax.Array, jax.Array]:
    rng = np.random.default_rng(seed)
    size, hypers = model.problem.size
    return jnp.asarray(0.5 * rng.normal(size=size)), jnp.asarray(0.5 * rng.normal(size=hypers))


def covariance(model: Model, h: np.ndarray) -> np.ndarray:
    """Return the covariance of all entries, element by element from the named hyperparameters."""
    values = dict(zip(model.hyper_layout.names, np.asarray(model.problem.hyper_priors.values(h)), strict=True))
    entries = model.entries
    runs = [run.name for run in model.campaign.runs]
    channels = [channel.name for channel in model.campaign.channels]
    diagonal, shared = np.zeros(len(entries)), np.zeros(len(entries))
    for place, (run, channel) in enumerate(zip(entries.run, entries.channel, strict=True)):
        if entries.closing[place]:
            diagonal[place] = values[f"rotation_closure.sigma[{runs[run]}]"] ** 2
        else:
            diagonal[place] = values[f"white_noise.sigma[{channels[channel]}]"] ** 2 / entries.samples[place]
            shared[place] = values.get(f"run_scatter.tau[{channels[channel]}]", 0.0)
    together = (entries.run[:, None] == entries.run) & (entries.channel[:, None] == entries.channel)
    return np.diag(diagonal) + together * shared[:, None] * shared


def correlated_covariance(model: Model, h: np.ndarray) -> np.ndarray:
    """Return the covariance of all entries with AR(1) noise within each run and channel, in order of time."""
    values = dict(zip(model.hyper_layout.names, np.asarray(model.problem.hyper_priors.values(h)), strict=True))
    entries = model.entries
    plain, whole = np.zeros((2, len(entries), len(entries)))
    for i, j in np.ndindex(whole.shape):
        if (entries.run[i], entries.channel[i]) != (entries.run[j], entries.channel[j]) or entries.closing[i]:
            continue
        channel, run = model.campaign.channels[entries.channel[i]].name, model.campaign.runs[entries.run[i]]
        time = run.covariates.get("time", np.arange(run.rows))
        low, high = sorted((time[entries.row[i]], time[entries.row[j]]))
        apart = np.sum((time > low) & (time <= high))
        plain[i, j] = values[f"correlated_noise.correlation[{channel}]"] ** apart
        whole[i, j] = values[f"run_scatter.tau[{channel}]"] ** 2
    names = [channel.name for channel in model.campaign.channels]
    sigma = np.array([values[f"white_noise.sigma[{names[c]}]"] for c in entries.channel]) / np.sqrt(entries.samples)
    return plain * sigma * sigma[:, None] + whole


@cache
def in_series() -> Model:
    """Return a model with correlated noise on data with missing values and a run not in order of time."""
    base = campaign()
    ramp = next(k for k, run in enumerate(base.runs) if run.name == "ramp")
    mixed = np.array([3, 0, 5, 1, 4, 2])
    shuffled = {name: column[mixed] for name, column in base.runs[ramp].covariates.items()}
    noise = ("white_noise", "run_scatter", "correlated_noise")
    runs = (base.runs[0], base.runs[3], replace(base.runs[ramp], covariates=shuffled))
    plain = bind(spec("gyro_bias", "accel_bias", noise=noise), replace(base, runs=runs))
    among = simulated(plain, np.asarray(point(plain, 1)[0]), 2)
    observed = among.runs[1].observed.copy()
    observed[2:4, 1], observed[5, 4] = np.nan, np.nan
    return bind(
        plain.spec, replace(among, runs=(among.runs[0], replace(among.runs[1], observed=observed), among.runs[2]))
    )


def test_log_density_with_correlated_noise():
    model = in_series()
    z, h = point(model, 6)
    explicit = correlated_covariance(model, np.asarray(h))
    by = whitener(model.problem, h)
    root = np.asarray(whiten(model.problem, by, jnp.eye(len(explicit))))
    np.testing.assert_allclose(root.T @ root @ explicit, np.eye(len(explicit)), atol=1e-8)
    misfit = np.asarray(model.problem.observations.value - predict(model.problem, z))
    data = stats.multivariate_normal(np.zeros(len(misfit)), explicit).logpdf(misfit)
    prior = stats.norm.logpdf(np.concatenate([z, h])).sum()
    assert float(density(model.problem, z, h)) == pytest.approx(data + prior, rel=1e-10)


def test_precision_and_gradient_with_correlated_noise():
    model = in_series()
    z, h = point(model, 6)
    inverse = np.linalg.inv(correlated_covariance(model, np.asarray(h)))
    about = linearise(model.problem, z)
    found = known(model.problem, about, h)
    misfit, jacobian = np.asarray(about.misfit), np.asarray(about.jacobian)
    np.testing.assert_allclose(found.precision, jacobian.T @ inverse @ jacobian, rtol=1e-9, atol=1e-6)
    np.testing.assert_allclose(found.gradient, jacobian.T @ inverse @ misfit, rtol=1e-8, atol=1e-6)
    assert float(found.square) == pytest.approx(misfit @ inverse @ misfit, rel=1e-10)


def test_conditional_densities_of_correlated_entries():
    model = in_series()
    z, h = point(model, 6)
    explicit = correlated_covariance(model, np.asarray(h))
    misfit = np.asarray(model.problem.observations.value - predict(model.problem, z))
    inverse = np.linalg.inv(explicit)
    variance = 1 / np.diag(inverse)
    expected = stats.norm.logpdf(variance * (inverse @ misfit), scale=np.sqrt(variance))
    found = law(model.problem, jnp.asarray(misfit), h)
    np.testing.assert_allclose(found.entry, expected, rtol=1e-8)
    for group in range(found.group.shape[0]):
        own = np.flatnonzero(np.asarray(model.problem.observations.group) == group)
        block = explicit[np.ix_(own, own)]
        whole = stats.multivariate_normal(np.zeros(len(own)), block).logpdf(misfit[own])
        assert float(found.group[group]) == pytest.approx(whole, rel=1e-9)


@pytest.mark.slow
def test_simulated_noise_has_the_correlation_of_the_likelihood():
    found = []
    for noise in (("white_noise",), ("white_noise", "correlated_noise")):
        model = bind(spec("gyro_bias", noise=noise), in_series().campaign)
        made = simulate(model, 4)
        again = bind(model.spec, made.campaign)
        misfit = again.problem.observations.value - predict(again.problem, jnp.asarray(made.z))
        found.append(whiten(again.problem, whitener(again.problem, jnp.asarray(made.h)), misfit))
    np.testing.assert_allclose(found[1], found[0], rtol=1e-6, atol=1e-7)


def test_a_masked_entry_leaves_a_gap_in_its_series():
    model = in_series()
    z, h = point(model, 8)
    small, large = (density(masked(model, 9, value), z, h) for value in (0.0, 1e9))
    assert float(small) == float(large)
    explicit = np.delete(np.delete(correlated_covariance(model, np.asarray(h)), 9, 0), 9, 1)
    misfit = np.delete(np.asarray(model.problem.observations.value - predict(model.problem, z)), 9)
    data = stats.multivariate_normal(np.zeros(len(misfit)), explicit).logpdf(misfit)
    assert float(small) == pytest.approx(data + stats.norm.logpdf(np.concatenate([z, h])).sum(), rel=1e-10)


def test_the_gradient_is_finite_at_zero_correlation():
    model = in_series()
    z, h = point(model, 8)
    low = h.at[jnp.asarray([n.startswith("correlated") for n in model.hyper_layout.names])].set(-40.0)
    gradient = jax.jit(jax.grad(lambda at: log_density(model.problem, z, at)))(low)
    assert np.all(np.isfinite(gradient))


@cache
def measured() -> Model:
    """Return the model of all effects on simulated outputs, with a missing value."""
    plain = full_model()
    among = simulated(plain, np.asarray(point(plain, 1)[0]), 2)
    observed = among.runs[0].observed.copy()
    observed[2, 1] = np.nan
    return bind(plain.spec, replace(among, runs=(replace(among.runs[0], observed=observed), *among.runs[1:])))


@cache
def tumbling() -> Model:
    return bind(spec("gyro_bias", "accel_misalignment"), tumble_campaign())


def test_the_sparse_derivative_is_the_dense_one():
    model = measured()
    z, _ = point(model, 3)
    dense = jax.jit(jax.jacfwd(lambda at: predict(model.problem, at)))(z)
    sparse = eqx.filter_jit(predict_with_jacobian)(model.problem, z)[1]
    np.testing.assert_allclose(sparse, dense, rtol=1e-12, atol=1e-12 * np.abs(dense).max())
    colours = model.problem.sparsity.seeds.shape[0]
    assert colours < len(model.layout), "the colouring saves nothing"


@pytest.mark.slow
def test_the_sparse_derivative_of_a_tumble_is_the_dense_one():
    model = tumbling()
    z, _ = point(model, 3)
    dense = jax.jit(jax.jacfwd(lambda at: predict(model.problem, at)))(z)
    sparse = eqx.filter_jit(predict_with_jacobian)(model.problem, z)[1]
    np.testing.assert_allclose(sparse, dense, rtol=1e-12, atol=1e-12 * np.abs(dense).max())


def test_whitening_is_a_root_of_the_inverse_covariance():
    model = measured()
    _, h = point(model, 4)
    explicit = covariance(model, np.asarray(h))
    by = whitener(model.problem, h)
    root = np.asarray(whiten(model.problem, by, jnp.eye(len(explicit))))
    factor = np.linalg.cholesky(explicit)
    np.testing.assert_allclose(root.T @ root @ explicit, np.eye(len(explicit)), atol=1e-9)
    residual = jnp.asarray(np.random.default_rng(5).normal(size=len(explicit)))
    dense = np.linalg.solve(factor, np.asarray(residual))
    assert np.sum(whiten(model.problem, by, residual) ** 2) == pytest.approx(dense @ dense, rel=1e-11)
    assert float(by.log_determinant) == pytest.approx(2 * np.sum(np.log(np.diag(factor))), rel=1e-12)


@pytest.mark.parametrize("kind", ["tables", "tumble"])
def test_the_log_density_agrees_with_scipy(kind):
    model = measured() if kind == "tables" else tumbling()
    z, h = point(model, 6)
    misfit = np.asarray(model.problem.observations.value - predict(model.problem, z))
    data = stats.multivariate_normal(np.zeros(len(misfit)), covariance(model, np.asarray(h))).logpdf(misfit)
    prior = stats.norm.logpdf(np.concatenate([z, h])).sum()
    assert float(density(model.problem, z, h)) == pytest.approx(data + prior, rel=1e-10)


def test_a_learnt_spread_is_the_prior_width_of_its_parameters():
    model = bind(spec("gyro_run_bias"), campaign())
    z, h = point(model, 7)
    spreads = dict(zip(model.hyper_layout.names, model.problem.hyper_priors.values(h), strict=True))
    parameters = model.layout.parameters
    widths = [float(spreads[f"gyro_run_bias.spread[{p.label[0]}]"]) / p.prior.sd() for p in parameters]
    np.testing.assert_allclose(prior_widths(model.problem, h), widths, rtol=1e-12)
    misfit = np.asarray(model.problem.observations.value - predict(model.problem, z))
    data = stats.multivariate_normal(np.zeros(len(misfit)), covariance(model, np.asarray(h))).logpdf(misfit)
    prior = stats.norm.logpdf(np.asarray(z), scale=widths).sum() + stats.norm.logpdf(np.asarray(h)).sum()
    assert float(density(model.problem, z, h)) == pytest.approx(data + prior, rel=1e-10)


def masked(model: Model, place: int, value: float):
    """Return the problem with one entry masked out and its value replaced."""
    seen = model.problem.observations
    at = np.arange(len(seen.value)) == place
    return eqx.tree_at(
        lambda p: (p.observations.weight, p.observations.value),
        model.problem,
        (np.where(at, 0.0, seen.weight), np.where(at, value, seen.value)),
    )


def test_a_masked_entry_does_not_count():
    model = measured()
    z, h = point(model, 8)
    small, large = (density(masked(model, 11, value), z, h) for value in (0.0, 1e9))
    assert float(small) == float(large)
    explicit = np.delete(np.delete(covariance(model, np.asarray(h)), 11, 0), 11, 1)
    misfit = np.delete(np.asarray(model.problem.observations.value - predict(model.problem, z)), 11)
    data = stats.multivariate_normal(np.zeros(len(misfit)), explicit).logpdf(misfit)
    prior = stats.norm.logpdf(np.concatenate([z, h])).sum()
    assert float(small) == pytest.approx(data + prior, rel=1e-10)


def test_a_missing_value_is_no_entry():
    assert len(measured().entries) == len(full_model().entries) - 1


@pytest.mark.slow
def test_batched_problems_have_the_densities_of_each():
    model = measured()
    z, h = point(model, 9)
    other = eqx.tree_at(lambda p: p.observations.value, model.problem, model.problem.observations.value + 1.0)
    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), model.problem, other)
    both = jax.jit(jax.vmap(lambda problem: log_density(problem, z, h)))(stacked)
    alone = [float(density(problem, z, h)) for problem in (model.problem, other)]
    np.testing.assert_allclose(both, alone, rtol=1e-12)


def test_half_the_squared_residual_is_the_log_density_at_fixed_noise():
    model = measured()
    (z, h), (other, _) = point(model, 10), point(model, 11)
    drop = 0.5 * (jnp.sum(whitened(model.problem, z, h) ** 2) - jnp.sum(whitened(model.problem, other, h) ** 2))
    change = density(model.problem, other, h) - density(model.problem, z, h)
    assert float(change) == pytest.approx(float(drop), rel=1e-9)


def test_the_public_log_density_is_the_sampled_one():
    model = measured()
    z, h = point(model, 3)
    both = jnp.concatenate([z, h])
    assert len(model.parameter_names) == len(model.parameter_units) == len(both)
    points = jnp.stack([both, 0.5 * both])
    found = jax.jit(jax.vmap(model.log_density))(points)
    assert found.shape == (2,)
    assert float(found[0]) == pytest.approx(float(density(model.problem, z, h)), rel=1e-12)
    sampled = LogDensity(model.problem, 2)(np.asarray(points))
    np.testing.assert_allclose(found, sampled, rtol=1e-12)
    gradient = jax.jit(jax.grad(model.log_density))(both)
    assert gradient.shape == both.shape
    assert np.all(np.isfinite(gradient))


def test_units_to_z_and_back():
    model = measured()
    z = jnp.concatenate(point(model, 4))
    values = np.asarray(model.to_units(z))
    np.testing.assert_allclose(model.from_units(values), z, rtol=1e-9, atol=1e-9)
    place = model.parameter_names.index("white_noise.sigma[gx]")
    assert model.parameter_units[place] == model.hyper_layout.parameters[place - len(model.layout)].unit
    sigma = float(model.problem.hyper_priors.values(z[len(model.layout) :])[place - len(model.layout)])
    assert values[place] == pytest.approx(sigma / model.hyper_layout.factors()[place - len(model.layout)])
