"""An estimate from posterior draws: mean, standard deviation and the 95 % equal-tailed interval."""

import numpy as np

from imubayes.json_record import Record

_INTERVAL = (2.5, 97.5)
# A quantity that varies by less than this share of itself varies by rounding.
_ROUNDING = 1e-12


class Estimated(Record):
    """Posterior mean, standard deviation, and the ends of the 95 % equal-tailed credible interval."""

    mean: float
    sd: float
    q025: float
    q975: float


def estimated(draws: np.ndarray) -> Estimated:
    """Return the estimate from draws of a quantity, (S,); one that only rounding changes is exact."""
    if is_constant(draws):
        value = float(draws[0])
        return Estimated(mean=value, sd=0.0, q025=value, q975=value)
    low, high = np.percentile(draws, _INTERVAL)
    return Estimated(mean=float(draws.mean()), sd=float(draws.std()), q025=float(low), q975=float(high))


def is_constant(draws: np.ndarray) -> bool:
    """Return whether draws, (S,), differ by rounding at most."""
    return float(np.ptp(draws)) <= _ROUNDING * float(np.max(np.abs(draws)))
