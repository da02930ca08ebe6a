"""Tail probabilities of the standard distributions, as logarithms beyond what a double can hold.

Strong effects have p-values below the smallest double: `scipy.stats.chi2.logsf` is −∞ from χ² of some 1500 on, where
candidates could not be ranked.  No other module asks SciPy for a tail, so that all agree on how a p-value ends:
logarithms have no floor, probabilities the one of `LEAST_P`, so that each has a logarithm and a place in an order.

Far in the tail the incomplete gamma and beta functions are continued fractions (NIST Digital Library of Mathematical
Functions, 8.9.2 and 8.17.22).  The rest is of `scipy.special`: `scipy.stats` takes a third of a second to import.
"""

import itertools
from collections.abc import Callable

import numpy as np
from scipy import special

LEAST_P = 1e-300
"""Floor of probabilities."""
_LEAST_TAIL = 1e-280
_TINY = 1e-290  # stands for 0 in the recurrence of the continued fraction
_MOST_TERMS = 100_000

Values = np.ndarray | np.number | float | int


def p_value(log_p: Values) -> np.ndarray:
    """Return a probability of at least `LEAST_P` from its logarithm."""
    return np.asarray(np.maximum(np.exp(log_p), LEAST_P))


def normal_log_survival(z: Values) -> np.ndarray:
    """Return the logarithm of the upper tail of the standard normal distribution."""
    return np.asarray(special.log_ndtr(-np.asarray(z, dtype=float)))


def normal_survival(z: Values) -> np.ndarray:
    """Return the upper tail of the standard normal distribution."""
    return np.asarray(np.maximum(special.ndtr(-np.asarray(z, dtype=float)), LEAST_P))


def normal_probability(z: Values) -> np.ndarray:
    """Return Φ(z), the distribution function of the standard normal distribution, with no floor."""
    return np.asarray(special.ndtr(np.asarray(z, dtype=float)))


def error_complement(x: Values) -> np.ndarray:
    """Return erfc(x): twice the probability that a standard normal variable exceeds √2 x."""
    return np.asarray(special.erfc(np.asarray(x, dtype=float)))


def chi2_log_survival(chi2: Values, freedom: Values) -> np.ndarray:
    """Return the logarithm of the upper tail of the χ² distribution.

    Parameters
    ----------
    chi2, freedom : of shapes that broadcast; degrees of freedom are positive.
    """
    a, x = _broadcast(np.asarray(freedom) / 2, np.asarray(chi2) / 2)
    below, above = special.gammainc(a, x), special.gammaincc(a, x)

    def beyond(far: np.ndarray) -> np.ndarray:
        at, over = a[far], x[far]
        ratio = _continued_fraction(lambda n: (n * (at - n), over - at + 2 * n + 1), over - at + 1)
        return at * np.log(over) - over - special.gammaln(at) - np.log(ratio)

    return _log(np.asarray(below), np.asarray(above), beyond)


def chi2_survival(chi2: Values, freedom: Values) -> np.ndarray:
    """Return the upper tail of the χ² distribution."""
    return np.asarray(np.maximum(special.gammaincc(np.asarray(freedom) / 2, np.asarray(chi2) / 2), LEAST_P))


def chi2_cdf(chi2: Values, freedom: Values) -> np.ndarray:
    """Return the lower tail of the χ² distribution."""
    return np.asarray(np.maximum(special.gammainc(np.asarray(freedom) / 2, np.asarray(chi2) / 2), LEAST_P))


def f_log_survival(ratio: Values, numerator: Values, denominator: Values) -> np.ndarray:
    """Return the logarithm of the upper tail of the F distribution with these degrees of freedom."""
    first, second = np.asarray(numerator) / 2, np.asarray(denominator) / 2
    return _log_beta_tail(second, first, np.asarray(ratio) * first / second)


def f_survival(ratio: Values, numerator: Values, denominator: Values) -> np.ndarray:
    """Return the upper tail of the F distribution with these degrees of freedom."""
    return p_value(f_log_survival(ratio, numerator, denominator))


def t_log_survival(t: Values, freedom: Values) -> np.ndarray:
    """Return the logarithm of the upper tail of Student's t distribution."""
    t = np.asarray(t, dtype=float)
    half = _log_beta_tail(np.asarray(freedom) / 2, 0.5, t**2 / np.asarray(freedom)) - np.log(2)
    return np.where(t > 0, half, np.log1p(-np.exp(half)))


def t_survival(t: Values, freedom: Values) -> np.ndarray:
    """Return the upper tail of Student's t distribution."""
    return p_value(t_log_survival(t, freedom))


def binomial_survival(count: int, trials: int, share: float) -> float:
    """Return the probability of at least `count` of so many trials, each of probability `share`."""
    return max(float(special.bdtrc(count - 1, trials, share)), LEAST_P) if count > 0 else 1.0


def _log_beta_tail(a: Values, b: Values, odds: Values) -> np.ndarray:
    """Return the logarithm of the regularised incomplete beta function at x = 1/(1 + odds).

    1 − x is what counts if x is nearly 1, as for a denominator of 10⁹ degrees of freedom.
    """
    a, b, odds = _broadcast(a, b, odds)
    x = 1 / (1 + odds)
    y, near = odds * x, odds < 1
    above = np.where(near, special.betaincc(b, a, y), special.betainc(a, b, x))
    below = np.where(near, special.betainc(b, a, y), special.betaincc(a, b, x))

    def beyond(far: np.ndarray) -> np.ndarray:
        p, q, at = a[far], b[far], x[far]

        def term(n: int) -> tuple[np.ndarray, float]:
            m = n // 2
            if n % 2:
                return -(p + m) * (p + q + m) * at / ((p + 2 * m) * (p + 2 * m + 1)), 1.0
            return m * (q - m) * at / ((p + 2 * m - 1) * (p + 2 * m)), 1.0

        power = -(p + q) * np.log1p(odds[far]) + q * np.log(odds[far])
        return power - np.log(p) - special.betaln(p, q) - np.log(_continued_fraction(term, np.ones_like(p)))

    return _log(np.asarray(below), np.asarray(above), beyond)


def _broadcast(*values: Values) -> tuple[np.ndarray, ...]:
    return tuple(np.asarray(each, dtype=float) for each in np.broadcast_arrays(*values))


def _log(below: np.ndarray, above: np.ndarray, beyond: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """Return the logarithm of a tail: from its complement if it is nearly 1, and `beyond` if it underflows."""
    result = np.asarray(np.where(above > 0.5, np.log1p(-np.minimum(below, 0.5)), np.log(np.maximum(above, LEAST_P))))
    far = np.asarray(above < _LEAST_TAIL)
    if far.any():
        result[far] = beyond(far)
    return result


def _continued_fraction(term: Callable[[int], tuple[np.ndarray, Values]], first: np.ndarray) -> np.ndarray:
    """Return b₀ + a₁/(b₁ + a₂/(b₂ + …)) with aₙ and bₙ of `term`, by the method of Lentz, modified."""
    value = upper = np.where(first == 0, _TINY, first)
    lower = np.zeros_like(first)
    for n in itertools.islice(itertools.count(1), _MOST_TERMS):
        a, b = term(n)
        lower, upper = b + a * lower, b + a / upper
        lower, upper = 1 / np.where(lower == 0, _TINY, lower), np.where(upper == 0, _TINY, upper)
        value = value * lower * upper
        if np.all(np.abs(lower * upper - 1) < 1e-15):
            break
    return value
