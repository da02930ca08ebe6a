"""Monte Carlo errors of what a chain states: standard deviations, and ends of 95 % intervals.

An effective size alone does not say how well a chain tells them: where a scatter between few runs has a wide posterior,
a bias is a mixture of narrow and wide normal distributions with a kurtosis of 30 to 100, and the standard deviation of
12 000 independent draws has an error of 2 to 4 % instead of the 0.6 % of a normal one.  So chains go on until the
probability that any of these numbers is farther from the truth than the bars is small: the sum over all parameters of
the normal probability at their own errors (Bonferroni).  Standard deviations alone are not waited for beyond a length:
where a lognormal scatter is told by its prior alone, the fourth moment that their error takes settles after millions of
draws.

Errors of standard deviations are those of ArviZ.  Those of the ends are √(p (1 − p)/n)/f with n the effective size at
the quantile and f the density there, from the quantiles at p/2 and 2p: the spacing of one error that ArviZ takes
varies by a fifth, and the largest of some hundred is what decides here.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import lazy_loader
import numpy as np
from scipy.special import ndtri

from imubayes.tail_probabilities import normal_survival

if TYPE_CHECKING:
    import arviz_stats.sampling_diagnostics
else:
    arviz_stats = lazy_loader.load("arviz_stats")  # takes long to import, and only sampling needs it

INTERVAL = (0.025, 0.975)
SD_BAR, END_BAR = 0.05, 0.1
"""Errors that are allowed: of a standard deviation, relative; of an end, in standard deviations."""
MOST_CHANCE = 0.01
"""Probability at most that any number of a chain is beyond its bar."""
_LONGEST = 1e4


@dataclass(frozen=True)
class ChainErrors:
    """Standard errors of the numbers of D parameters.

    Attributes
    ----------
    sd : shape (D,), of the standard deviation, relative.
    end : shape (D, 2), of the ends of the 95 % interval, in standard deviations.
    """

    sd: np.ndarray
    end: np.ndarray

    def chance_beyond(self, longer: float = 1.0) -> float:
        """Return the largest probability that any number is beyond its bar, for chains `longer` times as long."""
        return self.chance_of_ends(longer) + float(2 * normal_survival(SD_BAR * np.sqrt(longer) / self.sd).sum())

    def chance_of_ends(self, longer: float = 1.0) -> float:
        """Return the largest probability that any end is beyond its bar, for chains `longer` times as long."""
        return float(2 * normal_survival(END_BAR * np.sqrt(longer) / self.end).sum())

    def longer(self) -> float:
        """Return how many times the length the chains need; at most 1 where they are long enough."""
        if not np.all(np.isfinite(self.sd)) or not np.all(np.isfinite(self.end)):
            return _LONGEST
        low, high = np.log(1 / _LONGEST), np.log(_LONGEST)
        for _ in range(40):
            middle = (low + high) / 2
            low, high = (middle, high) if self.chance_beyond(np.exp(middle)) > MOST_CHANCE else (low, middle)
        return float(np.exp(high))

    def inexact_ends(self, names: Sequence[str]) -> list[str]:
        """Return the interval whose ends are told worst, in words, where chains are too short for intervals."""
        if self.chance_of_ends() <= MOST_CHANCE:
            return []
        of_end = self.end.max(axis=1)
        worst = int(np.argmax(np.where(np.isnan(of_end), np.inf, of_end)))
        words = f"{of_end[worst]:.2f} of its standard deviation"
        return [f"the Monte Carlo error of the 95 % interval of {names[worst]} is {words}"]


def monte_carlo_errors(flat: np.ndarray, tail: np.ndarray) -> ChainErrors:
    """Return the errors of chains (walkers, steps, D) with effective sizes (D,) at the ends of the 95 % interval."""
    dimensions = flat.shape[-1]
    spread = flat.std(axis=(0, 1))
    error = np.asarray(arviz_stats.sampling_diagnostics.mcse(flat, chain_axis=0, draw_axis=1, method="sd"))
    return ChainErrors(error / spread, end_errors(flat.reshape(-1, dimensions), tail) / spread[:, None])


def end_errors(draws: np.ndarray, effective: np.ndarray) -> np.ndarray:
    """Return the standard errors (D, 2) of the ends of 95 % intervals, from draws (S, D) and effective sizes (D,)."""
    p = INTERVAL[0]
    outer, inner, inner_high, outer_high = np.quantile(draws, (p / 2, 2 * p, 1 - 2 * p, 1 - p / 2), axis=0)
    # p over the logarithm of its quantiles is the length of a tail that falls exponentially: 2p/(p/2) = e^(2 ln 2).
    length = np.stack([inner - outer, outer_high - inner_high], axis=-1) / (2 * np.log(2))
    return np.sqrt(p * (1 - p) / effective)[:, None] * length / p


def normal_length(dimensions: int) -> float:
    """Return the independent draws that D normal parameters need."""
    # Of a normal distribution the ends need most: √(p (1 − p))/φ(z) = 2.67.
    z = float(ndtri(1 - MOST_CHANCE / (4 * max(dimensions, 1))))
    return (2.67 * z / END_BAR) ** 2
