"""Published values by the functions of this package: GUM H.3 as posterior, as budget and as t distribution."""

import numpy as np
import pytest

from imubayes.results.marginal import Marginal, numerical_tolerance
from imubayes_qualification.budgets.budget_parts import degrees_of_freedom, linear_contributions, posterior_covariance
from imubayes_qualification.evaluation.decision_rules import ToleranceInterval, conformance_probability

READING = np.array([21.521, 22.012, 22.512, 23.003, 23.507, 23.999, 24.513, 25.002, 25.503, 26.010, 26.511])
CORRECTION = np.array([-0.171, -0.169, -0.166, -0.159, -0.164, -0.165, -0.156, -0.157, -0.159, -0.161, -0.160])
DESIGN = np.stack([np.ones_like(READING), READING - 20.0], axis=1)
FREEDOM = len(READING) - 2
# Intercept, slope, and the correction at 30 °C.
GRADIENTS = np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 10.0]])
FLAT = np.full(2, 1e4)


@pytest.fixture(scope="module")
def fitted() -> tuple[np.ndarray, float]:
    y = np.linalg.lstsq(DESIGN, CORRECTION)[0]
    return y, float(np.sqrt(np.sum((CORRECTION - DESIGN @ y) ** 2) / FREEDOM))


def test_gum_h3_as_a_posterior(fitted):
    y, s = fitted
    covariance = posterior_covariance(DESIGN / s, FLAT)
    u = np.sqrt(np.diagonal(covariance))
    assert [f"{value:.4f}" for value in (y[0], u[0], s)] == ["-0.1712", "0.0029", "0.0035"]
    assert [f"{value:.5f}" for value in (y[1], u[1])] == ["0.00218", "0.00067"]
    assert f"{covariance[0, 1] / u[0] / u[1]:.3f}" == "-0.930"
    assert f"{GRADIENTS[2] @ y:.4f}" == "-0.1494"
    assert f"{np.sqrt(GRADIENTS[2] @ covariance @ GRADIENTS[2]):.4f}" == "0.0041"


def test_gum_h3_as_a_budget(fitted):
    """Eleven readings contribute to the correction at 30 °C and add up to its variance; flat priors add nothing."""
    _, s = fitted
    covariance = posterior_covariance(DESIGN / s, FLAT)
    found = linear_contributions(GRADIENTS @ covariance, DESIGN / s, np.eye(len(READING), dtype=bool), FLAT)
    assert [f"{value:.4f}" for value in np.sqrt(found.total[[0, 2]])] == ["0.0029", "0.0041"]
    assert f"{np.sqrt(found.total[1]):.5f}" == "0.00067"
    assert found.type_b.max() < 1e-11 * found.total.min()
    weights = np.linalg.pinv(DESIGN).T @ GRADIENTS[2]
    np.testing.assert_allclose(found.type_a[2], (weights * s) ** 2, rtol=1e-6)


def test_gum_h3_with_an_unknown_scatter_is_a_t_distribution(fitted):
    """With prior 1/σ the posterior is t with 9 degrees of freedom: its sd is √(9/7) of the GUM's u, and is reported."""
    y, s = fitted
    random = np.random.default_rng(6)
    size = 100_000
    sigma = s * np.sqrt(FREEDOM / random.chisquare(FREEDOM, size))
    unit = np.sqrt(GRADIENTS[2] @ np.linalg.inv(DESIGN.T @ DESIGN) @ GRADIENTS[2])
    found = Marginal(GRADIENTS[2] @ y + unit * sigma * random.standard_normal(size), float(size))
    assert found.sd == pytest.approx(np.sqrt(9 / 7) * 0.0041389, rel=4 * found.errors.sd / found.sd)
    low, high = found.interval
    assert (high - low) / 2 == pytest.approx(2.262157 * 0.0041389, rel=0.01)  # t₀.₉₇₅(9) = 2.262 (GUM table G.2)
    assert degrees_of_freedom(sigma[:, None] ** 2)[0] == pytest.approx(FREEDOM, rel=0.02)
    # JCGM 106: p_c is the share inside.
    inside = conformance_probability(found, ToleranceInterval(upper=GRADIENTS[2] @ y + 1.833113 * 0.0041389))
    assert inside.value == pytest.approx(0.95, abs=0.003)  # t₀.₉₅(9) = 1.833
    assert numerical_tolerance(0.0041389, 2) == pytest.approx(5e-5)
