"""Groups, steps, trends and covariates of a population: found with their units, distinguished, and not invented."""

import numpy as np
import pytest

from imubayes_archive.population.population_findings import laws_of
from imubayes_archive.population.population_search import UnitCovariate, search
from imubayes_archive.population.population_structure import Law, UnitEstimates, fit_law

WIDTH, SPREAD, ERROR = 20.0, 0.5, 1.0
TOTAL = float(np.hypot(SPREAD, ERROR))


def simulated(seed: int, count: int, tails: bool = False) -> tuple[np.random.Generator, np.ndarray]:
    random = np.random.default_rng(seed)
    return random, TOTAL * (random.standard_t(4, count) if tails else random.standard_normal(count))


def covariates(random: np.random.Generator, count: int) -> list[UnitCovariate]:
    days = random.uniform(0, 1000, count)
    return [
        UnitCovariate("date", tuple(f"{day:.0f}" for day in days), days, "day"),
        UnitCovariate("serial number", tuple(map(str, range(count))), np.arange(count, dtype=float), "unit"),
        UnitCovariate("lot", tuple(random.choice(["A", "B", "C"], count))),
        UnitCovariate("table", tuple(random.choice(["p", "q"], count))),
    ]


def found(values: np.ndarray, known: list[UnitCovariate]):
    return search(UnitEstimates(values, np.full(len(values), ERROR**2), WIDTH), known)


def names(values: np.ndarray, known: list[UnitCovariate]) -> list[str]:
    return [each.candidate.name for each in found(values, known).findings]


@pytest.mark.parametrize("seed", range(4))
def test_units_of_one_group_have_no_structure(seed):
    for count in (12, 40):
        random, values = simulated(seed, count)
        assert names(values, covariates(random, count)) == []


def test_heavy_tails_are_no_groups():
    random, values = simulated(21, 60, tails=True)
    assert names(values, covariates(random, 60)) == []


def test_each_structure_is_told_from_the_others():
    for seed in range(2):
        random, values = simulated(30 + seed, 40)
        known = covariates(random, 40)
        days, lots, tables = known[0].ordered, np.array(known[2].shown), np.array(known[3].shown)
        apart = random.permutation(40) < 12
        assert names(values + 4 * TOTAL * (days > 500), known) == ["step over date"]
        assert names(values + 8 * TOTAL * days / 1000, known) == ["trend over date"]
        assert names(values + 3 * TOTAL * (lots == "B"), known) == ["levels over lot"]
        assert names(values + 6 * TOTAL * apart, known) == ["groups"]
        both = values + 4 * TOTAL * (lots == "B") + 4 * TOTAL * (tables == "q")
        assert set(names(both, known)) == {"levels over lot", "levels over table"}


def test_groups_are_listed_by_name_with_their_offset():
    random, values = simulated(41, 30)
    apart = random.permutation(30) < 5
    units = [f"U{place:02d}" for place in range(30)]
    laws = laws_of(found(values + 10 * TOTAL * apart, []), units)
    (finding,) = laws.findings
    first, second = finding.groups
    assert finding.probability > 0.95
    assert second.units == tuple(unit for unit, is_in in zip(units, apart, strict=True) if is_in)
    assert set(first.units) | set(second.units) == set(units)
    assert second.offset == pytest.approx(10 * TOTAL, abs=3 * second.offset_sd)
    assert finding.undecided == ()


def test_a_place_of_a_step_has_the_units_after_it():
    random, values = simulated(43, 40)
    serials = covariates(random, 40)[1]
    laws = laws_of(found(values + 5 * TOTAL * (np.arange(40) >= 25), [serials]), serials.shown)
    (finding,) = laws.findings
    assert (finding.kind, finding.at) == ("step", "between 24 and 25")
    assert finding.groups[1].units == tuple(map(str, range(25, 40)))


def test_a_single_unit_apart_is_outside_and_no_group():
    _, values = simulated(44, 30)
    values[3] += 12 * TOTAL
    structure = found(values, [])
    assert structure.findings == ()
    one = fit_law(UnitEstimates(values, np.full(30, ERROR**2), WIDTH), Law(np.zeros((30, 0))))
    assert one.membership[3, -1] > 0.99
    assert np.delete(one.membership[:, -1], 3).max() < 0.5


def test_the_evidence_of_one_group_is_that_of_direct_integration():
    _, values = simulated(45, 8)
    units = UnitEstimates(values, np.full(8, ERROR**2), WIDTH)
    centre = np.linspace(-6, 6, 601)
    total = []
    for spread in units.spreads:
        variance = spread**2 + ERROR**2
        inside = np.exp(-0.5 * (values - centre[:, None]) ** 2 / variance) / np.sqrt(2 * np.pi * variance)
        far = WIDTH**2 + ERROR**2
        outside = np.exp(-0.5 * (values - np.median(values)) ** 2 / far) / np.sqrt(2 * np.pi * far)
        total.append(np.log(np.sum(np.prod(0.99 * inside + 0.01 * outside, axis=1)) * (centre[1] - centre[0])))
    direct = np.logaddexp.reduce(total) - np.log(len(total))
    assert fit_law(units, Law(np.zeros((8, 0)))).log_evidence == pytest.approx(direct, abs=0.1)
