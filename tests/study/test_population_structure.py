"""How often groups, steps and trends of an archive are found, listed right, distinguished, and invented."""

import numpy as np
import pytest
from scipy.stats import binomtest

from imubayes_archive.population.population_search import Structure, UnitCovariate, search
from imubayes_archive.population.population_structure import UnitEstimates

UNITS, PARAMETERS, WIDTH, APART = 60, 8, 30.0, 4.0


def archive(seed: int, count: int = UNITS) -> tuple[np.random.Generator, np.ndarray, np.ndarray, list[UnitCovariate]]:
    """Return estimates of one group with unequal uncertainties, their variances, and covariates without meaning."""
    random = np.random.default_rng(seed)
    error = np.exp(random.uniform(np.log(0.5), np.log(1.5), count))
    values = random.normal(0.0, np.hypot(0.7, error))
    serials = random.permutation(count)
    days = np.sort(random.uniform(0, 1000, count))
    known = [
        UnitCovariate("date", tuple(f"{day:.1f}" for day in days), days, "day"),
        UnitCovariate("serial number", tuple(map(str, serials)), serials.astype(float), "unit"),
        UnitCovariate("table", tuple(random.choice(["p", "q"], count))),
        UnitCovariate("lot", tuple(random.choice(["A", "B", "C", "D"], count))),
    ]
    return random, values, error**2, known


def found(values: np.ndarray, variance: np.ndarray, known: list[UnitCovariate]) -> Structure:
    return search(UnitEstimates(values, variance, WIDTH), known)


def report(what: str, hits: int, of: int) -> int:
    interval = binomtest(hits, of).proportion_ci(0.95)
    print(f"{what}: {hits} of {of} ({interval.low:.2f} to {interval.high:.2f})")
    return hits


@pytest.mark.slow
def test_archives_of_one_group_have_no_structure():
    alarms = 0
    for seed in range(40):
        of_archive = 0
        for parameter in range(PARAMETERS):
            _, values, variance, known = archive(1000 * seed + parameter, (12, 30, 60)[seed % 3])
            of_archive += bool(found(values, variance, known).findings)
        alarms += of_archive > 0
    assert report("archives with a false structure", alarms, 40) <= 3


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.05, 0.1, 0.25, 0.5])
def test_lots_of_unknown_members_are_listed(share):
    listed = 0
    for seed in range(20):
        random, values, variance, known = archive(5000 + seed)
        lot = random.permutation(UNITS) < round(share * UNITS)
        values = values + lot * APART * np.sqrt(0.49 + np.median(variance))
        structure = found(values, variance, known)
        kinds = [each.candidate.kind for each in structure.findings]
        if kinds != ["groups"]:
            continue
        second = structure.findings[0].fit.membership[:, 1] > 0.5
        listed += min(np.sum(second != lot), np.sum(second == lot)) <= max(2, 0.1 * UNITS)
    report(f"lots of {share:.0%}", listed, 20)


@pytest.mark.slow
def test_steps_trends_and_lots_that_are_stated_are_told_apart():
    right = dict.fromkeys(("step over date", "trend over date", "levels over lot", "levels over table"), 0)
    for seed in range(20):
        _, values, variance, known = archive(9000 + seed)
        days, tables, lots = known[0].ordered, np.array(known[2].shown), np.array(known[3].shown)
        planted = {
            "step over date": 3.0 * (days > 400), "trend over date": 6.0 * days / 1000,
            "levels over lot": 3.0 * (lots == "B"), "levels over table": 2.0 * (tables == "q"),
        }  # fmt: skip
        for name, effect in planted.items():
            findings = found(values + effect, variance, known).findings
            right[name] += bool(findings) and findings[0].candidate.name == name
    for name, hits in right.items():
        report(name, hits, 20)
    assert min(right.values()) >= 17
