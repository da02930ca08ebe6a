"""Variance with the linear part as control variate: unbiased, sharper than the draws, and refused where it is wrong."""

import numpy as np
import pytest

from imubayes.qualification.budget_parts import KnownVariance, _variance

KNOWN = KnownVariance(4.0, 0.0)


def draws(seed: int, size: int = 4000, curved: float = 0.05, width: float = 2.0) -> tuple[np.ndarray, np.ndarray]:
    """A quantity u + c (u² − 4), whose variance is 4 + 32 c², and its linear part u."""
    u = np.random.default_rng(seed).normal(0, width, size)
    return u + curved * (u**2 - 4), u


def test_unbiased_with_the_error_that_is_stated():
    found = np.array([_variance(*draws(seed), KNOWN, 4000.0) for seed in range(300)])
    true = 4 + 32 * 0.05**2
    assert found[:, 0].mean() == pytest.approx(true, abs=4 * found[:, 0].std() / np.sqrt(300))
    middle = np.diff(np.quantile(found[:, 0], [0.16, 0.84]))[0] / 2
    assert middle == pytest.approx(found[:, 1].mean(), rel=0.15)
    # Five times sharper than the sample variance.
    assert found[:, 1].mean() < 0.5 * true * np.sqrt(2 / 4000)
    assert found[:, 2].mean() == pytest.approx(1.0, abs=0.01)


def test_a_linear_part_of_another_width_is_scaled():
    """Planted fault: the approximation is 1.2 times too narrow; the variance of the draws is what is reported."""
    values, linear = draws(1, curved=0.0, width=2.4)
    variance, error, slope, widened = _variance(values, linear, KNOWN, 4000.0)
    assert variance == pytest.approx(np.var(values), rel=1e-12)
    assert variance == pytest.approx(2.4**2, abs=4 * error)
    assert slope == pytest.approx(1.0, abs=1e-12)
    assert slope * widened == pytest.approx(np.std(values) / 2, rel=1e-9)


def test_another_distribution_is_not_scaled():
    values, linear = draws(1, curved=0.0, width=3.0)
    assert _variance(values, linear, KNOWN, 4000.0)[2:] == (1.0, 1.0)


def test_missing_draws_are_left_out():
    values, linear = draws(2)
    values[::3] = np.nan
    assert np.isfinite(_variance(values, linear, KNOWN, 4000.0)).all()
