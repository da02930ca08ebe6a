"""Whether the noise is what the intervals of a fit assume: white, normal, of one size, and not hidden by rounding.

The uncertainty of a fit follows from the law of its noise.  Noise that wanders, has heavy tails or outliers, or that a
coarse output hides gives intervals that hold the truth less often than they say, although chi-square is as it should
be.  The statistics are those of the diagnosis (`imubayes.adequacy.noise_tests`), each against its distribution for
white noise, and two more: power at the lowest frequencies of each run, and the step between neighbouring outputs.
"""

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
import scipy  # loads its parts when they are first used

from imubayes.adequacy.adequacy_record import NoiseKind, NoiseViolation
from imubayes.adequacy.noise_tests import KINDS, OUTLIERS, screen_noise
from imubayes.adequacy.projection import Projection, project
from imubayes.inference.fitted_model import Fit
from imubayes.inference.posterior_precision import linearise

_FALSE_ALARM_INTERVALS = 0.006
"""Nominal probability that a fit with the noise of its model is said to have another, all tests together.  Design value
for the 1 % that is asked for: with 200 draws a nominal 0.005 is 0.003 to 0.008 in five campaigns of 4800 draws each,
0.01 is 0.006 to 0.013."""
_SUSPECTED_INTERVALS_P = 0.05
"""Above it and below this a departure is told as suspected.  Convention: one sound fit in twenty carries the notice; of
fits to a random walk of 0.3 of the noise from row to row, half are above the first and most below this."""
_SLOW_MODES = 4
"""Lowest frequencies of each run that count as slow.  Convention: fewer find only drifts, more lose them in the
rest."""
_COARSE_STEP = 2.0
"""Step of the output over its noise above which rounding is not smoothed by noise.  Derived: with noise σ of which the
step q makes q²/12, q > 2σ leaves true noise below 0.41 q, whose rounding error follows the input (Widrow & Kollár
2008)."""
_COINCIDENT_SHARE, _GRID_SHARE, _GRID_ROUNDING = 0.2, 1e-3, 1e-12
"""Outputs lie on a grid where this share of them coincide, their distances are multiples of a step to this share of it,
and the step is above this rounding of the largest output.  Numerical."""

SLOW = "slow"
_NAMES: dict[str, NoiseKind] = {
    "correlated_noise": "autocorrelation",
    SLOW: "low_frequency",
    "run_scatter": "scatter_between_runs",
    "rate_proportional_noise": "grows_with_input",
    OUTLIERS: "heavy_tails",
}


@dataclass(frozen=True)
class NoiseJudgement:
    """How the noise departs from its model, the clearest first.

    Attributes
    ----------
    violations : significant: intervals are not to be trusted.
    suspected : may be chance, but are too rare under the noise of the model to pass over.
    """

    violations: tuple[NoiseViolation, ...]
    suspected: tuple[NoiseViolation, ...]


def projected(fit: Fit) -> Projection:
    """Return the residual of a fit, projected about its mode, for the tests of its noise."""
    about = fit.mode.about if fit.mode is not None else linearise(fit.model.problem, jnp.asarray(fit.z))
    return project(fit, np.asarray(about.misfit), np.asarray(about.jacobian))


def judged_noise(fit: Fit) -> NoiseJudgement:
    """Return how the noise of a fit departs from its model."""
    return judged_noise_in(projected(fit))


def judged_noise_in(projection: Projection) -> NoiseJudgement:
    """Return how the noise departs from its model in a projected residual."""
    found = screen_noise(projection, kinds=(*KINDS, (SLOW, low_frequency)))

    def rarer_than(p: float) -> tuple[NoiseViolation, ...]:
        rare = [each for each in found if each.p * len(found) < p]
        return tuple(NoiseViolation(kind=_NAMES[each.effect], channels=each.channels, p=each.p) for each in rare)

    significant = rarer_than(_FALSE_ALARM_INTERVALS)
    suspected = rarer_than(_SUSPECTED_INTERVALS_P)[len(significant) :]
    return NoiseJudgement((*_quantised(projection), *significant), suspected)


def low_frequency(projection: Projection, entries: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """Return the power of whitened entries at the lowest frequencies of each run over that of all, per column."""
    low, total = np.zeros(entries.shape[1]), np.zeros(entries.shape[1])
    count, rows, sizes = 0, 0, projection.turn.sizes
    for size in np.unique(sizes[chosen]):
        modes = min(_SLOW_MODES, size // 2)
        own = entries[projection.turn.series[chosen & (sizes == size), :size]]
        spectrum = np.asarray(scipy.fft.dct(own, axis=1, norm="ortho"))[:, 1 : modes + 1]
        low, count = low + np.sum(spectrum**2, axis=(0, 1)), count + spectrum.shape[0] * modes
        total, rows = total + np.sum(own**2, axis=(0, 1)), rows + own.shape[0] * int(size)
    return (low / count) / (total / rows) - 1


def _quantised(projection: Projection) -> list[NoiseViolation]:
    """Return the channels whose outputs lie on a grid too coarse for their noise to smooth."""
    model, found = projection.fitted.model, list[NoiseViolation]()
    entries = model.entries
    for place, channel in enumerate(model.campaign.channels):
        here = (entries.channel == place) & ~entries.closing
        step = grid_step(np.asarray(entries.value)[here])
        if not step:
            continue
        sd = 1 / projection.root[here & (projection.root > 0)]
        ratio = step / float(np.median(sd)) if len(sd) else 0.0
        if ratio > _COARSE_STEP:
            found.append(NoiseViolation(kind="quantisation", channels=(channel.name,), step=ratio))
    return found


def grid_step(values: np.ndarray) -> float:
    """Return the step of the grid that values lie on; 0 where they lie on none, or too few coincide to tell."""
    levels = np.unique(values)
    if len(levels) < 2 or len(values) - len(levels) < _COINCIDENT_SHARE * len(values):
        return 0.0
    apart = np.diff(levels)
    rounding = _GRID_ROUNDING * float(np.abs(levels).max())
    step = float(apart[apart > rounding].min(initial=np.inf))
    if not np.isfinite(step):
        return 0.0
    off = np.abs(apart / step - np.round(apart / step))
    return step if float(off.max()) < _GRID_SHARE else 0.0
