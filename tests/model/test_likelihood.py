"""The log density against scipy, the whitener against a dense Cholesky factor, sparse derivatives against dense."""

from dataclasses import replace
from functools import cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from imubayes.model.declaration import Model, declare
from imubayes.model.likelihood import (
    log_density,
    predict,
    prediction_jacobian,
    prior_widths,
    residuals,
    whiten,
    whitener,
)
from small_campaign import campaign, full_model, simulated, spec, tumble_campaign


def point(model: Model, seed: int) -> tuple[jax.Array, jax.Array]:
    rng = np.random.default_rng(seed)
    size, hypers = model.problem.size
    return jnp.asarray(0.5 * rng.normal(size=size)), jnp.asarray(0.5 * rng.normal(size=hypers))


def covariance(model: Model, h: np.ndarray) -> np.ndarray:
    """Return the covariance of all entries, spelled out from names."""
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


@cache
def measured() -> Model:
    """Return all effects on simulated outputs, with some values missing."""
    plain = full_model()
    among = simulated(plain, np.asarray(point(plain, 1)[0]), 2)
    observed = among.runs[0].observed.copy()
    observed[2, 1] = np.nan
    return declare(plain.spec, replace(among, runs=(replace(among.runs[0], observed=observed), *among.runs[1:])))


def test_the_sparse_derivative_is_the_dense_one():
    model = measured()
    z, _ = point(model, 3)
    dense = jax.jit(jax.jacfwd(lambda one: predict(model.problem, one)))(z)
    sparse = eqx.filter_jit(prediction_jacobian)(model.problem, z)
    np.testing.assert_allclose(sparse, dense, rtol=1e-12, atol=1e-12 * np.abs(dense).max())
    colours = model.problem.sparsity.seeds.shape[0]
    assert colours < len(model.layout), "nothing was gained by the sparsity"


def test_the_sparse_derivative_of_a_tumble_is_the_dense_one():
    model = declare(spec("gyro_bias", "accel_bias", "accel_scale_factor", "accel_misalignment"), tumble_campaign())
    z, _ = point(model, 3)
    dense = jax.jit(jax.jacfwd(lambda one: predict(model.problem, one)))(z)
    sparse = eqx.filter_jit(prediction_jacobian)(model.problem, z)
    np.testing.assert_allclose(sparse, dense, rtol=1e-12, atol=1e-12 * np.abs(dense).max())


def test_the_whitener_is_a_root_of_the_inverse_covariance():
    model = measured()
    _, h = point(model, 4)
    explicit = covariance(model, np.asarray(h))
    by = whitener(model.problem, h)
    root = np.asarray(jax.vmap(lambda column: whiten(model.problem, by, column), 1, 1)(jnp.eye(len(explicit))))
    factor = np.linalg.cholesky(explicit)
    np.testing.assert_allclose(root.T @ root @ explicit, np.eye(len(explicit)), atol=1e-9)
    residual = jnp.asarray(np.random.default_rng(5).normal(size=len(explicit)))
    dense = np.linalg.solve(factor, np.asarray(residual))
    assert np.sum(whiten(model.problem, by, residual) ** 2) == pytest.approx(dense @ dense, rel=1e-11)
    assert float(by.log_determinant) == pytest.approx(2 * np.sum(np.log(np.diag(factor))), rel=1e-12)


@pytest.mark.parametrize("kind", ["tables", "tumble"])
def test_the_log_density_is_that_of_scipy(kind):
    model = measured() if kind == "tables" else declare(spec("gyro_bias"), tumble_campaign())
    z, h = point(model, 6)
    misfit = np.asarray(model.problem.observations.value - predict(model.problem, z))
    data = stats.multivariate_normal(np.zeros(len(misfit)), covariance(model, np.asarray(h))).logpdf(misfit)
    prior = stats.norm.logpdf(np.concatenate([z, h])).sum()
    assert float(log_density(model.problem, z, h)) == pytest.approx(data + prior, rel=1e-10)


def test_a_learnt_spread_is_the_width_of_its_parameters():
    model = declare(spec("gyro_run_bias"), campaign())
    z, h = point(model, 7)
    spreads = dict(zip(model.hyper_layout.names, model.problem.hyper_priors.values(h), strict=True))
    parameters = model.layout.parameters
    widths = [float(spreads[f"gyro_run_bias.spread[{p.label[0]}]"]) / p.prior.sd() for p in parameters]
    np.testing.assert_allclose(prior_widths(model.problem, h), widths, rtol=1e-12)
    misfit = np.asarray(model.problem.observations.value - predict(model.problem, z))
    data = stats.multivariate_normal(np.zeros(len(misfit)), covariance(model, np.asarray(h))).logpdf(misfit)
    prior = stats.norm.logpdf(np.asarray(z), scale=widths).sum() + stats.norm.logpdf(np.asarray(h)).sum()
    assert float(log_density(model.problem, z, h)) == pytest.approx(data + prior, rel=1e-10)


def masked(model: Model, place: int, value: float):
    """Return the problem with one entry masked out and its value replaced."""
    seen = model.problem.observations
    return eqx.tree_at(
        lambda p: (p.observations.weight, p.observations.value),
        model.problem,
        (seen.weight.at[place].set(0.0), seen.value.at[place].set(value)),
    )


def test_a_masked_entry_does_not_count():
    model = measured()
    z, h = point(model, 8)
    small, large = (eqx.filter_jit(log_density)(masked(model, 11, value), z, h) for value in (0.0, 1e9))
    assert float(small) == float(large)
    explicit = np.delete(np.delete(covariance(model, np.asarray(h)), 11, 0), 11, 1)
    misfit = np.delete(np.asarray(model.problem.observations.value - predict(model.problem, z)), 11)
    data = stats.multivariate_normal(np.zeros(len(misfit)), explicit).logpdf(misfit)
    prior = stats.norm.logpdf(np.concatenate([z, h])).sum()
    assert float(small) == pytest.approx(data + prior, rel=1e-10)


def test_a_missing_value_is_no_entry():
    assert len(measured().entries) == len(full_model().entries) - 1


def test_a_stack_of_units_has_the_densities_of_each():
    model = measured()
    z, h = point(model, 9)
    other = eqx.tree_at(lambda p: p.observations.value, model.problem, model.problem.observations.value + 1.0)
    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), model.problem, other)
    both = jax.jit(jax.vmap(lambda one: log_density(one, z, h)))(stacked)
    alone = [float(log_density(one, z, h)) for one in (model.problem, other)]
    np.testing.assert_allclose(both, alone, rtol=1e-12)


def test_half_the_squared_residual_is_the_log_density_at_fixed_noise():
    model = measured()
    (z, h), (other, _) = point(model, 10), point(model, 11)
    drop = 0.5 * (jnp.sum(residuals(model.problem, z, h) ** 2) - jnp.sum(residuals(model.problem, other, h) ** 2))
    change = log_density(model.problem, other, h) - log_density(model.problem, z, h)
    assert float(change) == pytest.approx(float(drop), rel=1e-9)
