"""How often does chance alone do so well somewhere?  Many candidates are looked at, and the best of many is not rare.

The scores of all candidates come from one residual.  Under no effect g⊥ᵀr is normal with covariance g⊥ᵀg⊥ whatever the
number of rows, so the distribution of the smallest of all p-values is found by drawing it (Westfall & Young,
Resampling-Based Multiple Testing, 1993), correlations included and without any refit.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from imubayes.criticism.screen import Candidate

_DRAWS = 4000
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


def look_elsewhere(candidates: Sequence[Candidate], seed: int = 0) -> LookElsewhere:
    """Return the distribution of the smallest p-value of these candidates under no effect."""
    if not candidates:
        return LookElsewhere(np.ones(1), 0.0)
    spans = np.concatenate([one.span for one in candidates], axis=1)
    # Only the inner products matter: draw in the space that the spans fill.
    gram = spans.T @ spans
    values, vectors = np.linalg.eigh(gram)
    kept = values > 1e-10 * values[-1]
    root = vectors[:, kept] * np.sqrt(values[kept])
    draws = np.random.default_rng(seed).normal(size=(_DRAWS, int(kept.sum()))) @ root.T
    smallest = np.ones(_DRAWS)
    place = 0
    for one in candidates:
        score = np.sum(draws[:, place : place + one.dof] ** 2, axis=1)
        smallest = np.minimum(smallest, stats.chi2.sf(score, one.dof))
        place += one.dof
    smallest = np.sort(smallest)
    edge = max(2, int(_TAIL * _DRAWS))
    return LookElsewhere(smallest, float(edge / _DRAWS / smallest[edge - 1]))
