"""Variance with the linear part as control variate: unbiased, sharper than the draws, and refused if it is wrong."""

import numpy as np
import pytest

from imubayes.results.linear_part import thinned_scales
from imubayes.results.posterior_variance import KnownVariance, variance_of

KNOWN = KnownVariance(4.0, 0.0)


def draws(seed: int, size: int = 4000, curved: float = 0.05, width: float = 2.0) -> tuple[np.ndarray, np.ndarray]:
    """A quantity u + c (u² − 4), whose variance is 4 + 32 c², and its linear part u."""
    u = np.random.default_rng(seed).normal(0, width, size)
    return u + curved * (u**2 - 4), u


def test_unbiased_with_the_error_that_is_stated():
    found = [variance_of(*draws(seed), KNOWN, 4000.0) for seed in range(300)]
    values, errors, slopes = (np.array([getattr(each, name) for each in found]) for name in ("value", "error", "slope"))
    true = 4 + 32 * 0.05**2
    assert values.mean() == pytest.approx(true, abs=4 * values.std() / np.sqrt(300))
    middle = np.diff(np.quantile(values, [0.16, 0.84]))[0] / 2
    assert middle == pytest.approx(errors.mean(), rel=0.15)
    # Five times sharper than the sample variance.
    assert errors.mean() < 0.5 * true * np.sqrt(2 / 4000)
    assert slopes.mean() == pytest.approx(1.0, abs=0.01)


def test_the_draws_that_are_averaged_over_do_not_depend_on_their_order():
    """A result folder keeps chain after chain, and the fit has their points side by side."""
    rng = np.random.default_rng(1)
    h = rng.standard_normal((50_000, 3))
    found, other = thinned_scales(h, 120), thinned_scales(rng.permutation(h), 120)
    assert 40 < len(found) < 1000
    np.testing.assert_array_equal(found, other)
    assert len(thinned_scales(h, 5)) == len(h)
    assert thinned_scales(np.zeros((100, 0)), 5).shape == (1, 0)


def test_a_linear_part_of_another_width_is_scaled():
    """Planted fault: the approximation is 1.2 times too narrow; the variance of the draws is what is reported."""
    values, linear = draws(1, curved=0.0, width=2.4)
    found = variance_of(values, linear, KNOWN, 4000.0)
    assert found.value == pytest.approx(np.var(values), rel=1e-12)
    assert found.value == pytest.approx(2.4**2, abs=4 * found.error)
    assert found.slope == pytest.approx(1.0, abs=1e-12)
    assert found.slope * found.widened == pytest.approx(np.std(values) / 2, rel=1e-9)


def test_another_distribution_is_not_scaled():
    values, linear = draws(1, curved=0.0, width=3.0)
    found = variance_of(values, linear, KNOWN, 4000.0)
    assert (found.slope, found.widened) == (1.0, 1.0)


@pytest.mark.parametrize("left", [0.2, 0.6, 1.1])
def test_a_quantity_of_the_known_width_keeps_its_budget_whatever_is_left_in_the_sampled_linear_part(left):
    """A sum known a thousand times better than its members: bend of these is left in what the draws have as linear."""
    values, own = draws(3, curved=0.0)
    bent = own + left * 2.0 * (np.random.default_rng(4).chisquare(1, len(own)) - 1) / np.sqrt(2)
    found = variance_of(values, bent, KNOWN, 4000.0)
    # Contributions, which add up to 4, are not scaled, and nothing is left of the posterior variance.
    assert (found.value, found.slope, found.widened, found.follows) == (4.0, 1.0, 1.0, False)
    assert found.error == pytest.approx(4.0 * np.sqrt(2 / 4000), rel=0.1)


def test_missing_draws_are_left_out():
    values, linear = draws(2)
    values[::3] = np.nan
    assert np.isfinite(variance_of(values, linear, KNOWN, 4000.0).value)
