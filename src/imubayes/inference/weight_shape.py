"""Whether the importance weights of a few draws put a Laplace approximation in doubt.

The weighted draws show directly how far means and standard deviations are off, unless the approximation lacks a part of
the posterior: its draws rarely come there, and a sample without one of them overstates its effective size severalfold.
That shows in the shape of the weights: the index k̂ of their tail (Vehtari, Simpson, Gelman, Yao & Gabry 2024) and
their skewness.
"""

from dataclasses import dataclass

import numpy as np
from scipy.stats import skew

from imubayes.foundations.arrays import Float
from imubayes.inference.fitted_model import Fit
from imubayes.inference.laplace_proposal import PARETO_K, LaplaceProposal, LogDensity, weigh

# Draws weighed.  Effort: weighted moments are known to 0.03 standard deviations.
_DRAWS = 1000
# If the largest weight of 1000 draws is below this, the rarest place drawn holds a quarter of a per cent of the
# posterior, and the shape of weights that hardly differ does not matter.
_LARGEST = 2.5
# A proposal whose standard deviation is a fifth too small gives 5.4, one that is off by one standard deviation 4.4.
# Of 200 units like `data/polar-tumble`, noise up to a hundred times, none is off by `_OFF`: at most 0.13 in the mean
# of the noise and 6 % in a standard deviation; 3 of them are flagged (benchmarks/results/doubtful_posteriors.md).
_SKEWNESS = 3.0
# Most that means may be off, in standard deviations, and the logarithms of these: six times the error of 1000 draws.
_OFF = 0.2
# Points whose density is evaluated together.
_AT_ONCE = 64


@dataclass(frozen=True)
class WeightShape:
    """What importance weights say; infinite if no draw is possible.

    Attributes
    ----------
    pareto_k, skewness, largest : tail index, skewness and largest of the weights, whose mean is 1.
    off : largest change of a mean, in standard deviations, or of the logarithm of one of these by the weights.
    """

    pareto_k: float
    skewness: float
    largest: float
    off: float

    @property
    def flagged(self) -> bool:
        """Whether the approximation is in doubt."""
        is_light = self.pareto_k <= PARETO_K and self.skewness <= _SKEWNESS
        return not ((is_light or self.largest <= _LARGEST) and self.off <= _OFF)


def weight_shape(fit: Fit, seed: int) -> WeightShape:
    """Return what the importance weights of a Laplace approximation say.

    Parameters
    ----------
    fit : with a posterior by the Laplace approximation.
    seed : of the draws.
    """
    assert fit.posterior is not None
    problem = fit.model.problem
    proposal = LaplaceProposal(fit.posterior.approximation, problem)
    weighed = weigh(LogDensity(problem, _AT_ONCE), proposal, 1, _DRAWS, seed)
    if weighed is None:
        return WeightShape(np.inf, np.inf, np.inf, np.inf)
    return shape_of(weighed.points[0], weighed.weight[0], weighed.pareto_k)


def shape_of(points: Float[np.ndarray, "n D"], weight: Float[np.ndarray, " n"], pareto_k: float) -> WeightShape:
    """Return what weights of mean 1 say of draws, their tail index known."""
    return WeightShape(pareto_k, float(np.nan_to_num(skew(weight))), float(weight.max()), _off(points, weight))


def _off(points: Float[np.ndarray, "n D"], weight: Float[np.ndarray, " n"]) -> float:
    """Return how far weights move means and standard deviations of points."""
    share, plain = weight / weight.sum(), points.mean(axis=0)
    mean = share @ points
    deviation, weighted = points.std(axis=0), np.sqrt(share @ (points - mean) ** 2)
    varies = deviation > 0
    moved = np.abs(mean - plain)[varies] / deviation[varies]
    with np.errstate(divide="ignore"):  # a single draw with all the weight has no spread
        widened = np.abs(np.log(weighted[varies] / deviation[varies]))
    return float(max(moved.max(initial=0.0), widened.max(initial=0.0)))
