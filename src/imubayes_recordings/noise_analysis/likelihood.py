"""Likelihood of the noise terms, given the cosine statistics of a record, and its maximum.

The coefficients are independent normal values of variance v_k = Σ_j θ_j g_jk, θ_j the squared coefficient of term j and
g_jk its known variance per unit.  A ramp is integrated out under a flat prior (restricted likelihood, REML), so that it
costs the slow terms the degree of freedom that it takes.  Parameters are log θ_j, and log T of a Gauss–Markov process.
"""

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from imubayes_recordings.noise_analysis.cosine_spectra import CosineStatistics, level_variances
from imubayes_recordings.noise_analysis.noise_terms import NoiseTerm

_STEPS = 200
_LARGEST_STEP = 2.0  # in log θ
_CONVERGED = 1e-9  # expected gain in log likelihood
_DAMPING = 1e-10  # of a term that vanishes, and with it its information
_LEAST_COUNT = 6  # coefficients of a band for the start
_REVIVALS = 4
VANISHED = 0.01  # information on log θ below which a term has no part in the variance
_MOST_TAKEN = 0.05  # of the width of a bin, or of its white noise, in bands that are left out
_LEAST_TIME = 5.0  # of a correlation time times the highest frequency: at 10 samples; a shorter one is a filter
_KEPT = 12  # shapes of Gauss–Markov noise at recent correlation times
_LOG_STEP = 1e-4  # for the derivative with respect to log T


@dataclass(frozen=True)
class Maximum:
    """Maximum of the log likelihood.

    Attributes
    ----------
    terms : the terms of the model, without the ramp.
    parameters : shape (P,), log θ of each term, then log T where Gauss–Markov noise is among them.
    log_likelihood : there.
    converged : whether the last step promised no gain.
    """

    terms: tuple[NoiseTerm, ...]
    parameters: np.ndarray
    log_likelihood: float
    converged: bool

    def squared(self, term: NoiseTerm) -> float:
        """Return the squared coefficient of a term, 0 if the model has none."""
        return math.exp(self.parameters[self.terms.index(term)]) if term in self.terms else 0.0

    @property
    def correlation_time(self) -> float:
        """T of the Gauss–Markov term, s; NaN without."""
        return math.exp(self.parameters[-1]) if NoiseTerm.MARKOV in self.terms else math.nan


class NoiseLikelihood:
    """Log likelihood of the noise terms of one record.

    Attributes
    ----------
    power, count, frequency : shape (K,), sum of the squared coefficients of each bin, their number, frequency in Hz.
    """

    def __init__(
        self,
        statistics: CosineStatistics,
        shortest_tau: float = 0.0,
        left_out: Sequence[tuple[float, float]] = (),
        removed: Sequence[np.ndarray] | None = None,
    ):
        """Use the coefficients at frequencies up to 1/(2 × `shortest_tau`), all if it is 0.

        Parameters
        ----------
        left_out : bands of frequency in Hz whose coefficients are not used.
        removed : part of white noise that each coefficient lacks (`removed_shares`).
        """
        self._statistics = statistics
        self._collect(statistics, shortest_tau, left_out, removed)
        self._shapes: dict[NoiseTerm, np.ndarray] = {}
        self._recent: dict[float, np.ndarray] = {}
        self._stack: tuple[tuple[tuple[NoiseTerm, ...], float], np.ndarray] = (((), 0.0), np.zeros((0, 0)))
        self._response = np.ones(len(self.power))

    def rolled_off(self, attenuation: float) -> "NoiseLikelihood":
        """Return the likelihood of a record behind a low-pass filter.

        The logarithm of the power response is −`attenuation` at the highest frequency in use and goes as sin²(πfτ₀):
        any short filter has this form below its corner.
        """
        found = copy.copy(self)
        found._stack = (((), 0.0), np.zeros((0, 0)))
        found._response = np.exp(-attenuation * self._roll_off)
        return found

    @cached_property
    def _roll_off(self) -> np.ndarray:
        square = np.sin(np.pi * self.frequency * self._statistics.interval) ** 2
        return square / square.max()

    def attenuation_step(self, maximum: Maximum) -> tuple[float, float, float]:
        """Return the change of the attenuation towards its maximum of the likelihood, its sd, and a growth.

        The last is the factor of the uncertainty of white noise if the attenuation is not known.
        """
        derivative = self._derivatives(maximum.terms, maximum.parameters)
        variance = self.variance(maximum)
        derivative = np.concatenate([derivative, (-self._roll_off * variance)[None]])
        gradient = -0.5 * float(derivative[-1] @ (self.count / variance - self.power / variance**2))
        information = _information(derivative, variance, self.count)
        free = [place for place in range(len(information)) if information[place, place] > VANISHED]
        covariance = np.linalg.pinv(information[np.ix_(free, free)])
        square = float(covariance[-1, -1])
        white = maximum.terms.index(NoiseTerm.WHITE)
        growth = 1.0
        if white in free:
            place = free.index(white)
            alone = np.linalg.pinv(information[np.ix_(free[:-1], free[:-1])])
            growth = math.sqrt(max(1.0, covariance[place, place] / alone[place, place]))
        return gradient * square, math.sqrt(square), growth

    def _collect(
        self,
        statistics: CosineStatistics,
        shortest_tau: float,
        left_out: Sequence[tuple[float, float]],
        removed: Sequence[np.ndarray] | None,
    ) -> None:
        # Of each level frequency and width of its bins, then power, count, and what a ramp and the record have there.
        levels: list[tuple[np.ndarray, ...]] = []
        if (fine := statistics.fine) is not None:
            step, none = 1 / (2 * statistics.block * statistics.interval), np.zeros(len(fine.power))
            count = np.full(len(none), float(fine.blocks))
            levels.append((fine.order * step, np.full(len(none), step), fine.power, count, none, none))
        for level in statistics.coarse:
            step = 1 / (2 * level.means * statistics.block * statistics.interval)
            middle, count = (level.first + level.last) / 2 * step, level.count.astype(float)
            levels.append((middle, level.count * step, level.power, count, level.ramp, level.coefficient))
        at, wide, *of_bin = map(np.concatenate, zip(*levels, strict=True)) if levels else [np.zeros(0)] * 6
        taken = np.zeros(len(at))
        for low, high in left_out:
            taken += np.clip(np.minimum(high, at + wide / 2) - np.maximum(low, at - wide / 2), 0.0, None) / wide
        lacking = np.zeros(len(at)) if removed is None else np.concatenate(removed)
        within = at <= (0.5 / shortest_tau if shortest_tau else math.inf) * (1 + 1e-9)
        self._used = within & (np.maximum(taken, lacking) < _MOST_TAKEN)
        self.frequency = at[self._used]
        self.power, self.count, self._ramp, self._coefficient = (part[self._used] for part in of_bin)
        self.count = self.count * (1 - lacking[self._used])

    @property
    def span(self) -> float:
        """Duration of the record, s."""
        return self._statistics.samples * self._statistics.interval

    @property
    def shortest_time(self) -> float:
        """Shortest correlation time of a Gauss–Markov process, s: that of a shorter one is the work of a filter."""
        return _LEAST_TIME / float(self.frequency.max())

    @cached_property
    def _octave(self) -> np.ndarray:
        return np.floor(np.log2(self.frequency)).astype(int)

    def octaves(self) -> list[np.ndarray]:
        """Return the places of the bins in each octave of frequency, the lowest first."""
        return [np.flatnonzero(self._octave == octave) for octave in np.unique(self._octave)]

    @cached_property
    def _bands(self) -> list[np.ndarray]:
        """The octaves, the lowest joined: the power of a few coefficients may be next to nothing by chance."""
        octaves = self.octaves()
        wide = [at for at in octaves if self.count[at].sum() >= _LEAST_COUNT]
        lowest = [at for at in octaves if self.count[at].sum() < _LEAST_COUNT]
        return [*([np.concatenate(lowest)] if lowest else []), *wide]

    def shape(self, term: NoiseTerm, correlation_time: float = math.nan) -> np.ndarray:
        """Return the variance of a coefficient per squared coefficient of the term, shape (K,)."""
        return self._response * self._unfiltered(term, correlation_time)

    def _unfiltered(self, term: NoiseTerm, correlation_time: float) -> np.ndarray:
        if term is NoiseTerm.MARKOV:
            return self._markov(correlation_time)
        if term not in self._shapes:
            self._shapes[term] = np.concatenate(level_variances(term, self._statistics))[self._used]
        return self._shapes[term]

    def _markov(self, correlation_time: float) -> np.ndarray:
        if correlation_time not in self._recent:
            if len(self._recent) >= _KEPT:
                self._recent.pop(next(iter(self._recent)))
            shape = np.concatenate(level_variances(NoiseTerm.MARKOV, self._statistics, correlation_time))[self._used]
            self._recent[correlation_time] = shape
        return self._recent[correlation_time]

    def variance(self, maximum: Maximum) -> np.ndarray:
        """Return the variance of a coefficient, shape (K,)."""
        return self._parts(maximum.terms, maximum.parameters).sum(axis=0)

    def density(self, maximum: Maximum) -> np.ndarray:
        """Return the spectral density of the record at each bin, shape (K,), of which N² is that of white noise."""
        return self.variance(maximum) / self._unfiltered(NoiseTerm.WHITE, math.nan)

    @property
    def sees_ramp(self) -> bool:
        """Whether a ramp shows in any of the coefficients."""
        return bool(np.any(self._ramp))

    def ramp(self, maximum: Maximum) -> tuple[float, float]:
        """Return the slope of the record and its standard uncertainty under the noise, output units per second."""
        variance = self.variance(maximum)
        precision = float(np.sum(self._ramp**2 / variance))
        slope = float(np.sum(self._ramp * self._coefficient / variance)) / precision
        return self._statistics.slope + slope, 1 / math.sqrt(precision)

    def slope_along(self, maximum: Maximum, covariate: Sequence[np.ndarray]) -> tuple[float, float]:
        """Return slope and standard uncertainty of the record along a covariate under the noise.

        Parameters
        ----------
        covariate : cosine coefficients of the covariate at the bins of each coarse level, 0 in those of several.
        """
        fine = self._statistics.fine
        bins = np.concatenate([*([np.zeros(len(fine.power))] if fine is not None else []), *covariate])[self._used]
        variance = self.variance(maximum)
        own = self._coefficient + self._statistics.slope * self._ramp
        precision = float(np.sum(bins**2 / variance))
        return float(np.sum(bins * own / variance)) / precision, 1 / math.sqrt(precision)

    def information(self, maximum: Maximum) -> np.ndarray:
        """Return the expected Fisher information of the parameters, shape (P, P)."""
        derivative = self._derivatives(maximum.terms, maximum.parameters)
        return _information(derivative, self.variance(maximum), self.count)

    def start(self, terms: Sequence[NoiseTerm], correlation_time: float = math.nan) -> np.ndarray:
        """Return where to start: every term as large as the power in its octave of largest share allows."""
        found = []
        for term in terms:
            shape = self.shape(term, correlation_time)
            ratios = [float(np.sum(self.power[at]) / np.sum(self.count[at] * shape[at])) for at in self._bands]
            found.append(math.log(max(min(ratios), 1e-300)))
        return np.array([*found, math.log(correlation_time)] if NoiseTerm.MARKOV in terms else found)

    def maximise(self, terms: Sequence[NoiseTerm], start: np.ndarray, fixed: int | None = None) -> Maximum:
        """Return the maximum, by Fisher scoring with damping.

        A term that has vanished on the way does not come back by itself, as the derivative with respect to log θ
        vanishes with it.  If the likelihood would rise with θ, the term starts again where it begins to matter.

        Parameters
        ----------
        terms : of the model.
        start : shape (P,), parameters.
        fixed : place of a parameter to leave as it is.
        """
        found = self._climb(terms, start, fixed)
        for _ in range(_REVIVALS):
            _, gradient, information = self._expansion(terms, found.parameters)
            size = np.maximum(np.diag(information)[: len(terms)], 1e-300)
            gone = (size < VANISHED) & (gradient[: len(terms)] > 0)
            if fixed is not None and fixed < len(terms):
                gone[fixed] = False
            if not gone.any():
                return found
            again = found.parameters.copy()
            again[: len(terms)][gone] -= 0.5 * np.log(size[gone])
            revived = self._climb(terms, again, fixed)
            if revived.log_likelihood < found.log_likelihood + _CONVERGED:
                return found
            found = revived
        return found

    def _climb(self, terms: Sequence[NoiseTerm], start: np.ndarray, fixed: int | None) -> Maximum:
        parameters = np.array(start, dtype=float)
        free = np.array([place for place in range(len(parameters)) if place != fixed], dtype=int)
        value, gradient, information = self._expansion(terms, parameters)
        damping, converged = 0.0, not len(free)
        for _ in range(_STEPS):
            if converged:
                break
            step = _step(gradient[free], information[np.ix_(free, free)], damping)
            promised = float(gradient[free] @ step)
            if promised < 0:
                # A step cut short in one parameter may lead down in the others; damped, each follows its gradient.
                damping = max(10 * damping, 1e-2)
                continue
            trial = parameters.copy()
            trial[free] = self._inside(terms, parameters + _spread(step, free, len(parameters)))[free]
            after, next_gradient, next_information = self._expansion(terms, trial)
            if after >= value:
                gain = after - value
                converged = gain < _CONVERGED and damping < 1.0
                parameters, value, gradient, information = trial, after, next_gradient, next_information
                damping = damping / 10 if damping > 1e-3 else 0.0
            else:
                converged = promised < _CONVERGED
                damping = max(10 * damping, 1e-2)
        return Maximum(tuple(terms), parameters, value, converged)

    def _inside(self, terms: Sequence[NoiseTerm], parameters: np.ndarray) -> np.ndarray:
        """Return parameters with the correlation time between the shortest one and the record."""
        if NoiseTerm.MARKOV in terms:
            parameters[-1] = min(max(parameters[-1], math.log(self.shortest_time)), math.log(self.span))
        return parameters

    def _parts(self, terms: Sequence[NoiseTerm], parameters: np.ndarray) -> np.ndarray:
        """Return the contribution of every term to the variance, shape (terms, K)."""
        time = math.exp(parameters[-1]) if NoiseTerm.MARKOV in terms else math.nan
        return np.exp(parameters[: len(terms)])[:, None] * self._stacked(tuple(terms), time)

    def _stacked(self, terms: tuple[NoiseTerm, ...], time: float) -> np.ndarray:
        """Return the shapes of the terms, shape (terms, K); those of the last call are kept."""
        key = (terms, time if NoiseTerm.MARKOV in terms else 0.0)
        if key != self._stack[0]:
            self._stack = (key, np.stack([self.shape(term, time) for term in terms]))
        return self._stack[1]

    def _derivatives(self, terms: Sequence[NoiseTerm], parameters: np.ndarray) -> np.ndarray:
        """Return the derivative of the variance with respect to every parameter, shape (P, K)."""
        parts = self._parts(terms, parameters)
        if NoiseTerm.MARKOV not in terms:
            return parts
        low, high = (self.shape(NoiseTerm.MARKOV, math.exp(parameters[-1] + sign * _LOG_STEP)) for sign in (-1, 1))
        amplitude = math.exp(parameters[tuple(terms).index(NoiseTerm.MARKOV)])
        return np.concatenate([parts, (amplitude * (high - low) / (2 * _LOG_STEP))[None]])

    def _expansion(self, terms: Sequence[NoiseTerm], parameters: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        """Return the log likelihood, its gradient, and the Fisher information."""
        derivative = self._derivatives(terms, parameters)
        variance = derivative[: len(terms)].sum(axis=0)
        inverse = 1 / variance
        along = float(np.sum(self._ramp * self._coefficient * inverse))
        precision = float(np.sum(self._ramp**2 * inverse))
        squares = float(np.sum(self.power * inverse)) - (along**2 / precision if precision else 0.0)
        value = -0.5 * (float(self.count @ np.log(variance)) + squares + (math.log(precision) if precision else 0.0))
        gradient = -0.5 * derivative @ (self.count * inverse - self.power * inverse**2)
        if precision:
            d_along = -derivative @ (self._ramp * self._coefficient * inverse**2)
            d_precision = -derivative @ (self._ramp**2 * inverse**2)
            gradient += along / precision * d_along - 0.5 * (along / precision) ** 2 * d_precision
            gradient -= 0.5 * d_precision / precision
        return value, gradient, _information(derivative, variance, self.count)


def _information(derivative: np.ndarray, variance: np.ndarray, count: np.ndarray) -> np.ndarray:
    relative = derivative / variance
    return 0.5 * (relative * count) @ relative.T


def _step(gradient: np.ndarray, information: np.ndarray, damping: float) -> np.ndarray:
    damped = information + np.diag(damping * np.diag(information) + _DAMPING)
    return np.clip(np.linalg.solve(damped, gradient), -_LARGEST_STEP, _LARGEST_STEP)


def _spread(step: np.ndarray, free: np.ndarray, size: int) -> np.ndarray:
    whole = np.zeros(size)
    whole[free] = step
    return whole
