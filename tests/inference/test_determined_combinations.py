"""Combinations that the data determine, against the row space of designs whose information is known exactly."""

import numpy as np
import pytest

from imubayes.inference.determined_combinations import MUCH_LESS, Draws, determined_combinations, members
from imubayes.procedures.fitted_terms import LinearCombination, ProjectedScaleFactor, estimable

NOTHING = Draws((), (), np.zeros((4000, 0)))
NAMES = ("f", "i", "ii", "oo", "ss")
TUMBLE = np.array([[1, 0, 1, 0, 0], [1, 0, 0, 1, 0], [1, 0, 0, 0, 1], [0, 1, 0, 0, 0]], float)


def posterior(design: np.ndarray, noise: float, prior: np.ndarray, seed: int = 0) -> tuple[np.ndarray, Draws]:
    """Return the precision in z of a linear model y = X β + ν, and draws of its posterior about 0."""
    precision = np.eye(len(prior)) + (design * prior).T @ (design * prior) / noise**2
    inverse = np.linalg.inv(precision)
    covariance = 0.5 * (inverse + inverse.T)  # symmetric to the last digit, whatever the processor's rounding
    draws = np.random.default_rng(seed).multivariate_normal(np.zeros(len(prior)), covariance, 4000)
    return precision, Draws(tuple(f"x{n}" for n in range(len(prior))), ("1",) * len(prior), draws * prior)


def dense(found, names) -> np.ndarray:
    weights = np.zeros((len(found), len(names)))
    for row, each in zip(weights, found, strict=True):
        row[[names.index(name) for name in each.quantities]] = each.weights
    return weights


def test_sums_of_a_tumble_are_found_without_a_list():
    """D_F has a wide prior and D_JJ narrow ones: almost all of D_F comes from the data, and yet only sums are known."""
    precision, draws = posterior(TUMBLE, 0.001, np.array([5.0, 5.0, 0.1, 0.1, 0.1]))
    chosen = members(precision)
    assert chosen.tolist() == [True, False, True, True, True]
    found = determined_combinations(draws._replace(names=NAMES), chosen, NOTHING)
    weights = dense(found, NAMES)
    assert len(found) == 3
    assert set(np.abs(weights[weights != 0])) == {1.0}
    assert np.all(np.count_nonzero(weights, axis=1) == 2)
    residual = weights - weights @ np.linalg.pinv(TUMBLE) @ TUMBLE
    assert np.abs(residual).max() < 1e-9


@pytest.mark.parametrize("seed", range(12))
def test_every_combination_is_estimable_and_none_is_missing(seed):
    """The members' part of the row space is found: same dimension, and nothing outside it."""
    generator = np.random.default_rng(seed)
    size, rank = 7, int(generator.integers(3, 6))
    design = np.round(generator.normal(size=(rank, size)) * (generator.random((rank, size)) < 0.5))
    precision, draws = posterior(design, 1e-4, np.exp(generator.uniform(-1, 1, size)), seed)
    chosen = members(precision)
    found = determined_combinations(draws, chosen, NOTHING)
    names = tuple(draws.names)
    wanted = [each for each in estimable(design, names) if not each.single]
    assert len(found) == len(wanted)
    deviation = np.std(draws.values, axis=0)
    for each, weights in zip(found, dense(found, names), strict=True):
        spread = np.std(draws.values @ weights)
        there = weights != 0
        assert spread < MUCH_LESS * np.min(np.abs(weights[there]) * deviation[there]), each
        assert not np.any(there & ~chosen)
        # Whatever the rounding, it stays within the uncertainty.
        rest = weights - weights @ np.linalg.pinv(design) @ design
        assert np.sqrt(np.sum((rest * deviation) ** 2)) < 2 * spread


def test_a_standard_combination_has_its_symbol_and_takes_the_place_of_one_found():
    precision, draws = posterior(TUMBLE, 0.001, np.array([5.0, 5.0, 0.1, 0.1, 0.1]))
    draws = draws._replace(names=NAMES)
    declared = [
        LinearCombination("D_F+D_II", "deg/h", {"f": 1.0, "ii": 1.0}),
        LinearCombination("wrong", "deg/h", {"f": 1.0, "ii": -1.0}),
        LinearCombination("of one that is known", "deg/h", {"f": 1.0, "i": 1.0, "ii": 1.0}),
        LinearCombination("of one that the model lacks", "deg/h", {"f": 1.0, "ii": 1.0, "absent": 1.0}),
        LinearCombination("total", "deg/h", {"f": 1.0, "i": 0.5, "oo": 1.0, "absent": 1.0}, total=True),
    ]
    found = determined_combinations(draws, members(precision), NOTHING, declared)
    assert [each.symbol for each in found] == ["D_F+D_II", "total", ""]
    assert found[1].quantities == ("f", "i", "oo")


def test_where_everything_is_determined_there_is_nothing_to_combine():
    precision, draws = posterior(np.eye(4), 1e-3, np.ones(4))
    assert not members(precision).any()
    assert not determined_combinations(draws, members(precision), NOTHING)


def test_a_prior_alone_combines_nothing():
    precision, draws = posterior(np.zeros((1, 4)), 1.0, np.ones(4))
    assert members(precision).all()
    assert not determined_combinations(draws, members(precision), NOTHING)


FIRST_HARMONIC = {"k1": 1.0, "k3": 0.75, "koq": 0.85}


def first_harmonic(priors: np.ndarray, *standard: LinearCombination, further: tuple[list[float], ...] = ()):
    """Return what is found of K1 + 3/4 K3 + 8/(3π) K_oq, which one tumble determines to 1 ppm."""
    design = np.array([list(FIRST_HARMONIC.values()), *further])
    precision, draws = posterior(design, 1.0, priors)
    draws = draws._replace(names=tuple(FIRST_HARMONIC))
    return determined_combinations(draws, members(precision), NOTHING, standard)


def declared(*terms: str) -> LinearCombination:
    return LinearCombination("+".join(terms), "ppm", {term: FIRST_HARMONIC[term] for term in terms})


ODD = (declared("k1", "k3", "koq"), declared("k1", "k3"), declared("k1", "koq"))


def test_a_member_with_a_narrow_prior_does_not_lose_the_sum():
    """K3 and K_oq are known before the test to 4 ppm each, hardly worse than the sum after it."""
    found = first_harmonic(np.array([300.0, 5.0, 5.0]), *ODD)
    assert [each.symbol for each in found] == ["k1+k3+koq"]
    # K_oq contributes hardly more than the sum is uncertain by: it stays in, as the standard has it.
    found = first_harmonic(np.array([300.0, 5.0, 1.5]), *ODD)
    assert [each.symbol for each in found] == ["k1+k3+koq"]
    (undeclared,) = first_harmonic(np.array([300.0, 5.0, 5.0]))
    assert {name: abs(w) for name, w in zip(undeclared.quantities, undeclared.weights, strict=True)} == pytest.approx(
        {name: w / FIRST_HARMONIC[undeclared.quantities[0]] for name, w in FIRST_HARMONIC.items()}, abs=0.1
    )


def test_a_single_well_known_parameter_is_no_combination():
    """With K3 and K_oq known before the test to a tenth of its noise there is K1 alone."""
    assert not first_harmonic(np.array([300.0, 0.1, 0.1]), *ODD)
    assert not first_harmonic(np.array([300.0, 1.5, 1.5]), *ODD)


def test_members_that_are_correlated_but_not_weak_have_a_standard_sum():
    """Three harmonics determine K1, K3 and K_oq, each from data for the most part, but their sum much better."""
    further = ([0.0, 0.02, 0.0], [0.0, 0.0, 0.02])
    precision, _ = posterior(np.array([list(FIRST_HARMONIC.values()), *further]), 1.0, np.array([1e4, 1e4, 1e4]))
    assert not members(precision).any()
    found = first_harmonic(np.array([1e4, 1e4, 1e4]), *ODD, further=further)
    assert [each.symbol for each in found] == ["k1+k3+koq"]


def test_the_leading_member_makes_most_of_the_sum():
    precision, draws = posterior(np.array([[1.0, 1.0]]), 1e-3, np.ones(2))
    draws = draws._replace(values=draws.values + np.array([0.0, 5.0]))
    (found,) = determined_combinations(draws, members(precision), NOTHING)
    assert found.quantities == ("x1", "x0")
    assert found.weights == (1.0, 1.0)


def test_projected_scale_factor():
    """One mounting determines k cos θ; if another determines k as well there is nothing to report."""
    projected = [ProjectedScaleFactor("k′", "1", "k", "theta")]

    def found(further: list[list[float]]):
        slope = np.array([[np.cos(0.95), -np.sin(0.95) * 1e-3], *further])
        precision, draws = posterior(slope, 1e-6, np.array([1e-3, 1.0]))
        angle = np.degrees(0.95 + 1e-3 * draws.values[:, 1])
        derived = Draws(("k", "theta"), ("1", "deg"), np.stack([1 + draws.values[:, 0], angle], axis=1))
        return determined_combinations(draws, members(precision), derived, projected)

    assert [each.symbol for each in found([])] == ["k′"]
    assert not found([[1.0, 0.0]])
