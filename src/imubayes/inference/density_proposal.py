"""The search for a proposal of a user's density, and what chains from the stated starts say against it.

If JAX gives the curvature, the normal distribution about the mode that Newton steps find from the start comes first.
It may be one mode of several, or a spike that holds next to nothing; and if it is right, heavier tails than its own
make weights large.  So a chain from the stated starts, which knows nothing of it, has to agree: a place where this
chain stays and the proposal nearly never comes has a weight beyond all that were drawn.  If it does not agree, or no
mode is found, ensembles from the stated starts lay out where the density is, and a mixture is fitted to them
(`imubayes.inference.mixture_proposal`), which finds the shares of places that no chain goes between.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imubayes.foundations.progress import Tell
from imubayes.inference.chains import Settings
from imubayes.inference.convergence import STAYS, WORST_PARETO_K, normal_length
from imubayes.inference.density_mode import NormalProposal
from imubayes.inference.ensemble_sampling import short_chain
from imubayes.inference.laplace_proposal import LARGEST_WEIGHT, Proposal, WeighedProposal, weigh, weigh_tail
from imubayes.inference.mixture_proposal import MixtureProposal, about_normal, adapted, fitted_to
from imubayes.inference.user_function import CountedDensity

# Draws whose importance weights judge a proposal, of all ensembles together, and refits of a mixture.
_TRIAL, _ROUNDS = 4000, 5
# A proposal that is taken less often is no help; one below the second is judged by so many times the draws, since
# chains are held against their weighted moments.
_LEAST_ACCEPTANCE, _HARD, _MORE = 0.1, 0.5, 8
# A chain from the stated starts goes on in as many steps while walkers are where the proposal nearly never comes, and
# for so many times: they may not have arrived.
_SCOUTED, _SCOUTS = 50, 4
# All ensembles go on in so many steps, for so many times, until a mixture that is fitted to them is a proposal.
_LAID_OUT, _LAYS = 100, 4
# Sets of walkers, of the latter half of the steps, to which a mixture is fitted.
_SETS = 8
# A weight this many times the largest of all draws, and so large a share of walkers with one, is against a proposal.
_BEYOND, _ASTRAY = 10.0, 0.01
# Chains of fewer steps are not worth a search for a better proposal.
_FEW = 80
# Share of the budget of evaluations that the search may take.
_SEARCH_SHARE = 0.5
# Sets of starts that are drawn, ever narrower: beside an edge in five directions one in 32 has a density.
_NARROWER = 12


@dataclass
class ProposalSearch:
    """The search for a proposal of one density.

    Attributes
    ----------
    density : points (n, D) → (n,), counted.
    starts : for each ensemble its first points as the user states them, (walkers, D); then where its search ended.
    settings : of the sampler.
    tell : called with a line on what goes on.
    """

    density: CountedDensity
    starts: list[np.ndarray]
    settings: Settings
    tell: Tell

    def proposal(self, laplace: NormalProposal | None) -> WeighedProposal | None:
        """Return a proposal with its weights that chains from the stated starts agree with; None without one.

        Parameters
        ----------
        laplace : the normal distribution about the mode; None if none was found.
        """
        found = None if laplace is None else self._about_mode(laplace)
        return found if found is not None else self._laid_out()

    def _about_mode(self, laplace: NormalProposal) -> WeighedProposal | None:
        self.tell("sampling: weighing the normal distribution about the mode")
        found = self._weighed(laplace)
        if found is None or self._steps(found) > _FEW:
            found = self._better(found, self._adapted(about_normal(laplace.centre, laplace.axes)))
        if found is None:
            return None
        points = self.starts[0]
        for scout in range(_SCOUTS):
            if not self._affords(_SCOUTED * len(points)):
                return None
            self.tell(f"sampling: comparing it with a chain from the start, step {(scout + 1) * _SCOUTED}")
            chain, height = short_chain(self.density, points, _SCOUTED, [self.settings.seed, 11, scout])
            points = chain[-1]
            if agrees(found, points, height[-1]):
                return found
        return None

    def _laid_out(self) -> WeighedProposal | None:
        for lay in range(_LAYS):
            if not self._affords(_LAID_OUT * sum(map(len, self.starts)) + 2 * _TRIAL):
                return None
            self.tell(f"sampling: tabulating the density from the start, step {(lay + 1) * _LAID_OUT}")
            chains = [
                short_chain(self.density, start, _LAID_OUT, [self.settings.seed, 12, lay, ensemble])
                for ensemble, start in enumerate(self.starts)
            ]
            self.starts = [points[-1] for points, _ in chains]
            late = np.linspace(_LAID_OUT // 2, _LAID_OUT - 1, _SETS).astype(int)
            draws = np.concatenate([points[late].reshape(-1, points.shape[-1]) for points, _ in chains])
            mixture = fitted_to(draws, self.settings.seed)
            found = None if mixture is None else self._adapted(mixture)
            height = np.concatenate([heights[-1] for _, heights in chains])
            if found is not None and agrees(found, np.concatenate(self.starts), height):
                return found
        return None

    def _adapted(self, mixture: MixtureProposal) -> WeighedProposal | None:
        rounds = min(_ROUNDS, int(self._spendable() // _TRIAL) - 2)
        if rounds < 1:
            return None
        best, judged = adapted(self.density, mixture, rounds, _TRIAL, self.settings.seed)
        return None if judged is None else self._weighed(best)

    def _weighed(self, proposal: Proposal) -> WeighedProposal | None:
        """Return a proposal with its weights; None if they say that it does not hold the density."""
        ensembles, seed = self.settings.ensembles, self.settings.seed
        count = math.ceil(max(_TRIAL, sum(map(len, self.starts))) / ensembles)
        weigher = weigh_tail if self._affords(10 * _TRIAL) else weigh
        found = weigher(self.density, proposal, ensembles, count, seed)
        if found is not None and found.acceptance < _HARD and self._affords(_MORE * _TRIAL):
            found = weigh(self.density, proposal, ensembles, _MORE * count, seed)
        bad = found is None or found.pareto_k > WORST_PARETO_K or found.acceptance < _LEAST_ACCEPTANCE
        return None if bad else found

    def _better(self, one: WeighedProposal | None, other: WeighedProposal | None) -> WeighedProposal | None:
        if one is None or other is None:
            return one or other
        return min(one, other, key=self._steps)

    def _steps(self, found: WeighedProposal) -> float:
        """Return about how many steps chains of a proposal take."""
        walkers, size = sum(map(len, self.starts)), self.starts[0].shape[1]
        return max(normal_length(size) * (2 / found.acceptance - 1) / walkers, STAYS * found.largest)

    def _spendable(self) -> float:
        return _SEARCH_SHARE * self.density.most - self.density.used

    def _affords(self, evaluations: int) -> bool:
        return evaluations <= self._spendable()


def agrees(found: WeighedProposal, points: np.ndarray, height: np.ndarray) -> bool:
    """Return whether walkers that know nothing of a proposal are where it comes often enough.

    Parameters
    ----------
    points, height : shapes (n, D) and (n,), where walkers are and their log densities.
    """
    weight = height - found.proposal.to_normal(points)[1] - found.log_mass
    astray = weight > np.log(_BEYOND * max(found.largest, LARGEST_WEIGHT))
    return bool(np.mean(astray) <= _ASTRAY)


def finite_starts(
    density: CountedDensity, wide: NormalProposal, count: int, ensembles: int, seed: Sequence[int]
) -> list[np.ndarray]:
    """Return points of positive density about a start for each ensemble, (count, D).

    They are drawn from a normal distribution, and from narrower ones about the same start if most of its draws have
    none; copies of those that were found, if these do not suffice.
    """
    random, needed = np.random.default_rng(seed), count * ensembles
    found, narrower = np.zeros((0, len(wide.centre))), 1.0
    for _ in range(_NARROWER):
        drawn = wide.to_point(narrower * random.normal(size=(needed, len(wide.centre))))[0]
        found = np.concatenate([found, drawn[np.isfinite(density(drawn))]])
        if len(found) >= needed:
            break
        if len(found) < needed / _NARROWER:
            narrower /= 2
    if not len(found):
        return []
    chosen = found[:needed] if len(found) >= needed else found[random.integers(len(found), size=needed)]
    return np.split(chosen, ensembles)
