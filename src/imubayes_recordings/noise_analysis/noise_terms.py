"""The noise terms of a static record: spectrum, Allan variance, and what each gives the cosine coefficients.

Two-sided spectra S(f) of the rate and Allan variances (IEEE Std 952, annex B and C):

    term            coefficient   S(f)                  σ²(τ)
    quantisation    Q             τ₀ Q² (2πf)²          3 Q²/τ²
    white           N             N²                    N²/τ
    flicker         B             B²/(2πf)              (2 ln 2/π) B²
    random walk     K             K²/(2πf)²             K² τ/3
    Gauss–Markov    σ, T          2σ²T/(1 + (2πfT)²)    exponential covariance σ² exp(−t/T)
    ramp            R             (deterministic)       R² τ²/2

Samples are those of the discrete processes: white and quantisation independent values, flicker the fractional sum of
order ½ of white noise (Kasdin, Proc. IEEE 83 (1995), 802), random walk a sum of independent increments.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from scipy.fft import dct, dst

from imubayes.foundations.campaign_data import Channel

_DIRECT = 32  # lags of block means summed exactly; beyond, block averaging is a second-order correction


class NoiseTerm(StrEnum):
    """A noise term of a static record."""

    QUANTISATION = "quantisation"
    WHITE = "white"
    FLICKER = "flicker"
    RANDOM_WALK = "random_walk"
    MARKOV = "gauss_markov"
    RAMP = "ramp"


_HOUR = 3600.0
_DEGREE = math.pi / 180
# Units of the coefficients, and what one of them is in SI, for gyros and accelerometers; µg is of the site's gravity.
_GYRO = {
    NoiseTerm.QUANTISATION: ("arcsec", _DEGREE / _HOUR),
    NoiseTerm.WHITE: ("deg/sqrt(h)", _DEGREE / math.sqrt(_HOUR)),
    NoiseTerm.FLICKER: ("deg/h", _DEGREE / _HOUR),
    NoiseTerm.RANDOM_WALK: ("deg/h/sqrt(h)", _DEGREE / _HOUR / math.sqrt(_HOUR)),
    NoiseTerm.MARKOV: ("deg/h", _DEGREE / _HOUR),
    NoiseTerm.RAMP: ("deg/h/h", _DEGREE / _HOUR**2),
}
_ACCELEROMETER = {
    NoiseTerm.QUANTISATION: ("m/s", 0.0),
    NoiseTerm.WHITE: ("ug/sqrt(Hz)", 1.0),
    NoiseTerm.FLICKER: ("ug", 1.0),
    NoiseTerm.RANDOM_WALK: ("ug/sqrt(h)", 1 / math.sqrt(_HOUR)),
    NoiseTerm.MARKOV: ("ug", 1.0),
    NoiseTerm.RAMP: ("ug/h", 1 / _HOUR),
}


def coefficient_unit(channel: Channel, term: NoiseTerm, gravity: float) -> tuple[str, float]:
    """Return the unit of a coefficient and its size in SI (rad/s or m/s², and seconds)."""
    if channel.kind == "gyro":
        return _GYRO[term]
    unit, factor = _ACCELEROMETER[term]
    return unit, 1.0 if term is NoiseTerm.QUANTISATION else factor * 1e-6 * gravity


@dataclass(frozen=True)
class Averages:
    """Consecutive means of `block` samples at `interval` s, `count` of them; samples themselves if block is 1."""

    count: int
    block: int
    interval: float
    thinning: float = 1.0


def coefficient_variance(term: NoiseTerm, averages: Averages, correlation_time: float = math.nan) -> np.ndarray:
    """Return the variance of the cosine coefficients of orders 1 … count − 1, for a squared coefficient of 1.

    Parameters
    ----------
    term : any but the ramp.
    correlation_time : T of a Gauss–Markov process, s.
    """
    return _VARIANCES[term](averages, correlation_time)


def allan_shape(term: NoiseTerm, tau: np.ndarray, correlation_time: float = math.nan) -> np.ndarray:
    """Return the Allan variance of a term per squared coefficient at averaging times in s, shape (K,).

    Source: IEEE Std 952, annex C.
    """
    if term is NoiseTerm.MARKOV:
        x = tau / correlation_time
        small = x**2 * (x / 3 - x**2 / 4)  # series of the bracket, where it would cancel
        bracket = np.where(x < 1e-3, small, x - 0.5 * (3 - 4 * np.exp(-x) + np.exp(-2 * x)))
        return 2 * bracket / x**2
    shapes = {
        NoiseTerm.QUANTISATION: 3 / tau**2,
        NoiseTerm.WHITE: 1 / tau,
        NoiseTerm.FLICKER: np.full_like(tau, 2 * math.log(2) / math.pi),
        NoiseTerm.RANDOM_WALK: tau / 3,
        NoiseTerm.RAMP: tau**2 / 2,
    }
    return shapes[term]


def _half_angle(averages: Averages) -> np.ndarray:
    """Return 4 sin²(πk/2n), the eigenvalues of the second difference with free ends."""
    order = np.arange(1, averages.count)
    return 4 * np.sin(np.pi * order / (2 * averages.count)) ** 2


def _white(averages: Averages, _: float) -> np.ndarray:
    return np.full(averages.count - 1, averages.thinning / (averages.block * averages.interval))


def _quantisation(averages: Averages, _: float) -> np.ndarray:
    # Differences of independent angles: the second difference with fixed ends, which differs from that with free ends
    # in the two corners.
    eigenvalue = _half_angle(averages)
    corners = 4 / averages.count * (1 - eigenvalue / 4)
    return (eigenvalue + corners) / (averages.block * averages.interval) ** 2


def _random_walk(averages: Averages, _: float) -> np.ndarray:
    # Differences of block means are triangular sums of increments: their covariance is 1 − c × (second difference).
    eigenvalue = _half_angle(averages)
    overlap = (1 - 1 / averages.block**2) / 6
    return averages.interval * averages.block * (1 - overlap * eigenvalue) / eigenvalue


def _flicker(averages: Averages, _: float) -> np.ndarray:
    lag = np.arange(averages.count * averages.block if averages.block == 1 else (_DIRECT + 1) * averages.block)
    # The variogram of the fractional sum of order ½ in closed form: (2/π) Σ_(j ≤ l) 1/(2j − 1).
    variogram = 2 / math.pi * np.concatenate([[0.0], np.cumsum(1 / (2 * lag[1:] - 1.0))])
    if averages.block > 1:
        variogram = _variogram_of_means(variogram, averages)
    return variances_from_lags(-variogram[: averages.count])


def _variogram_of_means(variogram: np.ndarray, averages: Averages) -> np.ndarray:
    """Return the variogram of block means of flicker noise, shape (count,), from that of samples."""
    m, count = averages.block, averages.count
    lag = np.arange(-(m - 1), m)
    weight = (m - np.abs(lag)) / m**2
    within = float(weight @ variogram[np.abs(lag)])
    near = min(count, _DIRECT)
    found = np.empty(count)
    found[:near] = [float(weight @ variogram[np.abs(k * m + lag)]) for k in range(near)]
    far = m * np.arange(near, count, dtype=float)
    # Σ 1/(2j − 1) = ½ (ln l + γ) + ln 2 + 1/(48 l²) + …; averaging adds half the second derivative × (m² − 1)/6.
    with np.errstate(divide="ignore"):
        smooth = (np.log(far) + np.euler_gamma) / 2 + math.log(2) + 1 / (48 * far**2) - (m**2 - 1) / (24 * far**2)
    found[near:] = 2 / math.pi * smooth
    return found - within


def _markov(averages: Averages, correlation_time: float) -> np.ndarray:
    m, step = averages.block, averages.interval / correlation_time
    lag = np.arange(averages.count, dtype=float)
    if m == 1:
        return variances_from_lags(np.exp(-lag * step))
    gain = math.expm1(-m * step) / (m * math.expm1(-step))
    covariance = gain**2 * np.exp(-(np.maximum(lag - 1, 0) * m + 1) * step)
    apart = np.arange(1, m)
    covariance[0] = (m + 2 * float((m - apart) @ np.exp(-apart * step))) / m**2
    return variances_from_lags(covariance)


def variances_from_lags(covariance: np.ndarray) -> np.ndarray:
    """Return the variances of cosine coefficients 1 … n − 1 from the (generalised) covariance at lags 0 … n − 1.

    A coefficient's weights u_i have the autocorrelation a(l) = ((n − l) cos(φl) − sin(φl)/sin φ)/n with φ = πk/n, so
    the variance is c(0) + 2 Σ_l c(l) a(l): a cosine and a sine transform.  As Σ_i u_i = 0, the same holds with minus
    the variogram for c.
    """
    n = len(covariance)
    lag = np.arange(n)
    even = np.concatenate([[0.0], ((n - lag) * covariance)[1:], [0.0]])
    cosine = dct(even, type=1)[1:n]
    sine = dst(covariance[1:], type=1)
    angle = np.pi * np.arange(1, n) / n
    return covariance[0] + (cosine - sine / np.sin(angle)) / n


_VARIANCES: dict[NoiseTerm, Callable[[Averages, float], np.ndarray]] = {
    NoiseTerm.QUANTISATION: _quantisation,
    NoiseTerm.WHITE: _white,
    NoiseTerm.FLICKER: _flicker,
    NoiseTerm.RANDOM_WALK: _random_walk,
    NoiseTerm.MARKOV: _markov,
}
