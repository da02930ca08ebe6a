"""GUM annex H.3, calibration of a thermometer: every digit that is published."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from imubayes.inference.least_squares import covariance
from imubayes.inference.levenberg_marquardt import minimise

READING = jnp.array([21.521, 22.012, 22.512, 23.003, 23.507, 23.999, 24.513, 25.002, 25.503, 26.010, 26.511])
CORRECTION = jnp.array([-0.171, -0.169, -0.166, -0.159, -0.164, -0.165, -0.156, -0.157, -0.159, -0.161, -0.160])
REFERENCE = 20.0


def residual(y, _=None):
    return y[0] + y[1] * (READING - REFERENCE) - CORRECTION


@pytest.fixture(scope="module")
def thermometer() -> tuple[np.ndarray, np.ndarray, float]:
    found = minimise(residual, jnp.zeros(2))
    assert bool(found.successful)
    left = residual(found.value)
    variance = float(left @ left) / (len(READING) - 2)
    return np.asarray(found.value), np.asarray(covariance(jax.jacfwd(residual)(found.value), variance)), variance**0.5


def test_intercept_slope_and_scatter(thermometer):
    y, cov, s = thermometer
    assert f"{y[0]:.4f} {y[1]:.5f}" == "-0.1712 0.00218"
    assert f"{cov[0, 0] ** 0.5:.4f} {cov[1, 1] ** 0.5:.5f}" == "0.0029 0.00067"
    assert f"{cov[0, 1] / (cov[0, 0] * cov[1, 1]) ** 0.5:.3f}" == "-0.930"
    assert f"{s:.4f}" == "0.0035"


def test_the_correction_at_30_degrees(thermometer):
    y, cov, _ = thermometer
    at = np.array([1.0, 30.0 - REFERENCE])
    assert f"{at @ y:.4f}" == "-0.1494"
    assert f"{(at @ cov @ at) ** 0.5:.4f}" == "0.0041"
