"""Tail probabilities against mpmath, within the range of a double and far beyond it."""

import mpmath
import numpy as np
import pytest
import scipy.stats

from imubayes.foundations import tail_probabilities as tails

FREEDOM = (1, 2, 3, 7, 40, 1000)
VALUES = np.array([1e-2, 0.3, 5.0, 40.0, 200.0, 1300.0, 1600.0, 1e4, 1e5, 1e6])


def gamma_tail(chi2: float, freedom: float) -> float:
    with mpmath.workdps(60):
        return float(mpmath.log(mpmath.gammainc(mpmath.mpf(freedom) / 2, mpmath.mpf(chi2) / 2, regularized=True)))


def beta_tail(ratio: float, numerator: float, denominator: float) -> float:
    """Return log I_x(d₂/2, d₁/2) at x = d₂/(d₂ + d₁F), by the hypergeometric function."""
    with mpmath.workdps(60):
        a, b = mpmath.mpf(denominator) / 2, mpmath.mpf(numerator) / 2
        x = 1 / (1 + mpmath.mpf(ratio) * b / a)
        series = mpmath.hyp2f1(a + b, 1, a + 1, x)
        return float(mpmath.log(x**a * (1 - x) ** b / (a * mpmath.beta(a, b)) * series))


@pytest.mark.parametrize("freedom", FREEDOM)
def test_chi_square(freedom):
    expected = [gamma_tail(value, freedom) for value in VALUES.tolist()]
    np.testing.assert_allclose(tails.chi2_log_survival(VALUES, freedom), expected, rtol=1e-9, atol=1e-50)


@pytest.mark.parametrize("freedom", FREEDOM)
@pytest.mark.parametrize("denominator", [1, 2, 30, 1000])
def test_f(freedom, denominator):
    expected = [beta_tail(value, freedom, denominator) for value in VALUES.tolist()]
    np.testing.assert_allclose(tails.f_log_survival(VALUES, freedom, denominator), expected, rtol=1e-9, atol=1e-50)


def test_f_of_a_known_scale_is_chi_square():
    chi2 = np.array([1.0, 20.0, 300.0])
    expected = tails.chi2_log_survival(chi2, 3)
    np.testing.assert_allclose(tails.f_log_survival(chi2 / 3, 3, 1e9), expected, rtol=1e-6)


@pytest.mark.parametrize("freedom", FREEDOM)
def test_student(freedom):
    # t² is F with one degree of freedom, on both sides.
    expected = [beta_tail(value**2, 1, freedom) - np.log(2) for value in VALUES.tolist()]
    np.testing.assert_allclose(tails.t_log_survival(VALUES, freedom), expected, rtol=1e-9)
    np.testing.assert_allclose(tails.t_survival(-3.0, freedom), scipy.stats.t.sf(-3.0, freedom), rtol=1e-12)


def test_normal():
    with mpmath.workdps(60):
        expected = [float(mpmath.log(mpmath.erfc(mpmath.mpf(z) / mpmath.sqrt(2)) / 2)) for z in (-3.0, 0.1, 30.0, 1e6)]
    np.testing.assert_allclose(tails.normal_log_survival(np.array([-3.0, 0.1, 30.0, 1e6])), expected, rtol=1e-9)


def test_counts():
    assert tails.binomial_survival(3, 10, 0.2) == pytest.approx(scipy.stats.binom.sf(2, 10, 0.2))
    assert tails.binomial_survival(0, 10, 0.2) == 1.0


def test_probabilities_end_at_the_least_one():
    assert tails.chi2_survival(1e5, 2) == tails.f_survival(1e5, 2, 1e5) == tails.normal_survival(1e3) == tails.LEAST_P
    assert tails.p_value(-1e6) == tails.LEAST_P


def test_stronger_candidates_rank_before_weaker_ones_at_any_strength():
    chi2 = np.geomspace(1.0, 1e12, 200)
    assert np.all(np.diff(tails.chi2_log_survival(chi2, 2)) < 0)
    assert np.all(np.isfinite(tails.chi2_log_survival(chi2, 2)))
