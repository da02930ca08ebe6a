"""Global risks: of all units tested, the share wrongly accepted and wrongly rejected.

JCGM 106, 9.5: a unit drawn from the production has the value η ~ normal(μ, s), its measurement gives y ~ normal(η, u),
and it is accepted where y is in the acceptance interval.  The consumer's risk is the probability that a unit is
accepted and does not conform, the producer's that it is rejected and conforms.  Each is found twice: by quadrature over
η, with the probability of acceptance in closed form, and by simulated units.
"""

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy  # loads its parts when they are first used

from imubayes.qualification.conformance import ProbabilityByTwoMethods, ToleranceInterval, compared, fraction_error
from imubayes.qualification.marginal import gauss_legendre
from imubayes.tail_probabilities import normal_survival

_NODES, _FAR, _CLIMB, _UNITS = 100, 9.0, 8.0, 400_000
# Widest guard band that is tried: in standard uncertainties, where no unit beyond a limit is accepted, and as a share
# of half the tolerance, which leaves nothing to accept.
_WIDEST, _MOST = 8.0, 0.999


@dataclass(frozen=True)
class Production:
    """Distribution of the true values of the units tested, normal(mean, sd), in the unit of the quantity."""

    mean: float
    sd: float


@dataclass(frozen=True)
class GlobalRisks:
    """Consumer's and producer's risk of a guard band, each by two methods."""

    consumer: ProbabilityByTwoMethods
    producer: ProbabilityByTwoMethods


def global_risks(
    production: Production, standard: float, tolerance: ToleranceInterval, guard: float, seed: int = 0
) -> GlobalRisks:
    """Return the global risks of an acceptance interval.

    Parameters
    ----------
    production : of the units tested.
    standard : standard uncertainty u of a measurement.
    tolerance : limits of the quantity.
    guard : width of the guard band inside them.
    seed : of the simulated units.
    """
    accepted = tolerance.guarded(guard)
    random = np.random.default_rng(seed)
    true = random.normal(production.mean, production.sd, _UNITS)
    taken = accepted.contains(true + random.normal(0.0, standard, _UNITS))
    conform = tolerance.contains(true)
    consumer, producer = _by_quadrature(production, standard, tolerance, accepted)
    return GlobalRisks(
        _compared(float(np.mean(taken & ~conform)), consumer), _compared(float(np.mean(~taken & conform)), producer)
    )


def _compared(simulated: float, integrated: float) -> ProbabilityByTwoMethods:
    return compared(simulated, integrated, fraction_error(simulated, _UNITS))


def _by_quadrature(
    production: Production, standard: float, tolerance: ToleranceInterval, accepted: ToleranceInterval
) -> tuple[float, float]:
    """Return consumer's and producer's risk by Gauss–Legendre quadrature over the true values, piece by piece."""

    def joint(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        density = np.exp(-0.5 * ((values - production.mean) / production.sd) ** 2)
        density = density / (production.sd * math.sqrt(2 * math.pi))
        upper, lower = (normal_survival((values - limit) / standard) for limit in (accepted.upper, accepted.lower))
        acceptance = np.maximum(upper - lower, 0.0)
        return density * acceptance, density * (1 - acceptance)

    # The probability of acceptance climbs within some u of each end of the acceptance interval.
    climbs = [end + side * _CLIMB * standard for end in (accepted.lower, accepted.upper) for side in (-1, 0, 1)]

    def integral(low: float, high: float, which: int) -> float:
        reach = _FAR * production.sd
        low, high = max(low, production.mean - reach), min(high, production.mean + reach)
        ends = [low, *sorted(climb for climb in climbs if low < climb < high), high]
        nodes, weights = gauss_legendre(_NODES)
        pieces = [(first, (last - first) / 2) for first, last in pairwise(ends) if last > first]
        return sum(float(half * np.sum(weights * joint(first + half * (nodes + 1))[which])) for first, half in pieces)

    outside = integral(-math.inf, tolerance.lower, 0) + integral(tolerance.upper, math.inf, 0)
    return outside, integral(tolerance.lower, tolerance.upper, 1)


def guard_for_risk(
    production: Production, standard: float, tolerance: ToleranceInterval, target: float
) -> float | None:
    """Return the narrowest guard band whose global consumer's risk is at most the target; None where none is.

    A negative guard band, which accepts beyond the limits, is not considered.
    """

    def excess(factor: float) -> float:
        return _by_quadrature(production, standard, tolerance, tolerance.guarded(factor * standard))[0] - target

    widest = min(_WIDEST, _MOST * (tolerance.upper - tolerance.lower) / 2 / standard)
    if excess(0.0) <= 0:
        return 0.0
    if excess(widest) > 0:
        return None
    return standard * float(np.asarray(scipy.optimize.brentq(excess, 0.0, widest, xtol=1e-6)))
