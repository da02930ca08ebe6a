"""Overlapping Allan variance of a record, its equivalent degrees of freedom and its chi-square interval.

The variance is computed from the running sum, in chunks.  With S the running sum, the means over neighbouring spans of
m samples from i on differ by (S_(i+2m) − 2 S_(i+m) + S_i)/m; half the mean square over all i is σ²(mτ₀).  Source: IEEE
Std 952, annex C; Riley, NIST SP 1065, eq. 11.

The source of the degrees of freedom is Greenhall and Riley, "Uncertainty of stability variances based on finite
differences", Proc. 35th PTTI (2003), in the notation there: d = 2 differences of the phase, stride factor S = m, filter
factor F = m.  The power-law exponent α is that of the spectrum of the rate, f^α: quantisation 2, white 0, flicker −1,
random walk −2.
"""

import math
from dataclasses import dataclass

import numpy as np
import scipy  # loads its parts when they are first used

from imubayes_recordings.noise_analysis.running_sum import CHUNK, RunningSum

_DIFFERENCES = 2
_MOST_TERMS = 100  # of the sum before its asymptotic form is used
# a_0 and a_1 of table 2 of the source, for d = 2, by α.
_ASYMPTOTE = {0: (2 / 3, 1 / 3), -1: (0.852, 0.375), -2: (1.079, 0.368)}


def equivalent_degrees(exponent: int, factor: int, phases: int) -> float:
    """Return the equivalent degrees of freedom of the overlapping Allan variance.

    Parameters
    ----------
    exponent : α, one of 2, 0, −1, −2.
    factor : averaging factor m.
    phases : number of values of the running sum, samples + 1; more than 2m.
    """
    terms = phases - _DIFFERENCES * factor
    if terms < 1:
        raise ValueError(f"{phases} phases have no second difference over {factor}")
    spans = terms / factor
    if exponent == 2:
        return _of_quantisation(terms, spans)
    summed = min(terms, (_DIFFERENCES + 1) * factor)
    if summed <= _MOST_TERMS:
        filtered = float(factor) if factor * (_DIFFERENCES + 1) <= _MOST_TERMS else math.inf
        return 1 / _inverse(exponent, filtered, summed, terms, factor)
    if spans > _DIFFERENCES + 1:
        a_0, a_1 = _ASYMPTOTE[exponent]
        return spans / (a_0 - a_1 / spans)
    return 1 / _inverse(exponent, math.inf, _MOST_TERMS, _MOST_TERMS, _MOST_TERMS / spans)


def chi_square_interval(deviation: float, degrees: float, probability: float) -> tuple[float, float]:
    """Return the interval of a deviation whose square has a chi-square distribution (NIST SP 1065, eq. 45)."""
    tail = (1 - probability) / 2
    low, high = (deviation * math.sqrt(degrees / float(scipy.stats.chi2.ppf(p, degrees))) for p in (1 - tail, tail))
    return low, high


def _of_quantisation(terms: int, spans: float) -> float:
    """Case 4 of the source: second differences of white phase noise are correlated only over whole spans."""
    central = math.comb(2 * _DIFFERENCES, _DIFFERENCES)
    if math.ceil(spans) <= _DIFFERENCES:
        lags = range(1, math.ceil(spans))
        correlated = sum((1 - k / spans) * math.comb(2 * _DIFFERENCES, _DIFFERENCES - k) ** 2 for k in lags)
        return terms / (1 + 2 * correlated / central**2)
    a_0 = math.comb(4 * _DIFFERENCES, 2 * _DIFFERENCES) / central**2
    return terms / (a_0 - _DIFFERENCES / 2 / spans)


def _inverse(exponent: int, filtered: float, summed: int, terms: int, stride: float) -> float:
    """Return 1/edf: the sum of squared correlations of the differences over `summed` lags (eq. 10 and 13)."""
    lag = np.arange(summed + 1) / stride
    squared = _covariance(lag, filtered, exponent) ** 2
    weight = 2 * (1 - np.arange(summed + 1) / terms)
    weight[0], weight[-1] = 1.0, 1 - summed / terms
    return float(weight @ squared) / (squared[0] * terms)


def _covariance(lag: np.ndarray, filtered: float, exponent: int) -> np.ndarray:
    """Return the generalised autocovariance of the second differences, up to a factor (eq. 9)."""
    binomial = (1.0, -4.0, 6.0, -4.0, 1.0)
    found = np.zeros_like(lag)
    for shift, weight in zip(range(-2, 3), binomial, strict=True):
        found += weight * _filtered(lag + shift, filtered, exponent)
    return found


def _filtered(lag: np.ndarray, filtered: float, exponent: int) -> np.ndarray:
    """Return the covariance of the filtered phase (eq. 8)."""
    if math.isinf(filtered):
        return _power_law(lag, exponent + 2)
    step = 1 / filtered
    second = 2 * _power_law(lag, exponent) - _power_law(lag - step, exponent) - _power_law(lag + step, exponent)
    return filtered**2 * second


def _power_law(lag: np.ndarray, exponent: int) -> np.ndarray:
    """Return the generalised covariance of power-law noise (eq. 7): |t|^(3 − α), times ln |t| if 3 − α is even."""
    size = np.abs(lag)
    power = 3 - exponent
    if power % 2:
        return -size if exponent == 2 else size**power
    return size**power * np.log(np.where(size > 0, size, 1.0))


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
    terms : shape (K,), number of differences averaged; fewer than the grid has if samples are missing.
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
    """Return the differences of means over the samples present, if enough are."""
    place = first + np.arange(len(start))
    missing = [record.missing_before(place + shift * factor) for shift in range(3)]
    early, late = (factor - (missing[k + 1] - missing[k]) for k in range(2))
    enough = np.minimum(early, late) >= (1 - _MOST_MISSING) * factor
    return (end - middle)[enough] / late[enough] - (middle - start)[enough] / early[enough]
