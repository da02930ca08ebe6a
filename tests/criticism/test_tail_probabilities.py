"""Tail probabilities against integration and against `scipy.stats`."""

import numpy as np
import pytest
import scipy.stats
from scipy.integrate import quad

from imubayes.criticism.tail_probabilities import chi2_log_survival


@pytest.mark.parametrize("freedom", [1, 2, 3, 7, 40])
def test_within_double_range_it_agrees_with_scipy_stats(freedom):
    chi2 = np.array([0.0, 1e-9, 0.3, 10.0, 200.0, 1200.0])
    expected = scipy.stats.chi2.logsf(chi2, freedom)
    np.testing.assert_allclose(chi2_log_survival(chi2, freedom), expected, rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("freedom", [1, 3, 7, 40])
@pytest.mark.parametrize("chi2", [1400.0, 1e4, 1e6])
def test_beyond_it_agrees_with_the_integral_of_the_density(chi2, freedom):
    at_chi2 = scipy.stats.chi2.logpdf(chi2, freedom)
    # Relative to the density at χ² the tail decays like exp(−t/2).
    ratio, _ = quad(lambda t: np.exp(scipy.stats.chi2.logpdf(chi2 + t, freedom) - at_chi2), 0, 200, epsrel=1e-10)
    assert chi2_log_survival(chi2, freedom) == pytest.approx(at_chi2 + np.log(ratio), abs=1e-8)


def test_stronger_candidates_rank_before_weaker_ones_at_any_strength():
    chi2 = np.geomspace(1.0, 1e12, 200)
    assert np.all(np.diff(chi2_log_survival(chi2, 2)) < 0)
    assert np.all(np.isfinite(chi2_log_survival(chi2, 2)))
