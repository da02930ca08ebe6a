"""Whether the noise is what the intervals of a fit assume: white, normal, of one size, and not hidden by rounding.

The uncertainty of a fit follows from the law of its noise.  Noise that wanders, has heavy tails or outliers, or that a
coarse output hides gives intervals that hold the truth less often than they say, although chi-square is as it should
be.  The statistics are those of the diagnosis (`imubayes.criticism.noise_tests`), each against its distribution for
white noise, and two more: power at the lowest frequencies of each run, and the step between neighbouring outputs.
"""

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
import scipy  # loads its parts when they are first used

from imubayes.criticism import thresholds
from imubayes.criticism.noise_tests import KINDS, OUTLIERS, screen_noise
from imubayes.criticism.noise_violation import NoiseKind, NoiseViolation
from imubayes.criticism.projection import Projection, project
from imubayes.inference.fitted_model import Fit
from imubayes.inference.posterior_precision import linearise

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

    significant = rarer_than(thresholds.FALSE_ALARM_INTERVALS)
    suspected = rarer_than(thresholds.SUSPECTED_INTERVALS_P)[len(significant) :]
    return NoiseJudgement((*_quantised(projection), *significant), suspected)


def low_frequency(projection: Projection, entries: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """Return the power of whitened entries at the lowest frequencies of each run over that of all, per column."""
    low, total = np.zeros(entries.shape[1]), np.zeros(entries.shape[1])
    count, rows, sizes = 0, 0, projection.turn.sizes
    for size in np.unique(sizes[chosen]):
        modes = min(thresholds.SLOW_MODES, size // 2)
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
        if ratio > thresholds.COARSE_STEP:
            found.append(NoiseViolation(kind="quantisation", channels=(channel.name,), step=ratio))
    return found


def grid_step(values: np.ndarray) -> float:
    """Return the step of the grid that values lie on; 0 where they lie on none, or too few coincide to tell."""
    levels = np.unique(values)
    if len(levels) < 2 or len(values) - len(levels) < thresholds.COINCIDENT_SHARE * len(values):
        return 0.0
    apart = np.diff(levels)
    rounding = thresholds.GRID_ROUNDING * float(np.abs(levels).max())
    step = float(apart[apart > rounding].min(initial=np.inf))
    if not np.isfinite(step):
        return 0.0
    off = np.abs(apart / step - np.round(apart / step))
    return step if float(off.max()) < thresholds.GRID_SHARE else 0.0
