"""The population of a parameter: recovered, honest about its uncertainty, and refused if draws are too few."""

import dataclasses

import numpy as np
import pytest
from scipy import integrate, stats

from imubayes_archive.population.population import UnitPosteriors, information_error, population, shrunk
from imubayes_archive.population.population_laws import mixture, normal_law, student_law

MEAN, SPREAD, PRIOR = 3.0, 2.0, (0.0, 5.0)


def simulated(seed, units=200, outliers=0, draws=np.inf, spread=SPREAD):
    """Return true values and the posteriors of units measured between a tenth and four times the spread."""
    random = np.random.default_rng(seed)
    truth = random.normal(MEAN, spread, units)
    truth[:outliers] += random.choice([-1, 1], outliers) * 10 * SPREAD
    variance = np.exp(random.uniform(np.log(0.2), np.log(8.0), units)) ** 2
    precision = 1 / variance + 1 / PRIOR[1] ** 2
    estimate = random.normal(truth, np.sqrt(variance))
    mean, sd = (estimate / variance + PRIOR[0] / PRIOR[1] ** 2) / precision, precision**-0.5
    if np.isfinite(draws):
        mean = random.normal(mean, sd / np.sqrt(draws))
        sd = sd * np.sqrt(random.chisquare(draws - 1, units) / (draws - 1))
    return truth, UnitPosteriors(mean, sd, *(np.full(units, each) for each in PRIOR), np.full(units, draws))


def coverage(prior_counted: bool) -> tuple[float, float]:
    """Return how often the 95 % intervals of mean and spread hold the truth, over 50 archives."""
    held = []
    for seed in range(50):
        truth, units = simulated(seed, 60)
        del truth
        if prior_counted:
            units = dataclasses.replace(units, prior_sd=np.full(60, np.inf), prior_mean=np.zeros(60))
        found = population(units)
        held.append([low < true < high for (low, high), true in (
            (found.mean_interval, MEAN), (found.spread_interval, SPREAD))])  # fmt: skip
    return tuple(np.mean(held, axis=0))


def test_mean_and_spread_of_200_units_are_recovered():
    for seed in (1, 2):
        found = population(simulated(seed)[1])
        assert abs(found.mean - MEAN) < 2 * found.mean_sd
        assert abs(found.spread - SPREAD) < 2 * found.spread_sd
        assert np.isinf(found.freedom)


def test_intervals_cover_unless_the_prior_is_counted_with_every_unit():
    for share in coverage(prior_counted=False):
        assert 0.9 <= share <= 1.0
    assert min(coverage(prior_counted=True)) < 0.9


def test_shrinkage_lowers_the_error_of_badly_measured_units():
    truth, units = simulated(3)
    after = shrunk(units, population(units))
    bad = units.likelihood[1] > 4 * SPREAD**2
    before = np.sqrt(np.mean((units.mean - truth)[bad] ** 2))
    assert np.sqrt(np.mean((after.mean - truth)[bad] ** 2)) < 0.85 * before
    assert 0.9 < np.mean(np.abs(after.mean - truth) < 1.96 * after.sd) < 0.99


def test_outliers_bring_the_t_law_and_are_named():
    _, units = simulated(4, outliers=6)
    found = population(units)
    after = shrunk(units, found)
    assert np.isfinite(found.freedom)
    assert abs(found.mean - MEAN) < 3 * found.mean_sd
    assert found.spread == pytest.approx(SPREAD, rel=0.35)
    sharp = units.likelihood[1][:6] < 4.0
    assert sharp.any()
    assert after.outlying[:6][sharp].all()
    assert after.outlying[6:].sum() <= 1
    assert shrunk(simulated(4)[1], population(simulated(4)[1])).outlying.sum() <= 1


def test_units_without_information_have_the_population_and_change_nothing():
    _, units = simulated(5, 50)
    blind = UnitPosteriors(*(np.append(getattr(units, name), value) for name, value in (
        ("mean", 0.0), ("sd", 5.0), ("prior_mean", 0.0), ("prior_sd", 5.0), ("draws", np.inf))))  # fmt: skip
    found = population(blind)
    assert found.mean == pytest.approx(population(units).mean, rel=1e-12)
    assert (found.units, found.informative) == (51, int(units.informative.sum()))
    last = shrunk(blind, found)
    assert (last.mean[-1], last.sd[-1]) == (pytest.approx(found.mean), pytest.approx(found.predictive_sd))
    assert "fewer than 5 units" in population(simulated(5, 4)[1]).reason


def test_a_spread_of_zero_lies_in_its_interval():
    assert population(simulated(6, 40, spread=0.0)[1]).spread_interval[0] == 0.0


@pytest.mark.parametrize("freedom", [2.0, 8.0])
def test_the_mixture_is_the_t_distribution(freedom):
    distance = np.array([0.0, 1.0, 10.0, 100.0])
    density = mixture(distance**2, np.full(4, 1e-14), 1.0, freedom).sum(axis=1)
    assert np.allclose(np.log(density), stats.t.logpdf(distance, freedom), atol=1e-3)


def test_the_evidence_of_the_normal_law_is_that_of_direct_integration():
    estimate, variance = np.array([1.0, 2.0, -0.5, 0.3, 1.2, 0.7]), np.array([0.3, 0.5, 0.2, 0.6, 0.1, 0.4])

    def density(mean, spread):
        return np.prod(stats.norm.pdf(estimate, mean, np.sqrt(variance + spread**2)))

    whole = integrate.dblquad(density, 0, 60, -8, 8, epsrel=1e-5)[0]
    assert normal_law(estimate, variance).log_evidence == pytest.approx(np.log(whole), abs=0.01)
    # With many degrees of freedom the t law is the normal one.
    assert student_law(estimate, variance, 400.0).of_centre()[0] == pytest.approx(
        normal_law(estimate, variance).of_centre()[0], abs=0.02
    )


def test_the_information_error_is_the_divergence_that_draws_cause():
    # The average Kullback–Leibler divergence of the estimated posterior from the exact one, on the exact one's grid.
    _, exact = simulated(7, 40)
    posterior = normal_law(*(each[exact.informative] for each in exact.likelihood))
    stated = information_error(posterior, dataclasses.replace(exact, draws=np.full(40, 100.0)))
    random, lost = np.random.default_rng(8), []
    for _ in range(60):
        mean = random.normal(exact.mean, exact.sd / 10)
        sd = exact.sd * np.sqrt(random.chisquare(99, 40) / 99)
        noisy = dataclasses.replace(exact, mean=mean, sd=sd)
        lost.append(_divergence(exact, noisy))
    assert stated == pytest.approx(np.mean(lost), rel=0.5)


def _divergence(exact, noisy):
    centres, spreads = np.linspace(0.0, 6.0, 61)[:, None, None], np.linspace(0.3, 5.0, 61)[:, None]
    log_density = []
    for units in (exact, noisy):
        estimate, variance = (each[units.informative] for each in units.likelihood)
        total = variance + spreads**2
        each = -0.5 * np.sum(np.log(total) + (estimate - centres) ** 2 / total, axis=-1)
        log_density.append(each - np.log(np.exp(each - each.max()).sum()) - each.max())
    return np.sum(np.exp(log_density[0]) * (log_density[0] - log_density[1])) / np.log(2)


def badly_measured(draws: float) -> UnitPosteriors:
    """Return 40 units whose data say less than their prior, each by so many draws."""
    random, variance, prior = np.random.default_rng(1), 16.0, 9.0
    square = 1 / (1 / variance + 1 / prior)
    mean = random.normal(random.normal(0, np.sqrt(variance), 40) * square / variance, np.sqrt(square / draws))
    sd = np.sqrt(square * random.chisquare(draws - 1, 40) / (draws - 1))
    return UnitPosteriors(mean, sd, np.zeros(40), np.full(40, 3.0), np.full(40, draws))


def test_too_few_draws_are_refused():
    poor = badly_measured(10.0)
    found = population(poor)
    assert found.information_error > 0.2
    assert "information error" in found.reason
    assert np.isnan(found.mean)
    with pytest.raises(ValueError, match="information error"):
        shrunk(poor, found)
    assert population(badly_measured(200.0)).reason == ""
