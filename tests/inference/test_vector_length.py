"""Standard deviation of the length of a normal vector, against closed forms and draws."""

import numpy as np
import pytest

from imubayes.inference.vector_length import expected_length_deviation, length_deviation

TURNED = np.array([[1.0, 0.5], [0.5, 2.0]])


def test_rayleigh_and_half_normal():
    """σ √(2 − π/2) of two equal components about 0, σ √(1 − 2/π) of a single one, and of a second that is known."""
    assert length_deviation(np.zeros(2), 4 * np.eye(2)) == pytest.approx(2 * np.sqrt(2 - np.pi / 2), rel=1e-6)
    assert length_deviation(np.zeros(1), np.eye(1)) == pytest.approx(np.sqrt(1 - 2 / np.pi), rel=1e-6)
    assert length_deviation(np.zeros(2), np.diag([1.0, 0.0])) == pytest.approx(np.sqrt(1 - 2 / np.pi), rel=1e-6)


def test_far_from_zero_it_is_that_of_the_component_along_the_vector():
    assert length_deviation(np.array([300.0, 0.0]), TURNED) == pytest.approx(1.0, rel=1e-3)
    assert length_deviation(np.array([0.0, 300.0]), TURNED) == pytest.approx(np.sqrt(2.0), rel=1e-3)


@pytest.mark.parametrize("sd", [1e-2, 1e-3, 1e-6, 1e-9])
def test_a_narrow_vector_keeps_its_deviation(sd):
    assert length_deviation(np.array([0.6, 0.8]), sd**2 * np.eye(2)) == pytest.approx(sd, rel=1e-3)


@pytest.mark.parametrize("mean", [[0.0, 0.0], [1.0, -0.5], [0.0, 4.0]])
def test_against_draws(mean):
    draws = np.random.default_rng(0).multivariate_normal(mean, TURNED, 400_000)
    assert length_deviation(np.array(mean), TURNED) == pytest.approx(np.linalg.norm(draws, axis=1).std(), rel=5e-3)


def test_data_that_narrow_both_components_leave_the_component_along_the_angle():
    """Not the 0.66 σ of a vector about 0: after the run it will be known where the vector points."""
    after = 1e-4 * np.eye(2)
    assert expected_length_deviation(np.zeros(2), np.eye(2), after) == pytest.approx(1e-2, rel=2e-3)
    assert expected_length_deviation(np.zeros(2), np.eye(2), np.eye(2)) == length_deviation(np.zeros(2), np.eye(2))


def test_what_is_expected_is_the_mean_over_what_the_data_may_say():
    before, after = TURNED, np.diag([0.5, 0.1])
    estimates = np.random.default_rng(1).multivariate_normal([0.5, 0.0], before - after, 4000)
    mean = np.mean([length_deviation(estimate, after) ** 2 for estimate in estimates])
    expected = expected_length_deviation(np.array([0.5, 0.0]), before, after)
    assert expected == pytest.approx(np.sqrt(mean), rel=0.02)
    assert expected < length_deviation(np.array([0.5, 0.0]), before)
