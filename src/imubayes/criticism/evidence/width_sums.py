"""The evidence of coefficients under normal priors, summed over the widths of these."""

import math
from collections.abc import Sequence

import numpy as np

from imubayes.tail_probabilities import normal_log_survival


def gain_of_coefficients(own: np.ndarray, right: np.ndarray, widths: np.ndarray, sign: np.ndarray) -> np.ndarray:
    """Return the log evidence of coefficients b, exp(uᵀb − bᵀVb/2), under normal priors of given widths.

    Parameters
    ----------
    own, right : V (k, k) or (n, k, k), and u (k,) or (n, k).
    widths : shape (n, k).
    sign : shape (k,) or (n, k): −1 or 1 where only one sign is allowed.
    """
    scaled = widths[:, :, None] * own * widths[:, None, :] + np.eye(widths.shape[1])
    pull = widths * right
    if widths.shape[1] == 1:
        variance = 1 / scaled[:, 0, 0]
        mean, diagonal = pull * variance[:, None], variance[:, None]
        found = 0.5 * pull[:, 0] * mean[:, 0] + 0.5 * np.log(variance)
    else:
        mean = np.linalg.solve(scaled, pull[..., None])[..., 0]
        found = 0.5 * np.sum(pull * mean, axis=-1) - 0.5 * np.linalg.slogdet(scaled)[1]
        diagonal = np.diagonal(np.linalg.inv(scaled), axis1=-2, axis2=-1) if np.any(sign) else np.ones_like(mean)
    if np.any(sign):
        z = sign * mean / np.sqrt(np.maximum(diagonal, 1e-300))
        found = found + np.sum(np.where(sign != 0, normal_log_survival(-z) + math.log(2), 0.0), axis=-1)
    return found


def summed_over_widths(
    own: np.ndarray,
    right: np.ndarray,
    owner: np.ndarray,
    grids: Sequence[tuple[float, ...]],
    sign: np.ndarray,
    start: Sequence[float],
) -> tuple[list[float], float]:
    """Return the likeliest width of each variant and the log evidence summed over all, one variant after the other."""
    best, each = list(start), [np.zeros(1)] * len(grids)
    before: list[float] = []
    while best != before:
        before = list(best)
        for n, grid in enumerate(grids):
            tried = np.array([[width if j == n else best[j] for j in owner] for width in grid])
            each[n] = gain_of_coefficients(own, right, tried, sign)
            best[n] = grid[int(np.argmax(each[n]))]
    means = [float(np.logaddexp.reduce(one)) - math.log(len(one)) for one in each]
    return best, sum(means) - sum(float(one.max()) for one in each[1:])
