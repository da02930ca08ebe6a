"""The modes of the noise scales, and draws of the posterior from all of them.

If runs are few the scatter between them may as well be small, with their offsets taken for parameters, as large; and
of two channels that disagree about a common parameter, either may be the one that scatters.  The mode is the
highest maximum of the marginal density of h in z, where every prior is standard normal: a scatter of zero is at −∞
there, and one that the data cannot distinguish from zero at the lower end of its prior.  No single mode sums the
posterior up: θ is drawn given h, normal in the model that is linear about a mode, and h from its marginal, by
importance sampling from what is tabulated about every mode that holds mass.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from imubayes.inference.conditional_precision import ExactPrecision
from imubayes.inference.laplace_marginal import ScaleMarginal, climbed
from imubayes.inference.laplace_proposal import systematic
from imubayes.inference.nested_laplace import (
    HyperMarginal,
    NestedLaplace,
    grouped_normals,
    hyper_density,
    hyper_marginal,
    nested_laplace,
    points_and_marginals,
)
from imubayes.inference.posterior_mode import Mode, find_mode, log_evidence
from imubayes.model.noise_covariance import rows_correlate
from imubayes.model.problem import Problem

# A scale that is known to a fifth of its prior has no second mode.
_WIDE = 0.2
# Where searches begin, in z: a scatter that is next to zero, and one of the size that the prior expects.
_LOW, _HIGH = -2.5, 0.5
# Noise scales that differ by less than this everywhere are those of one mode; one this much lower holds no mass.
_ALIKE, _HOPELESS = 0.1, 15.0
# A mode of less than a thousandth of the mass moves the ends of 95 % intervals by 0.02 standard deviations at most.
NEGLIGIBLE = float(np.log(1e3))
# Least share of the draws that are made about a mode.
_LEAST_SHARE = 0.1
# Parameters from which θ is drawn in fours with the same noise scales: factoring the precision takes most of the time.
_MANY_PARAMETERS = 150
# Weights of a relative variance below this move no mean by more than its root, 0.05 standard deviations.
_EVEN = 0.05**2


@dataclass(frozen=True)
class ScaleModes:
    """The highest mode, the marginal of the noise scales about it, and lower modes."""

    highest: Mode
    marginal: HyperMarginal
    lower: tuple[Mode, ...]

    @property
    def with_mass(self) -> tuple[Mode, ...]:
        """The lower modes that hold more than next to nothing of the posterior, by their Laplace evidence."""
        least = log_evidence(self.highest) - NEGLIGIBLE
        return tuple(mode for mode in self.lower if log_evidence(mode) > least)


def modes_of_scales(problem: Problem, mode: Mode) -> ScaleModes:
    """Return the modes of the noise scales that are found from one of them."""
    known = [mode]
    while True:
        highest = max(known, key=lambda each: float(each.marginal.value))
        marginal = hyper_marginal(problem, highest)
        count, density = len(known), ScaleMarginal(problem, highest.about)
        for start in (*marginal.others, *_exchanged(highest.h, marginal.deviation)):
            h, at = climbed(density, start)
            if float(at.value) < float(highest.marginal.value) - _HOPELESS or _among(known, h):
                continue
            found = find_mode(problem, highest.z, h)
            if bool(found.converged) and not _among(known, found.h):
                known.append(found)
        if all(float(each.marginal.value) <= float(highest.marginal.value) for each in known[count:]):
            return ScaleModes(highest, marginal, tuple(each for each in known if each is not highest))


def _exchanged(h: np.ndarray, deviation: np.ndarray) -> list[np.ndarray]:
    """Return starts with one of the scales that are known poorly high and the others low, and the reverse."""
    wide = np.flatnonzero(deviation > _WIDE)
    starts = []
    for own, rest in ((_HIGH, _LOW), (_LOW, _HIGH)) if len(wide) > 1 else ():
        for place in wide:
            start = h.copy()
            start[wide] = rest
            start[place] = own
            starts.append(start)
    return starts


def _among(known: Sequence[Mode], h: np.ndarray) -> bool:
    return any(float(np.max(np.abs(mode.h - h), initial=0.0)) < _ALIKE for mode in known)


def posterior_points(
    problem: Problem, modes: ScaleModes, approximation: NestedLaplace, draws: int | np.ndarray
) -> np.ndarray:
    """Return draws (n, P + H) of the posterior of the models that are linear about each mode.

    Points of the proposals about the modes that hold mass, resampled if the weights of their noise scales matter.

    Parameters
    ----------
    approximation : the proposal about the highest mode.
    draws : number n of them, or standard normal vectors (n, P + H) to make them of.
    """
    size = problem.size[0]
    if isinstance(draws, np.ndarray):
        normal = draws
    elif problem.timeline is not None or size >= _MANY_PARAMETERS:
        normal = grouped_normals(draws, *problem.size)
    else:
        normal = np.random.RandomState(0).normal(size=(draws, sum(problem.size)))
    all_modes = (modes.highest, *modes.with_mass)
    proposals = [approximation, *(nested_laplace(problem, mode) for mode in modes.with_mass)]
    evidence = np.array([log_evidence(mode) for mode in all_modes])
    share = np.maximum(np.exp(evidence - evidence.max()), _LEAST_SHARE)
    share /= share.sum()
    ends = np.round(np.cumsum(share) * len(normal)).astype(int)
    drawn = [
        points_and_marginals(proposal, problem, mode.about.misfit, rows)
        for proposal, mode, rows in zip(proposals, all_modes, np.split(normal, ends[:-1]), strict=True)
    ]
    points, marginal = (np.concatenate([each[part] for each in drawn]) for part in (0, 1))
    # By blocks, the precision of correlated rows is approximate: good for θ, but no measure of a density.
    if not (isinstance(approximation.blocks, ExactPrecision) or not rows_correlate(problem)):
        return points
    densities = np.stack([hyper_density(each, problem, points[:, size:]) for each in proposals])
    return resampled(points, marginal - logsumexp(densities + np.log(share)[:, None], axis=0))


def resampled(points: np.ndarray, log_weight: np.ndarray) -> np.ndarray:
    """Return draws (n, …) with frequencies by their weights (n,), as they are if these are nearly even."""
    weight = np.exp(log_weight - logsumexp(log_weight))
    if len(weight) * np.sum(weight**2) < 1 + _EVEN:
        return points
    return points[systematic(weight, len(weight), np.random.RandomState(0))]
