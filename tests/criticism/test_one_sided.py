"""Coefficients of one sign: fitted with that sign, with p-values that are uniform, and the faults would show."""

import numpy as np
import pytest
from scipy import optimize, stats

from imubayes.criticism.multiple_testing import look_elsewhere
from imubayes.criticism.one_sided import Cone, least_p_of_cones
from imubayes.criticism.projection import Projection, Strata
from imubayes.criticism.score_test import score_test

ROWS, DRAWS = 40, 4000


def residuals(count: int = DRAWS, seed: int = 1) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(count, ROWS))


def columns(count: int, seed: int = 2) -> np.ndarray:
    found = np.random.default_rng(seed).normal(size=(ROWS, count))
    return found / np.linalg.norm(found, axis=0)


def cone(of: np.ndarray, bounded: np.ndarray) -> Cone:
    return Cone.of(np.linalg.qr(of)[0], of, bounded)


def seen_through(residual: np.ndarray) -> Projection:
    """A projection in which nothing was projected out, with one stratum of estimated scale."""
    found = object.__new__(Projection)
    strata = Strata(np.zeros(ROWS, dtype=int), np.array([0]), np.array([False]))
    known = {"residual": residual, "strata": strata, "freedom": np.array([float(ROWS), 0.0])}
    for name, value in known.items():
        object.__setattr__(found, name, value)
    return found


def test_it_solves_the_problem_of_least_squares_with_signs():
    given, data = columns(4), residuals(20)
    found = cone(given, np.ones(4, dtype=bool)).coefficients(data)
    for each, residual in zip(found, data, strict=True):
        np.testing.assert_allclose(each, optimize.nnls(given, residual)[0], atol=1e-7)
    free = cone(given, np.zeros(4, dtype=bool)).coefficients(data)
    np.testing.assert_allclose(free, data @ np.linalg.pinv(given).T, atol=1e-7)


@pytest.mark.parametrize("bounded", [(True,), (True, True, True), (True, False), (True, True, True, True, False)])
def test_p_values_are_uniform_under_no_effect(bounded):
    """Every p below the probability that all coefficients are held at 0; with two-sided tails they are not."""
    given = cone(columns(len(bounded)), np.array(bounded))
    p = given.p_values(residuals())
    for level in (0.01, 0.05, 0.2):
        assert np.mean(p <= level) == pytest.approx(level, abs=4 * np.sqrt(level / DRAWS) + 0.05 * level)
    chi2 = np.sum((given.coefficients(residuals()) @ given.columns.T) ** 2, axis=1)
    two_sided = stats.chi2.sf(chi2, len(bounded))
    assert np.mean(two_sided <= 0.05) < 0.04


def test_a_candidate_of_the_wrong_sign_explains_nothing():
    column = columns(1)
    pull = 8.0 * column[:, 0]
    for sign in (1, -1):
        right = score_test(seen_through(sign * pull), column, np.ones(1), signs=np.array([sign]))
        wrong = score_test(seen_through(-sign * pull), column, np.ones(1), signs=np.array([sign]))
        either = score_test(seen_through(-sign * pull), column, np.ones(1))
        assert wrong.p == 1.0
        assert wrong.delta_chi2 == 0.0
        assert wrong.used is not None
        assert not wrong.used.any()
        assert right.p < 1e-6
        assert either.p < 1e-6
        assert right.p == pytest.approx(score_test(seen_through(sign * pull), column, np.ones(1)).p / 2)


def test_p_values_with_an_estimated_scale_are_uniform():
    found = [
        score_test(seen_through(3.7 * each), columns(2), np.ones(2), signs=np.array([1, 1])).p
        for each in residuals(1500)
    ]
    assert np.mean(np.array(found) <= 0.05) == pytest.approx(0.05, abs=0.018)


def test_all_looks_are_counted_one_sided_ones_as_such():
    """Twenty one-sided looks: the corrected chance of the best is uniform; halved whatever the sign it is not."""
    data = residuals(400, seed=3)
    looks = [
        score_test(seen_through(data[0]), columns(1, seed=10 + k), np.ones(1), signs=np.array([1])) for k in range(20)
    ]
    corrected = look_elsewhere(looks)
    cones = [each.cone for each in looks if each.cone is not None]
    assert len(cones) == len(looks)
    best = np.min([each.p_values(data) for each in cones], axis=0)
    p = np.array([corrected(float(each)) for each in best])
    assert np.mean(p <= 0.1) == pytest.approx(0.1, abs=0.06)
    either = np.min([stats.chi2.sf((data @ each.span[:, 0]) ** 2, 1) / 2 for each in cones], axis=0)
    halved = np.array([corrected(float(each)) for each in either])
    assert np.mean(halved <= 0.1) > 1.5 * np.mean(p <= 0.1)


def test_the_smallest_p_value_over_cones_is_that_of_the_cones_one_by_one():
    """Single coefficients of either sign, which have a way of their own, beside cones of several coefficients."""
    single = [cone(sign * columns(1, seed=20 + k), np.array([True])) for k in range(3) for sign in (1, -1)]
    several = [cone(columns(3, seed=30), np.array([True, True, False]))]
    for cones in (single, several, single + several, single[:1]):
        expected = np.min([each.p_values(residuals(200)) for each in cones], axis=0)
        np.testing.assert_allclose(least_p_of_cones(cones, residuals(200)), expected, rtol=1e-9)
    np.testing.assert_array_equal(least_p_of_cones([], residuals(5)), np.ones(5))
