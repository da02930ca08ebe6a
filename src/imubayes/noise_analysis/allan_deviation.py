"""Overlapping Allan variance of a running sum, in chunks.

Source: IEEE Std 952, annex C; Riley, NIST SP 1065, eq. 11.  With S the running sum, the means over neighbouring spans
of m samples from i on differ by (S_(i+2m) − 2 S_(i+m) + S_i)/m; half the mean square over all i is σ²(mτ₀).
"""

from dataclasses import dataclass

import numpy as np

from imubayes.noise_analysis.degrees_of_freedom import chi_square_interval, equivalent_degrees
from imubayes.noise_analysis.running_sum import CHUNK, RunningSum

_LEAST_SPANS = 3  # spans of the longest averaging time in the record
_MOST_MISSING = 0.05  # of the samples of a span; a mean over fewer has a visibly larger variance


@dataclass(frozen=True)
class AllanVariance:
    """Overlapping Allan variance at octave averaging times.

    Attributes
    ----------
    factor : shape (K,), averaging factors m = 1, 2, 4, …
    tau : shape (K,), averaging times, s.
    variance : shape (K,), squared output units.
    terms : shape (K,), number of differences averaged; fewer than the grid has where samples are missing.
    phases : number of values of the running sum.
    """

    factor: np.ndarray
    tau: np.ndarray
    variance: np.ndarray
    terms: np.ndarray
    phases: int

    def degrees(self, exponents: np.ndarray) -> np.ndarray:
        """Return the equivalent degrees of freedom, shape (K,).

        Missing samples reduce them by the share of differences that is left.

        Parameters
        ----------
        exponents : shape (K,), power-law exponent of the dominant noise at each averaging time.
        """
        whole = self.phases - 2 * self.factor
        return np.array([
            max(1.0, equivalent_degrees(int(exponent), int(m), self.phases) * terms / of)
            for exponent, m, terms, of in zip(exponents, self.factor, self.terms, whole, strict=True)
        ])  # fmt: skip

    def interval(self, exponents: np.ndarray, probability: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the ends of the interval of the deviation, and the degrees of freedom, shape (K,) each."""
        degrees = self.degrees(exponents)
        pairs = [
            chi_square_interval(float(np.sqrt(variance)), float(edf), probability)
            for variance, edf in zip(self.variance, degrees, strict=True)
        ]
        low, high = np.array(pairs).T
        return low, high, degrees


def allan_variance(record: RunningSum) -> AllanVariance:
    """Return the overlapping Allan variance at octave averaging times up to a third of the record.

    Spans with more than 5 % of their samples missing are left out; a span's mean is over the samples present.
    """
    factors, variances, terms = [], [], []
    factor = 1
    while _LEAST_SPANS * factor <= record.samples:
        total, count = _sum_of_squares(record, factor)
        if count:
            factors.append(factor)
            variances.append(total / (2 * count))
            terms.append(count)
        factor *= 2
    found = np.array(factors, dtype=np.int64)
    return AllanVariance(
        found, found * record.interval, np.array(variances), np.array(terms, dtype=np.int64), record.samples + 1
    )


def _sum_of_squares(record: RunningSum, factor: int) -> tuple[float, int]:
    """Return the sum of the squared differences of neighbouring means, and their number."""
    total, count, whole = 0.0, 0, record.samples + 1 - 2 * factor
    for first in range(0, whole, CHUNK):
        size = min(CHUNK, whole - first)
        if 2 * factor <= CHUNK:
            joined = record.read(first, size + 2 * factor)
            start, middle, end = joined[:size], joined[factor : factor + size], joined[2 * factor :]
        else:
            start, middle, end = (record.read(first + shift * factor, size) for shift in range(3))
        if record.holes is None:
            difference = (end - 2 * middle + start) / factor
        else:
            difference = _with_holes(record, first, factor, start, middle, end)
        total += float(difference @ difference)
        count += len(difference)
    return total, count


def _with_holes(
    record: RunningSum, first: int, factor: int, start: np.ndarray, middle: np.ndarray, end: np.ndarray
) -> np.ndarray:
    """Return the differences of means over the samples present, where enough are."""
    place = first + np.arange(len(start))
    missing = [record.missing_before(place + shift * factor) for shift in range(3)]
    early, late = (factor - (missing[k + 1] - missing[k]) for k in range(2))
    enough = np.minimum(early, late) >= (1 - _MOST_MISSING) * factor
    return (end - middle)[enough] / late[enough] - (middle - start)[enough] / early[enough]
