"""Contributions add up to the posterior variance, and agree with what refits and simulated repetitions give."""

import numpy as np
import pytest

from imubayes_qualification.budgets.budget_parts import (
    degrees_of_freedom,
    deviation_with_halved_groups,
    deviation_with_more_of_a_run,
    linear_contributions,
    posterior_covariance,
)
from imubayes_qualification.evaluation.coverage import effective_degrees

RANDOM = np.random.default_rng(7)
WHITENED = RANDOM.normal(size=(60, 6)) * np.array([30, 10, 3, 1, 0.3, 0.01])
WIDTHS = np.array([1.0, 1.0, 0.5, 2.0, 1.0, 1.0])
GROUP = np.repeat(np.arange(3), 20)
MEMBER = np.arange(3)[:, None] == GROUP
GRADIENTS = RANDOM.normal(size=(4, 6))
COVARIANCE = posterior_covariance(WHITENED, WIDTHS)
VARIANCE = np.sum(GRADIENTS @ COVARIANCE * GRADIENTS, axis=1)
PARTS = linear_contributions(GRADIENTS @ COVARIANCE, WHITENED, MEMBER, WIDTHS)


def refitted(whitened: np.ndarray, widths: np.ndarray) -> np.ndarray:
    """Standard deviations of a fit made anew, as a plain least-squares problem with the priors as data."""
    rows = np.vstack([whitened, np.diag(1 / widths)])
    upper = np.linalg.qr(rows, mode="r")
    return np.linalg.norm(np.linalg.solve(upper.T, GRADIENTS.T), axis=0)


def test_contributions_add_up():
    np.testing.assert_allclose(PARTS.total, VARIANCE, rtol=1e-10)
    np.testing.assert_allclose(refitted(WHITENED, WIDTHS) ** 2, VARIANCE, rtol=1e-10)


def test_contributions_are_those_of_simulated_repetitions():
    """Vary one input at a time, as the GUM defines a contribution, and look at the scatter of the estimate."""
    random, draws = np.random.default_rng(1), 20_000
    estimator = COVARIANCE @ np.hstack([WHITENED.T, np.diag(WIDTHS**-2)])
    for group in range(3):
        data = np.where(group == GROUP, random.normal(size=(draws, 60)), 0.0)
        scatter = (data @ estimator[:, :60].T @ GRADIENTS.T).var(axis=0)
        np.testing.assert_allclose(PARTS.type_a[:, group], scatter, rtol=0.05)
    for prior in range(6):
        shifted = random.normal(0, WIDTHS[prior], draws)[:, None] * estimator[:, 60 + prior]
        np.testing.assert_allclose(PARTS.type_b[:, prior], (shifted @ GRADIENTS.T).var(axis=0), rtol=0.05)
    np.testing.assert_allclose(
        PARTS.sensitivity * WIDTHS, np.sqrt(PARTS.type_b) * np.sign(PARTS.sensitivity), rtol=1e-10
    )


def test_halved_inputs_agree_with_refits():
    noise = deviation_with_more_of_a_run(GRADIENTS, WHITENED, MEMBER, WIDTHS, 3.0)
    for group in range(3):
        quieter = np.where(np.equal(GROUP, group)[:, None], 2 * WHITENED, WHITENED)
        np.testing.assert_allclose(noise[:, group], refitted(quieter, WIDTHS), rtol=1e-9)
    again = deviation_with_more_of_a_run(GRADIENTS, WHITENED, MEMBER, WIDTHS, 1.0)
    groups = [np.arange(6) < 2, np.arange(6) == 5]
    together = deviation_with_halved_groups(GRADIENTS, WHITENED, WIDTHS, groups)
    for group in range(3):
        twice = np.concatenate([WHITENED, WHITENED[np.equal(GROUP, group)]])
        np.testing.assert_allclose(again[:, group], refitted(twice, WIDTHS), rtol=1e-9)
    for place, chosen in enumerate(groups):
        expected = refitted(WHITENED, np.where(chosen, WIDTHS / 2, WIDTHS))
        np.testing.assert_allclose(together[:, place], expected, rtol=1e-9)


def test_degrees_of_freedom_of_the_posterior_of_a_variance():
    variances = 9 / np.random.default_rng(2).chisquare(9, size=(200_000, 1))
    assert degrees_of_freedom(variances)[0] == pytest.approx(9, rel=0.02)
    assert degrees_of_freedom(np.ones((5, 1)))[0] == np.inf


# GUM H.1 (end gauge): the components of the standard uncertainty in nm with their degrees of freedom; ν_eff = 16.
def test_effective_degrees_of_gum_h1():
    components = np.array([25.0, 5.8, 3.9, 6.7, 0.0, 0.0, 0.0, 2.9, 16.6])
    degrees = np.array([18, 24, 5, 8, np.inf, np.inf, np.inf, 50, 2])
    assert int(effective_degrees(components**2, degrees)) == 16
    assert effective_degrees(components**2, np.full(9, np.inf)) == np.inf
