"""How often does chance alone do so well somewhere?  Many candidates are looked at, and the best of many is not rare.

All scores come from one residual.  Under no effect it is white within the space that the model leaves, so the
distribution of the smallest of all p-values is found by drawing it (Westfall & Young, Resampling-Based Multiple
Testing, 1993), correlations included and without any refit.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from imubayes.criticism import thresholds
from imubayes.criticism.localised_structure import FeatureScan
from imubayes.criticism.score_test import ScoreTest


@dataclass(frozen=True)
class LookElsewhere:
    """The distribution of the smallest p-value of all candidates under no effect.

    Attributes
    ----------
    smallest : shape (draws,), sorted.
    looks : the number of independent looks that it amounts to.
    """

    smallest: np.ndarray
    looks: float

    def __call__(self, p: float) -> float:
        """Return the chance that any candidate reaches p."""
        edge = max(2, int(thresholds.LOOK_TAIL * len(self.smallest)))
        reference = self.smallest[edge - 1]
        if p < reference:
            return min(1.0, p * edge / len(self.smallest) / reference)
        return float(np.searchsorted(self.smallest, p, side="right") / len(self.smallest))


def look_elsewhere(looked: Sequence[ScoreTest], scans: Sequence[FeatureScan] = (), seed: int = 0) -> LookElsewhere:
    """Return the distribution of the smallest p-value of everything that was looked at, under no effect.

    Parameters
    ----------
    looked : what was looked at by itself.
    scans : details, each of them one more look.
    """
    looked = [one for one in looked if one.span.shape[1]]
    if not looked and not scans:
        return LookElsewhere(np.ones(1), 0.0)
    height = len(looked[0].span) if looked else len(scans[0].basis)
    spans = np.concatenate([np.zeros((height, 0)), *(one.span for one in looked)], axis=1)
    ends = np.cumsum([one.span.shape[1] for one in looked], dtype=int)
    random = np.random.default_rng(seed)
    parts = []
    for _ in range(thresholds.LOOK_DRAWS // thresholds.LOOK_DRAWS_AT_ONCE):
        draws = random.normal(size=(thresholds.LOOK_DRAWS_AT_ONCE, height))
        each = [_smallest((draws @ spans) ** 2, ends)] if looked else []
        parts.append(np.min([*each, *(_smallest_detail(one, draws) for one in scans)], axis=0))
    smallest = np.sort(np.concatenate(parts))
    edge = max(2, int(thresholds.LOOK_TAIL * thresholds.LOOK_DRAWS))
    return LookElsewhere(smallest, float(edge / thresholds.LOOK_DRAWS / smallest[edge - 1]))


def _smallest(squares: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Return the smallest p-value of each draw; squares are the drawn scores by direction, (draws, directions)."""
    return _least(np.add.reduceat(squares, np.concatenate([[0], ends[:-1]]), axis=1), np.diff(ends, prepend=0))


def _smallest_detail(one: FeatureScan, draws: np.ndarray) -> np.ndarray:
    """Return the smallest p-value of all details for each draw, (draws,)."""
    return np.min([_least(scores, batch.freedom) for batch, scores in one.scores(draws)], axis=0)


def _least(scores: np.ndarray, freedom: np.ndarray) -> np.ndarray:
    """Return the smallest p-value over scores (draws, F) with their degrees of freedom (F,)."""
    # Among equal degrees of freedom the largest score has the smallest p.
    kinds = np.unique(freedom[freedom > 0]).tolist()
    each = [stats.chi2.sf(scores[:, freedom == one].max(axis=1), one) for one in kinds]
    return np.min([np.ones(len(scores)), *each], axis=0)
