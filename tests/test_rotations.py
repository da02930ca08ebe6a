"""Rotations against scipy, and their derivatives where they are most easily lost: at zero."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from imubayes.foundations.arrays import (
    compose,
    cross,
    exponential,
    right_jacobian,
    rotate,
    rotate_back,
    small_rotation,
    turn_back_about_z,
)

RNG = np.random.default_rng(4)
DIRECTION = np.array([0.48, -0.6, 0.64])
# One program instead of a hundred operations that are each compiled by themselves.
FIRST = jax.jit(jax.jacfwd(exponential))
SECOND = jax.jit(jax.jacfwd(jax.jacfwd(exponential)))
LENGTHS = [0.0, 1e-12, 1e-6, 9.999e-3, 1.0001e-2, 0.1, 1.0, np.pi - 1e-9, np.pi, 4.0, 20.0]


def skew(v: np.ndarray) -> np.ndarray:
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


@pytest.mark.parametrize("length", LENGTHS)
def test_the_exponential_is_that_of_scipy(length):
    vector = DIRECTION * length
    found = exponential(jnp.asarray(vector))
    np.testing.assert_allclose(found, Rotation.from_rotvec(vector).as_matrix(), atol=4e-15)
    np.testing.assert_allclose(found, expm(skew(vector)), atol=1e-13)


@pytest.mark.parametrize("length", LENGTHS[:7])
def test_a_rotation_keeps_lengths_and_hand(length):
    found = np.asarray(exponential(jnp.asarray(DIRECTION * length)))
    np.testing.assert_allclose(found.T @ found, np.eye(3), atol=1e-15)
    assert np.linalg.det(found) == pytest.approx(1.0, abs=1e-15)


def test_first_and_second_derivatives_at_zero_are_right():
    units = [skew(unit) for unit in np.eye(3)]
    first = np.asarray(jax.jacfwd(exponential)(jnp.zeros(3)))
    second = np.asarray(jax.jacfwd(jax.jacrev(exponential))(jnp.zeros(3)))
    for i in range(3):
        np.testing.assert_allclose(first[..., i], units[i], atol=1e-16)
        for j in range(3):
            expected = 0.5 * (units[i] @ units[j] + units[j] @ units[i])
            np.testing.assert_allclose(second[..., i, j], expected, atol=1e-16)


@pytest.mark.parametrize("length", [1e-9, 9.99e-3, 1.001e-2, 0.3, 2.0])
def test_derivatives_elsewhere_agree_with_differences(length):
    vector = DIRECTION * length
    found = np.asarray(FIRST(jnp.asarray(vector)))
    step = 1e-5
    for i, unit in enumerate(np.eye(3)):
        ahead, behind = (Rotation.from_rotvec(vector + s * step * unit).as_matrix() for s in (1, -1))
        np.testing.assert_allclose(found[..., i], (ahead - behind) / (2 * step), atol=1e-9)
    assert np.all(np.isfinite(SECOND(jnp.asarray(vector))))


def test_the_series_meets_the_closed_form_where_they_join():
    def second(length):
        return SECOND(jnp.asarray(DIRECTION * length))

    np.testing.assert_allclose(second(1e-2 * (1 - 1e-9)), second(1e-2 * (1 + 1e-9)), atol=1e-8)


def test_products_are_those_of_matrices():
    a, b = RNG.normal(size=(2, 3, 3))
    u, v = RNG.normal(size=(2, 3))
    np.testing.assert_allclose(rotate(jnp.asarray(a), jnp.asarray(v)), a @ v, rtol=1e-14)
    np.testing.assert_allclose(rotate_back(jnp.asarray(a), jnp.asarray(v)), a.T @ v, rtol=1e-14)
    np.testing.assert_allclose(compose(jnp.asarray(a), jnp.asarray(b)), a @ b, rtol=1e-13)
    np.testing.assert_allclose(cross(jnp.asarray(u), jnp.asarray(v)), np.cross(u, v), rtol=1e-14)


def test_turning_back_about_z_undoes_a_right_handed_turn():
    vector = np.array([0.3, -0.2, 0.9])
    expected = Rotation.from_euler("z", 0.7).as_matrix().T @ vector
    np.testing.assert_allclose(turn_back_about_z(jnp.asarray(vector), jnp.asarray(0.7)), expected, atol=1e-15)
    quarter = turn_back_about_z(jnp.asarray([0.0, 1.0, 0.0]), jnp.asarray(np.pi / 2))
    np.testing.assert_allclose(quarter, [1, 0, 0], atol=1e-15)


@pytest.mark.parametrize("length", [0.0, 1e-8, 0.01, 1.0])
def test_a_small_rotation_is_sine_times_axis(length):
    matrix = Rotation.from_rotvec(DIRECTION * length).as_matrix()
    np.testing.assert_allclose(small_rotation(jnp.asarray(matrix)), np.sin(length) * DIRECTION, atol=1e-15)


@pytest.mark.parametrize("length", [0.0, 1e-9, 9.99e-3, 1.001e-2, 0.3, 2.0])
def test_the_right_jacobian_moves_a_rotation_as_its_vector_does(length):
    """exp(φ)ᵀ ∂exp(φ)/∂φ_k = [J e_k]×."""
    vector = length * DIRECTION
    slope = np.asarray(exponential(jnp.asarray(vector))).T @ np.moveaxis(np.asarray(FIRST(vector)), 2, 0)
    expected = np.array([skew(column) for column in np.asarray(right_jacobian(jnp.asarray(vector))).T])
    np.testing.assert_allclose(slope, expected, atol=1e-12)
