"""Mixtures of t distributions as proposals: the map, its density, and what they are fitted to."""

import emcee
import numpy as np
from scipy import stats

from imubayes.inference.laplace_proposal import LaplaceMove, weigh
from imubayes.inference.mixture_proposal import MixtureProposal, about_normal, adapted, fitted_to


def mixture(parts=2, size=3) -> MixtureProposal:
    random = np.random.default_rng(4)
    axes = np.tril(random.normal(size=(parts, size, size))) + 2 * np.eye(size)
    share = np.arange(1.0, parts + 1)
    return MixtureProposal(share / share.sum(), 3 * random.normal(size=(parts, size)), axes)


def test_the_map_and_its_way_back_are_of_standard_normal_numbers():
    proposal = mixture()
    normal = np.random.default_rng(0).normal(size=(40_000, 4))
    points, density = proposal.to_point(normal)
    back, again = proposal.to_normal(points)
    np.testing.assert_allclose(again, density)
    np.testing.assert_allclose(proposal.to_point(back)[0], points, atol=1e-9)
    assert all(stats.kstest(column, stats.norm.cdf).pvalue > 1e-3 for column in back.T)
    np.testing.assert_allclose(np.corrcoef(back.T), np.eye(4), atol=0.025)
    np.testing.assert_array_equal(proposal.to_normal(points[:9])[0], proposal.to_normal(points[:9])[0])


def test_the_density_is_that_of_its_draws():
    single, random = about_normal(np.ones(3), np.diag([1.0, 2.0, 3.0])), np.random.default_rng(1)
    points, density = single.to_point(random.normal(size=(20_000, 4)))
    known = stats.multivariate_t(np.ones(3), np.diag([1.0, 4.0, 9.0]), single.freedom)
    np.testing.assert_allclose(density, known.logpdf(points))
    assert stats.kstest(points[:, 1], stats.t(single.freedom, 1, 2).cdf).pvalue > 1e-3
    np.testing.assert_allclose(weigh(mixture().log_density, mixture(), 1, 1000, 0).weight, 1)


def test_far_points_come_back():
    single = about_normal(np.zeros(5), np.eye(5))
    points = np.random.default_rng(2).normal(size=(20, 5)) * np.logspace(-6, 3, 20)[:, None]
    np.testing.assert_allclose(single.to_point(single.to_normal(points)[0])[0], points, rtol=1e-6)


class _Model:
    def __init__(self, density, random):
        self.random, self.compute_log_prob_fn = random, lambda points: (density(points), None)


def test_the_move_keeps_a_density_that_the_mixture_is_not():
    """Two modes of 0.3 and 0.7, from a mixture that has the shares the wrong way round."""

    def density(points):
        low, high = stats.norm.pdf(points[:, 0], -4), stats.norm.pdf(points[:, 0], 4)
        return np.log(0.3 * low + 0.7 * high) - 0.5 * points[:, 1] ** 2

    axes = np.stack([np.eye(2), np.eye(2)])
    proposal = MixtureProposal(np.array([0.7, 0.3]), np.array([[-4.0, 0], [4.0, 0]]), axes)
    random = np.random.RandomState(0)
    points = random.normal(size=(2000, 2)) - [4.0, 0]
    state, move = emcee.State(points, log_prob=density(points)), LaplaceMove(proposal, 0.3, 0.5)
    for step in range(30):
        state, _ = move.propose(_Model(density, random), state)
        if step % 7 == 0:
            move.forget()
    assert abs(np.mean(state.coords[:, 0] < 0) - 0.3) < 0.05
    np.testing.assert_allclose(np.abs(state.coords[:, 0]).mean(), 4, atol=0.1)


def test_a_mixture_learns_the_shares_of_places_from_the_density():
    """Draws of equal shares, as of walkers that began there; the density gives one nine tenths."""
    random = np.random.default_rng(5)
    draws = random.normal(size=(1600, 4)) + np.where(np.arange(1600)[:, None] % 2, 6.0, -6.0)

    def density(points):
        low, high = -0.5 * ((points + 6) ** 2).sum(axis=1), -0.5 * ((points - 6) ** 2).sum(axis=1)
        return np.logaddexp(np.log(0.1) + low, np.log(0.9) + high)

    begun = fitted_to(draws, 0)
    before = weigh(density, begun, 1, 4000, 0)
    best, judged = adapted(density, begun, 5, 4000, 0)
    assert before.acceptance < 0.6 < 0.75 < judged.acceptance
    points = best.to_point(random.normal(size=(20_000, 5)))[0]
    assert abs(np.mean(points[:, 0] < 0) - 0.1) < 0.03
    # The place that holds less is never given up.
    assert best.share[best.centre[:, 0] < 0].sum() > 0.02
    assert fitted_to(np.zeros((100, 4)), 0) is None
