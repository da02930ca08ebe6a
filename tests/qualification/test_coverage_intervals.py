"""Coverage factors, intervals and expanded uncertainties of posteriors whose distribution is known."""

import math

import numpy as np
import pytest
from scipy import stats

from imubayes.results.marginal import Marginal
from imubayes_qualification.evaluation.coverage import (
    KnownUncertainty,
    coverage_factor,
    coverage_of,
    coverage_of_length,
    coverage_with_scatter,
    equivalent_degrees,
    shortest_interval,
)

SIZE = 16_000


def marginal(law, seed: int) -> Marginal:
    return Marginal(law.rvs(SIZE, random_state=np.random.default_rng(seed)), float(SIZE))


@pytest.mark.parametrize("degrees", [9.0, 60.0, math.inf])
def test_k_is_that_of_the_degrees_of_freedom_whatever_the_draws(degrees):
    """Quantiles of 16 000 draws over u scatter by 2 %; k of the same posterior is the same number every time."""
    scale = 0.7
    law = stats.norm(3.0, scale) if math.isinf(degrees) else stats.t(degrees, 3.0, scale)
    known = KnownUncertainty(float(law.std()), 1e-4, coverage_factor(degrees))
    found = [coverage_of(marginal(law, seed), known) for seed in range(20)]
    symmetric = [each for each in found if each.shape == "symmetric"]
    assert len(symmetric) >= 18
    exact = float(law.ppf(0.975) - 3.0)
    for each in symmetric:
        assert each.expanded == pytest.approx(exact, rel=1e-9)
        assert each.factor == pytest.approx(exact / float(law.std()), rel=1e-9)
        assert (each.low + each.high) / 2 == pytest.approx(each.estimate)
        assert each.standard == known.standard
    scatter = np.std([(draws.interval[1] - draws.interval[0]) / 2 for draws in (marginal(law, s) for s in range(20))])
    assert scatter > 1e-3 * exact, "quantiles of draws alone do scatter"


@pytest.mark.parametrize("law", [stats.gamma(6), stats.lognorm(0.3), stats.uniform()])
def test_a_posterior_of_another_shape_keeps_the_interval_of_its_draws(law):
    draws = marginal(law, 4)
    found = coverage_of(draws, KnownUncertainty(float(law.std()), 1e-4))
    assert found.shape == "equal-tailed"
    assert (found.low, found.high) == draws.interval


def test_few_degrees_of_freedom_have_no_standard_deviation_to_multiply():
    assert (
        coverage_of(marginal(stats.t(3), 1), KnownUncertainty(1.7, 0.1, coverage_factor(3.0))).shape == "equal-tailed"
    )
    # GUM table G.2: 2.26 at 9, 1.96 without limit; k is of the posterior's own standard deviation.
    assert (coverage_factor(9.0) or 0.0) * math.sqrt(9 / 7) == pytest.approx(2.262, abs=5e-4)
    assert coverage_factor(math.inf) == pytest.approx(1.95996, abs=1e-5)


@pytest.mark.parametrize("degrees", [4.5, 11.0, 60.0, 1e4, math.inf])
def test_a_program_that_forms_t_times_u_is_given_degrees_of_freedom_that_make_the_same_u(degrees):
    """u contains that the scatter is known from few rows: t of its degrees of freedom counts it twice."""
    scale = 0.7
    u = scale * (1.0 if math.isinf(degrees) else math.sqrt(degrees / (degrees - 2)))
    expanded = float((stats.norm if math.isinf(degrees) else stats.t(degrees)).ppf(0.975)) * scale
    k = coverage_factor(degrees)
    assert k is not None
    assert k * u == pytest.approx(expanded, rel=1e-9)
    assert stats.t.ppf(0.975, equivalent_degrees(k)) * u == pytest.approx(expanded, rel=1e-9)
    if degrees < 100:
        assert stats.t.ppf(0.975, degrees) * u > 1.01 * expanded


@pytest.mark.parametrize("length", [0.0, 1.0, 8.0])
def test_a_direction_error_is_the_length_of_its_mean_with_the_shortest_interval(length):
    """The mean of the length of a vector that is zero is 1.25 u: an error that the axis does not have."""
    random = np.random.default_rng(7)
    draws = np.hypot(length + random.standard_normal(SIZE), random.standard_normal(SIZE))
    found = coverage_of_length(Marginal(draws, float(SIZE)), length)
    assert found.estimate == length
    assert found.shape == "shortest"
    assert found.low <= length <= found.high
    assert np.mean((draws >= found.low) & (draws <= found.high)) == pytest.approx(0.95, abs=1e-3)
    if not length:
        assert (found.low, found.high) == (0.0, pytest.approx(stats.rayleigh().ppf(0.95), rel=0.02))
        assert draws.mean() > 1.2
        return
    grid = np.linspace(0, 0.05, 2001)
    law = stats.rice(length)
    widths = law.ppf(np.minimum(grid + 0.95, 1 - 1e-12)) - law.ppf(grid)
    assert found.high - found.low == pytest.approx(widths.min(), rel=0.03)


def test_the_shortest_interval_of_a_skewed_quantity_is_shorter_than_that_of_equal_tails():
    ordered = np.sort(marginal(stats.expon(), 3).draws)
    low, high = shortest_interval(ordered)
    assert low < 0.01
    assert high == pytest.approx(-math.log(0.05), rel=0.03)
    assert high - low < np.diff(np.quantile(ordered, [0.025, 0.975]))[0]


@pytest.mark.parametrize("log_sd", [0.1, 0.3, 0.6])
def test_k_of_an_offset_whose_scatter_is_uncertain_is_that_of_its_own_posterior(log_sd):
    """Normal with a lognormal scatter: by quadrature over the scatter, y ± U holds 95 %, and y ± 1.96 u less."""
    own, median = 0.4, 1.0
    nodes, weights = np.polynomial.hermite_e.hermegauss(60)
    width, weight = np.hypot(own, median * np.exp(log_sd * nodes)), weights / weights.sum()

    def held(half: float) -> float:
        return float(weight @ (2 * stats.norm.cdf(half / width) - 1))

    u = math.sqrt(float(weight @ width**2))
    found = []
    for seed in range(8):
        random = np.random.default_rng(seed)
        centre = Marginal(7.0 + own * random.standard_normal(SIZE), float(SIZE))
        found.append(coverage_with_scatter(centre, median * np.exp(log_sd * random.standard_normal(SIZE))))
    assert sum(each.shape == "symmetric" for each in found) >= 7
    assert np.mean([held(each.expanded) for each in found]) == pytest.approx(0.95, abs=1e-3)
    for each in found:
        assert held(each.expanded) == pytest.approx(0.95, abs=0.004)
        assert each.standard == pytest.approx(u, rel=0.02)
        assert each.expanded == pytest.approx(each.factor * each.standard)
    if log_sd > 0.2:
        assert held(float(stats.norm.ppf(0.975)) * u) < 0.948
    # Errors are those of the ends from seed to seed.
    ends = np.std([each.high - each.estimate for each in found])
    assert 0.4 < ends / np.mean([math.hypot(each.errors.low, each.errors.high) / 2 for each in found]) < 1.8


def test_an_offset_with_a_skew_posterior_keeps_its_ends():
    random = np.random.default_rng(3)
    centre = Marginal(random.gamma(3.0, 1.0, SIZE), float(SIZE))
    found = coverage_with_scatter(centre, np.full(SIZE, 0.3))
    assert found.shape == "equal-tailed"
    exact = stats.gamma(3.0).rvs(400_000, random_state=1) + 0.3 * np.random.default_rng(2).standard_normal(400_000)
    assert (found.low, found.high) == pytest.approx(np.quantile(exact, [0.025, 0.975]), abs=0.06)
