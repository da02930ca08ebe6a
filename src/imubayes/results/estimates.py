"""An estimate from posterior draws: mean, standard deviation and the 95 % equal-tailed interval."""

import numpy as np

from imubayes.json_record import Record

_INTERVAL = (2.5, 97.5)


class Estimated(Record):
    """Posterior mean, standard deviation, and the ends of the 95 % equal-tailed credible interval."""

    mean: float
    sd: float
    q025: float
    q975: float


def estimated(draws: np.ndarray) -> Estimated:
    """Return the estimate from draws of a quantity, (S,)."""
    low, high = np.percentile(draws, _INTERVAL)
    return Estimated(mean=float(draws.mean()), sd=float(draws.std()), q025=float(low), q975=float(high))
