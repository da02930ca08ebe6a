"""Look-elsewhere correction: the smallest p-value of many candidates is often small by chance.

All scores come from one residual.  Under no effect it is white within the space that the model leaves, so the
distribution of the smallest of all p-values is found by simulating it (Westfall & Young, Resampling-Based Multiple
Testing, 1993), correlations included and without any refit.
"""

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from imubayes.criticism import thresholds
from imubayes.criticism.localised_structure import FeatureScan
from imubayes.criticism.one_sided import least_p_of_cones
from imubayes.criticism.score_test import ScoreTest
from imubayes.tail_probabilities import chi2_survival

_MOST_THREADS = 4


@dataclass(frozen=True)
class LookElsewhere:
    """The distribution of the smallest p-value of all candidates under no effect.

    Attributes
    ----------
    smallest : shape (draws,), sorted.
    looks : effective number of independent looks.
    """

    smallest: np.ndarray
    looks: float

    def __call__(self, p: float) -> float:
        """Return the probability that any candidate reaches p under no effect."""
        count = len(self.smallest)
        edge = max(2, int(thresholds.LOOK_TAIL * count))
        reference = self.smallest[edge - 1]
        if p < reference:
            return min(1.0, p * edge / count / reference)
        return float(np.searchsorted(self.smallest, p, side="right") / count)


def look_elsewhere(scores: Sequence[ScoreTest], scans: Sequence[FeatureScan] = (), seed: int = 0) -> LookElsewhere:
    """Return the distribution of the smallest p-value of all score tests, and of all features scanned."""
    cones = [score.cone for score in scores if score.cone is not None]
    scores = [score for score in scores if score.cone is None and score.span.shape[1]]
    spanned = [each.span for each in (*scores, *cones)] + [scan.basis for scan in scans]
    if not spanned:
        return LookElsewhere(np.ones(1), 0.0)
    height = len(spanned[0])
    spans = np.concatenate([np.zeros((height, 0)), *(score.span for score in scores)], axis=1)
    freedom = np.array([score.span.shape[1] for score in scores], dtype=int)
    starts = np.cumsum(freedom) - freedom
    random = np.random.default_rng(seed)

    def least(draws: np.ndarray) -> np.ndarray:
        each = [*_of_scans(scans, draws), least_p_of_cones(cones, draws)]
        if scores:
            each.append(_least_p(np.add.reduceat((draws @ spans) ** 2, starts, axis=1), freedom))
        return np.min(each, axis=0)

    # Draws come from one generator in turn: the result does not depend on the number of cores.
    parts = thresholds.LOOK_DRAWS // thresholds.LOOK_DRAWS_AT_ONCE
    drawn = (random.normal(size=(thresholds.LOOK_DRAWS_AT_ONCE, height)) for _ in range(parts))
    with ThreadPoolExecutor(min(_MOST_THREADS, os.cpu_count() or 1)) as pool:
        smallest = np.sort(np.concatenate(list(pool.map(least, drawn))))
    edge = max(2, int(thresholds.LOOK_TAIL * thresholds.LOOK_DRAWS))
    return LookElsewhere(smallest, float(edge / thresholds.LOOK_DRAWS / smallest[edge - 1]))


def _of_scans(scans: Sequence[FeatureScan], draws: np.ndarray) -> list[np.ndarray]:
    """Return the smallest p-value of each draw, (draws,), for each batch of features."""
    return [_least_p(chi2, batch.freedom) for scan in scans for batch, chi2 in scan.scores(draws)]


def _least_p(chi2: np.ndarray, freedom: np.ndarray) -> np.ndarray:
    """Return the smallest p-value of each draw, (draws,), over scores (draws, F) with freedom (F,)."""
    # Among equal degrees of freedom the largest score has the smallest p.
    known = np.unique(freedom[freedom > 0])
    each = [chi2_survival(chi2[:, freedom == dof].max(axis=1), dof) for dof in known]
    return np.min([np.ones(len(chi2)), *each], axis=0)
