"""How often does chance alone do so well somewhere?  Many candidates are looked at, and the best of many is not rare.

All scores come from one residual.  Under no effect it is white within the space that the model leaves, so the
distribution of the smallest of all p-values is found by drawing it (Westfall & Young, Resampling-Based Multiple
Testing, 1993), correlations included and without any refit.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from imubayes.criticism.screen import Explained

_DRAWS, _AT_ONCE = 3000, 250
# Below this quantile of the drawn minima their tail is carried on: there p_global is proportional to p.
_TAIL = 0.01


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
        edge = max(2, int(_TAIL * len(self.smallest)))
        reference = self.smallest[edge - 1]
        if p < reference:
            return min(1.0, p * edge / len(self.smallest) / reference)
        return float(np.searchsorted(self.smallest, p, side="right") / len(self.smallest))


def look_elsewhere(looked: Sequence[Explained], seed: int = 0) -> LookElsewhere:
    """Return the distribution of the smallest p-value of everything that was looked at, under no effect."""
    if not looked:
        return LookElsewhere(np.ones(1), 0.0)
    spans = np.concatenate([one.span for one in looked], axis=1)
    ends = np.cumsum([one.span.shape[1] for one in looked])
    random = np.random.default_rng(seed)
    smallest = np.concatenate(
        [_smallest((random.normal(size=(_AT_ONCE, len(spans))) @ spans) ** 2, ends) for _ in range(_DRAWS // _AT_ONCE)]
    )
    smallest = np.sort(smallest)
    edge = max(2, int(_TAIL * _DRAWS))
    return LookElsewhere(smallest, float(edge / _DRAWS / smallest[edge - 1]))


def _smallest(squares: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Return the smallest p-value of each draw; squares are the drawn scores by direction, (draws, directions)."""
    sums = np.add.reduceat(squares, np.concatenate([[0], ends[:-1]]), axis=1)
    return np.min(stats.chi2.sf(sums, np.diff(ends, prepend=0)), axis=1)
