"""The mode of the noise scales: its curvature against automatic differentiation, its place against SciPy's."""

from functools import cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import minimize

from imubayes.inference import laplace_marginal as marginal
from imubayes.inference.laplace_marginal import log_marginal
from imubayes.inference.parameter_fit import Linearised, fit_at, linear_residual, linearise
from imubayes.model.bind import Model, bind
from imubayes.model.likelihood import residuals
from small_campaign import campaign, simulated, spec


@cache
def made() -> Model:
    plain = bind(spec("gyro_bias", noise=("white_noise", "run_scatter")), campaign())
    rng = np.random.default_rng(3)
    return bind(plain.spec, simulated(plain, rng.normal(size=plain.problem.size[0]), 4))


@cache
def about() -> Linearised:
    problem = made().problem
    size, hyper_size = problem.size
    return linearise(problem, fit_at(problem, np.zeros(size), np.zeros(hyper_size)))


def away(seed: int, far: float) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=made().problem.size[1]) * far


@pytest.mark.slow
def test_curvature_is_that_of_the_second_derivative():
    h = away(1, 0.3)
    found = marginal.curvature(made().problem, about(), h)
    value, slope = jax.jit(jax.value_and_grad(lambda one: log_marginal(made().problem, about(), one)))(h)
    second = jax.jit(jax.hessian(lambda one: log_marginal(made().problem, about(), one)))(h)
    assert float(found.value) == pytest.approx(float(value), rel=1e-12)
    np.testing.assert_allclose(found.gradient, slope, rtol=1e-9)
    np.testing.assert_allclose(found.information, -second, atol=1e-6 * float(jnp.abs(second).max()))


@pytest.mark.parametrize("far", [0.3, 2.0])
@pytest.mark.slow
def test_the_mode_is_that_of_scipy(far):
    def downhill(h):
        at = marginal.ScaleMarginal(made().problem, about()).slope(h)
        return -at.value, -at.gradient

    h, at = marginal.climb(made().problem, about(), away(2, far))
    best = minimize(downhill, np.asarray(h), jac=True, method="BFGS", options={"gtol": 1e-6})
    np.testing.assert_allclose(h, best.x, atol=3e-3)
    assert float(at.value) >= -best.fun - 1e-5
    assert np.all(np.linalg.eigvalsh(np.asarray(at.information)) > 0)


def test_what_is_learnt_of_the_curvature_never_has_the_last_word(monkeypatch):
    """With a curvature learnt wrongly steps are bad or none, but what counts as the mode is measured."""
    right, _ = marginal.climb(made().problem, about(), away(5, 1.0))
    monkeypatch.setattr(marginal, "_learnt", lambda at, taken, gradient: at.information * 1e4)
    found, at = marginal.climb(made().problem, about(), away(5, 1.0))
    np.testing.assert_allclose(found, right, atol=3e-3)
    np.testing.assert_allclose(
        at.information, marginal.curvature(made().problem, about(), found).information, rtol=1e-9
    )


def test_a_known_curvature_is_a_beginning():
    h, at = marginal.climb(made().problem, about(), away(6, 0.5))
    again, _ = marginal.climb(made().problem, about(), h + 0.05, at.information)
    np.testing.assert_allclose(again, h, atol=3e-3)


def test_where_nothing_is_finite_the_climb_ends():
    broken = Linearised(about().z, about().misfit * np.nan, about().jacobian)
    _, at = marginal.climb(made().problem, broken, away(7, 0.1))
    assert not np.isfinite(float(at.value))


def test_the_linear_residual_is_the_residual_with_its_derivative():
    problem = made().problem
    z, h = jnp.asarray(np.random.default_rng(8).normal(size=problem.size[0])), away(9, 0.3)
    residual = eqx.filter_jit(linear_residual(problem, h))
    expected = eqx.filter_jit(residuals)(problem, z, h)
    np.testing.assert_allclose(residual(z)[0], expected, rtol=1e-12, atol=1e-12)
    dense = jax.jit(jax.jacfwd(lambda one: residuals(problem, one, h)))(z)
    found = jax.jit(jax.jacfwd(lambda one: residual(one)[0]))(z)
    np.testing.assert_allclose(found, dense, atol=1e-11 * float(jnp.abs(dense).max()))
    np.testing.assert_array_equal(residual(z)[1].z, z)


def test_a_mode_learnt_from_the_steps_is_as_good():
    """With the Hessian of a place nearby no other is computed; red if a long step passes for the end."""
    problem, near = made().problem, away(2, 0.3)
    exact, _ = marginal.climb(problem, about(), near)
    information = marginal.curvature(problem, about(), near).information
    found, at = marginal.climb(problem, about(), near, information, judged=False)
    assert np.max(np.abs(found - near)) > 0.1, "the start is not the end"
    np.testing.assert_allclose(found, exact, atol=2e-3)
    assert float(at.value) > marginal.ScaleMarginal(problem, about()).slope(exact).value - 1e-6
