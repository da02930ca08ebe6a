"""Heavy-tailed noise: the density against SciPy and quadrature, the fit on data with outliers."""

from dataclasses import replace
from functools import cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from imubayes.foundations.errors import InputError
from imubayes.inference.laplace_marginal import knowledge, log_marginal
from imubayes.inference.parameter_fit import linearise
from imubayes.inference.posterior_mode import Mode, find_mode
from imubayes.model.bind import Model, bind
from imubayes.model.likelihood import (
    entry_log_likelihood,
    log_density,
    pseudo_values,
    residuals,
    run_offsets,
    with_normal_noise,
)
from imubayes.model.model_file import EffectSpec
from imubayes.model.noise_covariance import noise_distribution, whiten, whitener
from imubayes.model.problem import predict
from imubayes.simulation.simulate import simulate
from small_campaign import campaign, simulated, spec

# One program instead of a hundred operations that are each compiled by themselves.
density, known = eqx.filter_jit(log_density), eqx.filter_jit(knowledge)
law = eqx.filter_jit(entry_log_likelihood)
EFFECTS = ("gyro_bias", "gyro_scale_factor", "accel_bias", "accel_scale_factor", "mounting_error")


WITH_OFFSETS = ("white_noise", "run_scatter", "outliers")


@cache
def contaminated(noise: tuple[str, ...] = ("white_noise", "outliers")) -> Model:
    """Return a model on data of which a tenth are outliers of 15 noise standard deviations."""
    model = bind(spec(*EFFECTS, noise=("white_noise",)), campaign())
    among = simulated(model, 0.3 * np.random.default_rng(1).normal(size=model.problem.size[0]), 2)
    rng = np.random.default_rng(3)
    noises = np.array([channel.noise for channel in among.channels]) / 10

    def with_outliers(observed: np.ndarray) -> np.ndarray:
        hit = rng.random(observed.shape) < 0.1
        return observed + hit * 15 * noises * rng.choice([-1, 1], size=observed.shape)

    runs = tuple(replace(run, observed=with_outliers(run.observed)) for run in among.runs)
    return bind(spec(*EFFECTS, noise=noise), replace(among, runs=runs))


@cache
def fitted() -> Mode:
    """Return the fit with run offsets, compiled once for all tests."""
    model = contaminated(WITH_OFFSETS)
    return find_mode(model.problem, *point(model, 4))


@cache
def fitted_with_normal_noise() -> Mode:
    return find_mode(with_normal_noise(contaminated(WITH_OFFSETS).problem), fitted().z, fitted().h)


def point(model: Model, seed: int) -> tuple[jax.Array, jax.Array]:
    rng = np.random.default_rng(seed)
    size, hypers = model.problem.size
    return jnp.asarray(0.3 * rng.normal(size=size)), jnp.asarray(0.3 * rng.normal(size=hypers))


def values(model: Model, h) -> dict[str, float]:
    return dict(zip(model.hyper_layout.names, np.asarray(model.problem.hyper_priors.values(h)), strict=True))


def of_entries(model: Model, h, name: str) -> np.ndarray:
    known = values(model, h)
    channels = [channel.name for channel in model.campaign.channels]
    return np.array([known[f"{name}[{channels[place]}]"] for place in model.entries.channel])


def misfit_and_noise(model: Model, z, h) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return misfit, scale and degrees of freedom of every entry, from the named hyperparameters."""
    misfit = np.asarray(model.problem.observations.value - predict(model.problem, z))
    scale = of_entries(model, h, "white_noise.sigma") / np.sqrt(model.entries.samples)
    return misfit, scale, of_entries(model, h, "outliers.degrees_of_freedom")


def test_without_run_offsets_the_density_agrees_with_scipy():
    model = contaminated()
    z, h = point(model, 4)
    misfit, scale, degrees = misfit_and_noise(model, z, h)
    expected = stats.t(degrees, scale=scale).logpdf(misfit)
    prior = stats.norm.logpdf(np.concatenate([z, h])).sum()
    assert float(density(model.problem, z, h)) == pytest.approx(expected.sum() + prior, rel=1e-10)
    np.testing.assert_allclose(law(model.problem, jnp.asarray(misfit), h).entry, expected, rtol=1e-8)


@pytest.mark.slow
def test_run_offsets_are_marginalised():
    """Against quadrature: for runs of 4 to 8 rows Laplace's method errs by 0.1 rms, 0.4 at most, in log density."""
    model, at = contaminated(WITH_OFFSETS), fitted()
    z, h = at.z, at.h
    misfit, scale, degrees = misfit_and_noise(model, z, h)
    spread = of_entries(model, h, "run_scatter.tau")
    found = np.asarray(law(model.problem, jnp.asarray(misfit), h).group)
    left = []
    for group, mine in enumerate(found):
        own = np.flatnonzero(np.asarray(model.problem.observations.group) == group)
        tau = spread[own[0]]
        top = stats.t(degrees[own], scale=scale[own]).logpdf(0).sum()
        offset = np.linspace(-8 * tau, 8 * tau, 4001)
        likelihood = stats.t(degrees[own], scale=scale[own]).logpdf(misfit[own] - offset[:, None]).sum(axis=1)
        both = np.exp(likelihood - top) * stats.norm(scale=tau).pdf(offset)
        left.append(mine - np.log(np.trapezoid(both, offset)) - top)
    assert np.sqrt(np.mean(np.square(left))) < 0.1
    assert np.max(np.abs(left)) < 0.4
    prior = stats.norm.logpdf(np.concatenate([z, h])).sum()
    assert float(density(model.problem, z, h)) == pytest.approx(found.sum() + prior, rel=1e-10)


@pytest.mark.parametrize(
    "noise",
    [pytest.param(("white_noise", "outliers"), marks=pytest.mark.slow), ("white_noise", "run_scatter", "outliers")],
)
def test_pseudo_values_have_the_gradient_of_the_log_density(noise):
    model = contaminated(noise)
    z, h = point(model, 5)
    found = known(model.problem, linearise(model.problem, z), h)
    slope = jax.jit(jax.grad(lambda at: -0.5 * jnp.sum(residuals(model.problem, at, h) ** 2)))(z)
    np.testing.assert_allclose(found.gradient - z, slope, rtol=1e-6, atol=1e-6 * float(jnp.abs(slope).max()))


@pytest.mark.slow
def test_the_gradient_of_the_noise_marginal():
    model, at = contaminated(WITH_OFFSETS), fitted()
    h, step = at.h + 0.1, 1e-4
    marginal = jax.jit(lambda h: log_marginal(model.problem, at.about, h))
    ahead = [(marginal(h + step * seed) - marginal(h - step * seed)) / (2 * step) for seed in jnp.eye(len(h))]
    np.testing.assert_allclose(jax.jit(jax.grad(marginal))(h), ahead, rtol=1e-4, atol=1e-4)


@pytest.mark.slow
def test_whitened_pseudo_values_have_unit_variance():
    plain = contaminated(WITH_OFFSETS)
    squares = []
    for seed in range(6):
        made = simulate(plain, seed)
        model = bind(plain.spec, made.campaign)
        misfit = model.problem.observations.value - predict(model.problem, jnp.asarray(made.z))
        h = jnp.asarray(made.h)
        pseudo = pseudo_values(model.problem, h, misfit)
        squares.append(np.asarray(whiten(model.problem, whitener(model.problem, h), pseudo)) ** 2)
    assert np.mean(squares) == pytest.approx(1.0, abs=0.06)


@pytest.mark.slow
def test_many_degrees_of_freedom_are_normal_noise():
    model, plain = contaminated(WITH_OFFSETS), contaminated(("white_noise", "run_scatter"))
    at = fitted_with_normal_noise()
    z, h = at.z, at.h[:-6]
    normal = with_normal_noise(model.problem)
    whole = jnp.concatenate([h, jnp.zeros(6)])
    constant = stats.norm.logpdf(np.zeros(6)).sum()
    expected = float(density(plain.problem, z, h))
    assert float(density(normal, z, whole)) == pytest.approx(expected + constant, rel=1e-12)
    # z = 15 in a log-normal prior of width 0.8 is millions of degrees of freedom.
    far = jnp.concatenate([h, jnp.full(6, 15.0)])
    assert float(density(model.problem, z, far)) == pytest.approx(expected + constant - 3 * 15.0**2, abs=0.05)


@pytest.mark.slow  # two fits; criticism/test_outliers.py finds outliers at every run
def test_outliers_do_not_bias_the_fit():
    model, heavy, normal = contaminated(WITH_OFFSETS), fitted(), fitted_with_normal_noise()
    assert bool(heavy.converged)
    assert bool(normal.converged)
    size = model.problem.size[0]
    truth = 0.3 * np.random.default_rng(1).normal(size=size)

    def deviations(problem, mode: Mode) -> np.ndarray:
        precision = known(problem, mode.about, mode.h).precision + jnp.eye(size)
        return np.sqrt(np.diag(np.linalg.inv(precision)))

    sd = deviations(model.problem, heavy)
    assert np.sqrt(np.mean(((np.asarray(heavy.z) - truth) / sd) ** 2)) < 1.4
    # Normal noise absorbs the outliers in its scale, and the standard deviations grow.
    assert np.median(deviations(with_normal_noise(model.problem), normal) / sd) > 1.8


def test_a_run_offset_is_robust_against_one_outlier():
    model = contaminated(WITH_OFFSETS)
    _, h = point(model, 5)
    noise = noise_distribution(model.problem, h)
    misfit = np.zeros(len(model.entries))
    offsets = []
    for far in (0.0, 30.0, 3000.0):
        misfit[0] = far * float(jnp.sqrt(noise.squared_scale[0]))
        offsets.append(
            float(run_offsets(model.problem, noise, jnp.asarray(misfit))[model.problem.observations.group[0]])
        )
    scale = float(jnp.sqrt(noise.squared_scale[0]))
    assert offsets[0] == pytest.approx(0.0, abs=1e-12)
    assert abs(offsets[1]) < 0.3 * scale
    assert abs(offsets[2]) < abs(offsets[1])


def test_outliers_exclude_correlated_noise_on_the_same_channel():
    with pytest.raises(InputError, match=r"outliers.*correlated_noise"):
        bind(spec("gyro_bias", noise=("white_noise", "correlated_noise", "outliers")), campaign())
    plain = spec("gyro_bias", noise=("white_noise",))
    apart = (EffectSpec("correlated_noise", ("gx",)), EffectSpec("outliers", ("gy", "gz")))
    bind(replace(plain, effects=(*plain.effects, *apart)), campaign())
