"""Means over groups of entries."""

import numpy as np


def group_means(values: np.ndarray, group: np.ndarray) -> np.ndarray:
    """Return at each entry the mean of the finite values of its group, (n,); 0 where the group has none.

    Parameters
    ----------
    values : shape (n,).
    group : shape (n,), numbers of the groups, from 0.
    """
    good = np.isfinite(values)
    total = np.bincount(group, np.where(good, values, 0.0))
    return (total / np.maximum(np.bincount(group, good), 1))[group]
