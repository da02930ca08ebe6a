"""Population means of all parameters jointly: as dense algebra has them, and no more certain than the runs allow."""

import datetime

import numpy as np
import polars as pl
import pytest

from imubayes_archive.population.confounded_spreads import log_marginal, spread_slope, taken_by_others
from imubayes_archive.population.joint_population import JointPopulation, JointUnits
from imubayes_archive.population.parameter_population import populations
from imubayes_archive.unit_fits.posterior_table import (
    Outcome,
    Quantities,
    UnitIdentity,
    UnitPosterior,
    parameter_table,
    unit_table,
)

PRIOR = np.array([100.0, 80.0, 5.0])
MEAN, SPREAD = np.array([40.0, -30.0, 1.0]), np.array([12.0, 9.0, 0.8])


def units_of(
    seed: int, count: int, rows: np.ndarray, noise: float, spread: np.ndarray = SPREAD
) -> tuple[np.ndarray, list[UnitPosterior]]:
    """Return true values and posteriors of units that measure `rows` (k, 3) of their parameters."""
    random, found, truth = np.random.default_rng(seed), [], []
    for place in range(count):
        own = random.normal(MEAN, spread)
        data = rows @ own + random.normal(0, noise, len(rows))
        covariance = np.linalg.inv(rows.T @ rows / noise**2 + np.diag(PRIOR**-2.0))
        mean, sd = covariance @ rows.T @ data / noise**2, np.sqrt(np.diag(covariance))
        quantiles = mean + sd * np.array([-1.96, -0.674, 0.0, 0.674, 1.96])[:, None]
        quantities = Quantities(
            "parameter", ("a.a[ax]", "b.b[ax]", "c.c[ax]"), ("ug", "ppm", "ug"), mean, sd, quantiles, np.zeros(3),
            PRIOR, 1 - (sd / PRIOR) ** 2,
        )  # fmt: skip
        identity = UnitIdentity(f"U{place:02d}", "c", f"d{place}", "f", datetime.date(2024, 1, 1))
        found.append(UnitPosterior(identity, Outcome("fitted"), (quantities,), covariance))
        truth.append(own)
    return np.array(truth), found


def tables(units: list[UnitPosterior]) -> tuple[pl.DataFrame, pl.DataFrame]:
    return parameter_table("m", units), unit_table("m", "code", units)


def test_means_and_units_are_those_of_dense_algebra():
    random = np.random.default_rng(1)
    count, size = 4, 3
    roots = random.normal(size=(count, 2, size))
    information = np.einsum("nkp,nkq->npq", roots, roots)
    linear = np.einsum("npq,nq->np", information, random.normal(size=(count, size)))
    units = JointUnits(
        ("a", "b", "c"), tuple("wxyz"), np.zeros(size), np.ones(size), information, linear,
        np.ones((count, size), bool), np.full(count, np.inf),
    )  # fmt: skip
    variance, offsets = np.array([0.3, 0.7, 0.05]), random.normal(size=(count, size))
    found = JointPopulation(units, variance, np.ones((count, size)), offsets)
    check_slopes(found)
    # All unknowns at once: the units, then their mean.
    whole = count * size
    precision, right = np.zeros((whole + size, whole + size)), np.zeros(whole + size)
    precision[whole:, whole:] = np.eye(size)
    for place in range(count):
        own = slice(place * size, (place + 1) * size)
        law = np.diag(1 / variance)
        precision[own, own] += information[place] + law
        precision[own, whole:] -= law
        precision[whole:, own] -= law
        precision[whole:, whole:] += law
        right[own] += linear[place] + law @ offsets[place]
        right[whole:] -= law @ offsets[place]
    covariance = np.linalg.inv(precision)
    mean = covariance @ right
    np.testing.assert_allclose(found.means[0], mean[whole:], rtol=1e-9)
    np.testing.assert_allclose(found.means[1], covariance[whole:, whole:], rtol=1e-9)
    np.testing.assert_allclose(found.given[0].ravel(), mean[:whole], rtol=1e-9)
    np.testing.assert_allclose(found.given[1].ravel() ** 2, np.diag(covariance)[:whole], rtol=1e-9)


def check_slopes(found: JointPopulation) -> None:
    """The slope by the logarithms of the spreads is that of the marginal likelihood."""
    slope, step = spread_slope(found), 1e-4
    for place in range(len(found.variance)):
        moved = [found.with_spread(place, np.sqrt(found.variance[place]) * np.exp(k * step)) for k in (-1, 1)]
        low, high = (log_marginal(each) for each in moved)
        assert slope[place] == pytest.approx((high - low) / (2 * step), abs=1e-6)


@pytest.mark.parametrize("spread", [(40.0, 10.0), (10.0, 40.0)])
def test_spreads_of_a_sum_are_known_together_and_not_apart(spread):
    """The units measure a + b: the larger spread is either's, and neither is given all of the scatter."""
    _, units = units_of(310, 20, np.array([[1.0, 1.0, 0.0], [0.0, 0.0, 1.0]]), 0.5, np.array([*spread, 0.8]))
    a, b, _ = populations(*tables(units))[0].parameters
    for each, true in zip((a, b), spread, strict=True):
        assert each.spread_interval[0] < true < each.spread_interval[1]
    assert a.spread == pytest.approx(b.spread, rel=0.05)


def test_spreads_that_each_unit_determines_are_not_confounded():
    shape = 30, 3
    units = JointUnits(
        ("a", "b", "c"), tuple(map(str, range(30))), np.zeros(3), np.ones(3), np.tile(1e4 * np.eye(3), (30, 1, 1)),
        np.zeros(shape), np.ones(shape, bool), np.full(30, np.inf),
    )  # fmt: skip
    apart = JointPopulation(units, np.full(3, 0.1), np.ones(shape), np.zeros(shape))
    assert taken_by_others(apart) == pytest.approx(0.0, abs=1e-6)


def test_a_sum_that_all_units_measure_leaves_its_parts_as_uncertain_as_their_priors():
    """Forty units that measure a + b and c alone: the mean of a + b is known, and those of a and b are not."""
    _, units = units_of(2, 40, np.array([[1.0, 1.0, 0.0], [0.0, 0.0, 1.0]]), 0.5)
    record, _ = populations(*tables(units))
    a, b, c = record.parameters
    least = PRIOR[0] * PRIOR[1] / np.hypot(PRIOR[0], PRIOR[1])
    for each in (a, b):
        assert each.mean_sd > 0.9 * least
    assert a.mean + b.mean == pytest.approx(MEAN[0] + MEAN[1], abs=4 * 15 / np.sqrt(40))
    assert c.mean_sd < 0.3


@pytest.mark.slow
def test_units_given_the_others_are_within_their_uncertainty_whatever_they_measure():
    rows = np.array([[1.0, 1.0, 0.0], [1.0, -0.2, 0.0], [0.0, 0.0, 1.0]])
    errors, means = [], []
    for seed in range(20):
        truth, units = units_of(10 + seed, 15, rows, 8.0)
        record, given = populations(*tables(units))
        for place, name in enumerate(("a.a[ax]", "b.b[ax]")):
            of_name = given.filter(pl.col("parameter") == name)
            errors.extend((of_name["shrunk"].to_numpy() - truth[:, place]) / of_name["shrunk_sd"].to_numpy())
            each = record.parameters[place]
            means.append((each.mean - MEAN[place]) / each.mean_sd)
            assert of_name["shrunk_sd"].mean() < of_name["estimate_sd"].mean()
    assert 0.9 < np.sqrt(np.mean(np.square(errors))) < 1.1
    assert 0.7 < np.sqrt(np.mean(np.square(means))) < 1.3


@pytest.mark.slow
def test_intervals_of_confounded_spreads_hold_the_truth():
    """Forty archives of 20 units that measure a sum and little else; the units given the population as well."""
    held, errors = 0, []
    for seed in range(40):
        spread = np.array([*((40.0, 10.0) if seed % 2 else (10.0, 40.0)), 0.8])
        truth, units = units_of(700 + seed, 20, np.array([[1.0, 1.0, 0.0], [0.0, 0.0, 1.0]]), 8.0, spread)
        record, given = populations(*tables(units))
        for place, each in enumerate(record.parameters[:2]):
            held += each.spread_interval[0] < spread[place] < each.spread_interval[1]
            of_name = given.filter(pl.col("parameter") == each.parameter)
            errors.extend((of_name["shrunk"].to_numpy() - truth[:, place]) / of_name["shrunk_sd"].to_numpy())
    print(f"intervals: {held} of 80; rms of the units: {np.sqrt(np.mean(np.square(errors))):.3f}")
    assert held >= 68
    assert np.sqrt(np.mean(np.square(errors))) < 1.2


@pytest.mark.slow
def test_populations_and_units_are_those_of_the_joint_model_sampled():
    """Fifteen units: means, spreads and units against emcee on the marginal of means and spreads of all parameters."""
    import emcee

    rows, noise = np.array([[1.0, 1.0, 0.0], [1.0, -0.2, 0.0], [0.0, 0.0, 1.0]]), 8.0
    _, units = units_of(3, 15, rows, noise)
    record, given = populations(*tables(units))
    information = rows.T @ rows / noise**2
    linear = np.array([(information + np.diag(PRIOR**-2.0)) @ unit.quantities[0].mean for unit in units])
    error = np.linalg.inv(information)
    estimates = linear @ error

    def log_density(point: np.ndarray) -> float:
        spread = np.exp(point[3:])
        variance, misfit = error + np.diag(spread**2), estimates - point[:3]
        fit = np.einsum("np,pq,nq", misfit, np.linalg.inv(variance), misfit)
        prior = np.sum((point[:3] / PRIOR) ** 2) - 2 * np.sum(point[3:])
        return float(-0.5 * (fit + len(estimates) * np.linalg.slogdet(variance)[1] + prior))

    start = np.concatenate([MEAN, np.log(SPREAD)]) + 0.05 * np.random.default_rng(0).normal(size=(40, 6))
    sampler = emcee.EnsembleSampler(40, 6, log_density)
    state = sampler.run_mcmc(emcee.State(start, random_state=np.random.RandomState(1).get_state()), 1500)
    sampler.reset()
    sampler.run_mcmc(state, 6000)
    points = sampler.get_chain(flat=True)[::20]
    precision = np.exp(-2 * points[:, 3:])
    inner = np.linalg.inv(information + precision[:, :, None] * np.eye(3))
    unit = np.einsum("spq,snq->snp", inner, linear[None] + (points[:, :3] * precision)[:, None, :])
    mean = unit.mean(axis=0)
    sd = np.sqrt(unit.var(axis=0) + np.einsum("spp->sp", inner).mean(axis=0))
    for place, each in enumerate(record.parameters):
        rows_of = given.filter(pl.col("parameter") == each.parameter)
        spread = np.exp(points[:, 3 + place])
        assert each.mean == pytest.approx(points[:, place].mean(), abs=0.25 * points[:, place].std())
        assert each.mean_sd == pytest.approx(points[:, place].std(), rel=0.1)
        assert each.spread == pytest.approx(spread.mean(), abs=0.2 * spread.std())
        assert np.max(np.abs(rows_of["shrunk"].to_numpy() - mean[:, place]) / sd[:, place]) < 0.35
        assert np.max(np.abs(np.log(rows_of["shrunk_sd"].to_numpy() / sd[:, place]))) < 0.15
