"""Least squares: what is found, what is flagged, and what the covariance keeps."""

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
import pytest

from imubayes.inference.least_squares import covariance
from imubayes.inference.levenberg_marquardt import GramCholesky, minimise

# One program instead of a hundred operations that are each compiled by themselves.
solved = eqx.filter_jit(minimise)
TIME = jnp.linspace(0.0, 4.0, 30)


def decay(x, observed):
    return x[0] * jnp.exp(-x[1] * TIME) + x[2] - observed


OBSERVED = decay(jnp.array([3.0, 0.8, -1.0]), 0.0)


@pytest.mark.parametrize("solver", [None, GramCholesky(), lx.QR()])
def test_the_minimum_is_found(solver):
    found = solved(decay, jnp.array([1.0, 0.3, 0.0]), OBSERVED, linear_solver=solver)
    assert bool(found.successful)
    np.testing.assert_allclose(found.value, [3.0, 0.8, -1.0], rtol=1e-8)


def test_a_linear_problem_is_solved_to_the_last_digits():
    matrix = np.random.default_rng(1).normal(size=(20, 4)) * np.array([1e-6, 1.0, 1e3, 1e8])
    right = np.random.default_rng(2).normal(size=20)
    found = solved(lambda x, _: jnp.asarray(matrix) @ x - right, jnp.zeros(4))
    assert bool(found.successful)
    sizes = np.linalg.norm(matrix, axis=0)
    np.testing.assert_allclose(found.value, np.linalg.lstsq(matrix / sizes, right, rcond=None)[0] / sizes, rtol=1e-10)


@pytest.mark.parametrize("units", [1e-12, 1e-6, 1e9])
def test_units_of_data_and_parameters_do_not_matter(units):
    scales = jnp.array([units, 1 / units, 1.0])
    plain = solved(decay, jnp.array([1.0, 0.3, 0.1]), OBSERVED)
    scaled = solved(lambda x, o: units * decay(x / scales, o), jnp.array([1.0, 0.3, 0.1]) * scales, OBSERVED)
    assert bool(scaled.successful)
    np.testing.assert_allclose(scaled.value / scales, plain.value, rtol=1e-8)


def test_a_minimum_at_zero_is_a_minimum():
    found = solved(lambda x, _: jnp.stack([x[0], 10 * (x[1] - x[0] ** 2)]), jnp.array([1.0, 3.0]))
    assert bool(found.successful)
    np.testing.assert_allclose(found.value, 0.0, atol=1e-8)


def test_a_residual_that_stays_is_no_hindrance():
    found = solved(lambda x, _: jnp.array([1.0, -1.0, 5.0]) - x[0] ** 2, jnp.array([3.0]))
    assert bool(found.successful)
    np.testing.assert_allclose(found.value**2, 5 / 3, rtol=1e-9)


@pytest.mark.parametrize(
    ("residual", "guess"),
    [
        (lambda x, _: jnp.stack([jnp.exp(-x[0]) + 1.0, jnp.exp(-2 * x[0])]), [0.0]),  # falls for ever
        (lambda x, _: jnp.stack([x[0] + x[1], 2 * x[0] + 2 * x[1] - 1]), [0.0, 0.0]),  # a valley without a bottom
        (lambda x, _: jnp.stack([jnp.log(x[0] - 5.0), x[0]]), [0.0]),  # not finite where it begins
        (lambda x, _: jnp.stack([1.0 + 0.0 * x[0], 2.0 + 0.0 * x[0]]), [1.0]),  # says nothing of its parameter
    ],
)
def test_what_has_no_minimum_is_flagged(residual, guess):
    assert not bool(solved(residual, jnp.array(guess)).successful)


def test_too_few_steps_are_flagged():
    assert not bool(solved(decay, jnp.array([1.0, 3.0, 0.0]), OBSERVED, most_steps=2).successful)


def test_a_step_into_nowhere_is_taken_back():
    def residual(x, _):
        return jnp.stack([jnp.log(x[0]) - 1.0, 0.1 * (x[0] - jnp.e)])

    found = solved(residual, jnp.array([20.0]))
    assert bool(found.successful)
    assert float(found.value[0]) == pytest.approx(np.e, rel=1e-9)


def test_many_problems_are_solved_in_one_vmap():
    truths = jnp.array([[3.0, 0.8, -1.0], [1.0, 2.0, 0.5], [-2.0, 0.5, 3.0]])
    observed = jax.vmap(lambda x: decay(x, 0.0))(truths)
    found = jax.jit(jax.vmap(lambda one: solved(decay, jnp.array([1.0, 1.0, 0.1]), one)))(observed)
    assert bool(found.successful.all())
    np.testing.assert_allclose(found.value, truths, rtol=1e-7)


def test_the_covariance_keeps_its_digits_where_columns_differ_in_size():
    orthonormal, _ = np.linalg.qr(np.random.default_rng(3).normal(size=(40, 3)))
    mixing = np.array([[1.0, 0.9, 0.0], [0.0, 1e-3, 0.5], [0.0, 0.0, 1.0]])
    scale = np.array([1e-12, 1.0, 1e9])
    inverse = np.linalg.inv(mixing)
    expected = 4.0 * (inverse @ inverse.T) / np.outer(scale, scale)
    found = covariance(jnp.asarray(orthonormal @ mixing * scale), 4.0)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).min())


def test_both_solvers_take_the_same_step():
    matrix = jnp.asarray(np.random.default_rng(4).normal(size=(12, 3)))
    right = jnp.asarray(np.random.default_rng(5).normal(size=12))
    steps = [
        lx.linear_solve(lx.MatrixLinearOperator(matrix), right, solver).value for solver in (GramCholesky(), lx.QR())
    ]
    np.testing.assert_allclose(*steps, rtol=1e-12)
