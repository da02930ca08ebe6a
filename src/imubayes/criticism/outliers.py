"""Readings that are far off: which they are, and whether they have a cause in common."""

from collections.abc import Sequence

import numpy as np
from scipy import stats

from imubayes.criticism.covariates import Covariate
from imubayes.criticism.noise import entries_of
from imubayes.criticism.projection import Projection

# A reading is far off beyond so many standard deviations, told by the median of their sizes over that of a normal law.
_FAR_OFF, _MEDIAN_OF_NORMAL = 5.0, 0.6745
# A covariate of so many values is looked at value by value, otherwise in so many parts.
_MOST_VALUES, _PARTS, _DIGITS = 64, 16, 3
# So many rows that are far off at one value, of so many runs, by so small a chance with all values counted, have a
# cause.
_LEAST_ROWS, _LEAST_RUNS, _NO_CHANCE = 3, 2, 1e-3


def far_off(projection: Projection) -> np.ndarray:
    """Return which readings are so far off that a normal law does not bring them about, (E,) bool."""
    left = np.abs(entries_of(projection, projection.residual[:, None])[:, 0])
    model, found = projection.fitted.model, np.zeros(len(left), dtype=bool)
    seen = (np.asarray(model.problem.observations.weight) > 0) & ~model.entries.closing
    for place in np.unique(model.entries.channel[seen]):
        own = (model.entries.channel == place) & seen
        found[own] = left[own] > _FAR_OFF * np.median(left[own]) / _MEDIAN_OF_NORMAL
    return found


def gathered(projection: Projection, far: np.ndarray, known: Sequence[Covariate]) -> bool:
    """Tell whether readings that are far off, (E,) bool, gather at one value of a covariate, in more than one run.

    A row counts once, however many of its channels are far off: what happens once happens to all of them.
    """
    entries, channels = projection.fitted.model.entries, projection.fitted.model.campaign.channels
    row = np.unique(np.stack([entries.run, entries.row]), axis=1, return_inverse=True)[1].reshape(-1)
    best, looks = 1.0, 0
    for kind in dict.fromkeys(channel.kind for channel in channels):
        of_kind = [place for place, channel in enumerate(channels) if channel.kind == kind]
        here = np.isin(entries.channel, of_kind) & ~entries.closing
        share = len(np.unique(row[here & far])) / max(len(np.unique(row[here])), 1)
        for covariate in known:
            for cell in _cells(covariate.values, here):
                hit = cell & far
                rows = np.unique(row[hit])
                looks += 1
                if len(rows) >= _LEAST_ROWS and len(np.unique(entries.run[hit])) >= _LEAST_RUNS:
                    best = min(best, float(stats.binom.sf(len(rows) - 1, len(np.unique(row[cell])), share)))
    return best * looks < _NO_CHANCE


def _cells(values: np.ndarray, here: np.ndarray) -> list[np.ndarray]:
    """Return readings of equal values of a covariate, or of neighbouring ones where there are many, each (E,) bool."""
    here = here & np.isfinite(values)
    if not here.any():
        return []
    size = float(np.abs(values[here]).max())
    rounded = np.round(values / (size or 1.0), _DIGITS)
    single = np.unique(rounded[here])
    if len(single) <= _MOST_VALUES:
        return [here & (rounded == one) for one in single]
    edges = np.quantile(rounded[here], np.linspace(0, 1, _PARTS + 1)[1:-1])
    part = np.searchsorted(edges, rounded)
    return [here & (part == one) for one in range(_PARTS)]
