"""What would be left of a variance if one prior were better, noise scales unknown.

A better prior is one more reading x of its parameter θ_j, of variance r: r = 0 makes the prior exact, r = s²/3 halves
its width s.  Given the noise scales h everything is normal, and with C = Cov(θ|h), c = Cov(q, θ_j|h), m = E[θ|h]

    Var(q|h, x) = Var(q|h) − c²/(C_jj + r),    E[q|h, x] = E[q|h] + c (x − m_j)/(C_jj + r).

The reading tells of the noise scales, too: p(h|x) ∝ p(h) N(x; m_j, C_jj + r).  It bounds a scatter between few runs,
which is known from its prior more than from them, and that can matter more than what it says of θ_j.  Where x falls is
not known beforehand; it is taken at the mode.  The variance is the mean of the conditional variance plus the variance
of the conditional mean, both over p(h|x), by importance weights on draws of h.
"""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class LinearGivenScales:
    """Q linear quantities and P parameters at given noise scales; means are from the mode.

    Attributes
    ----------
    along : shape (Q, P), covariance of quantities and parameters.
    variance, mean : shape (Q,), of the quantities.
    own, shift : shape (P,), variance and mean of the parameters.
    """

    along: np.ndarray
    variance: np.ndarray
    mean: np.ndarray
    own: np.ndarray
    shift: np.ndarray


class BetterPriors:
    """Sums over draws of the noise scales, for Q quantities and P priors: shape (Q, P)."""

    def __init__(self, shape: tuple[int, int]):
        self._weight, self._scale = np.zeros(shape[1]), None
        self._variance, self._mean, self._square = np.zeros((3, *shape))

    def add(self, at: LinearGivenScales, reading: np.ndarray) -> None:
        """Add a draw; `reading` is r, (P,)."""
        total = at.own + reading
        if self._scale is None:
            self._scale = total
        weight = np.sqrt(self._scale / total) * np.exp(-0.5 * at.shift**2 / total)
        gain = at.along / total
        mean = at.mean[:, None] - gain * at.shift
        self._weight += weight
        self._variance += weight * (at.variance[:, None] - gain * at.along)
        self._mean += weight * mean
        self._square += weight * mean**2

    @property
    def variance(self) -> np.ndarray:
        """Variance of each quantity with each prior better, (Q, P)."""
        mean = self._mean / self._weight
        return np.maximum(self._variance / self._weight + self._square / self._weight - mean**2, 0.0)
