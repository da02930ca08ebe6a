"""Which noise terms a record determines: estimates with intervals for those, upper limits for the others.

All terms are tried together.  A term is determined if leaving it out lowers the log likelihood by more than chance
would, the least significant going first; a Gauss–Markov process, whose correlation time is found by a scan, is asked
for more.  A term that is not determined is not set to zero: estimates, intervals and limits are those of the likelihood
with all terms in it, or an interval would leave out what the undetermined ones could take over.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy  # loads its parts when they are first used

from imubayes.noise_analysis.likelihood import Maximum, NoiseLikelihood
from imubayes.noise_analysis.noise_spectra import NoiseTerm

PROBABILITY = 0.95
# A coefficient on its bound of 0 has −2 Δ log L ~ ½χ²₀ + ½χ²₁ (Self and Liang 1987): chance 1 % beyond 5.41.
_LEAST_EVIDENCE = 5.41
# Two coefficients (χ²₂, 13.8 at 0.1 %), of which the correlation time is chosen among some ten independent ones.
_LEAST_EVIDENCE_MARKOV = 18.4
_CHANCE_RAMP = 0.01
_WALKS = 24
_SCAN = 14
_FAINT = 8.0  # in log θ: where a term that the selected model lacks starts
_WIDEST = 60.0  # of an interval in log θ; a coefficient beyond is no coefficient
_BASIC = (NoiseTerm.QUANTISATION, NoiseTerm.WHITE, NoiseTerm.FLICKER, NoiseTerm.RANDOM_WALK)


@dataclass(frozen=True)
class TermEstimate:
    """One coefficient.

    Attributes
    ----------
    term : the noise term.
    value : estimate; NaN where not determined.
    sd : standard uncertainty: the length of the interval over that of a normal distribution of unit sd.
    low, high : profile-likelihood interval of 95 %.
    limit : upper limit of 95 % where not determined; NaN otherwise.
    evidence : −2 Δ log L of leaving the term out.
    maximum : where the likelihood with all terms has its maximum, whether or not that is significant.
    """

    term: NoiseTerm
    value: float
    sd: float
    low: float
    high: float
    limit: float
    evidence: float
    maximum: float

    @property
    def determined(self) -> bool:
        """Whether the record determines the coefficient."""
        return math.isfinite(self.value)


@dataclass(frozen=True)
class Octave:
    """Fit of one octave of frequency: χ² of the coefficients against their number.

    Attributes
    ----------
    low, high : frequencies, Hz.
    chi2, count : sum of the squared standardised coefficients, and their number.
    p_value : two-sided, of χ²; not corrected for the number of octaves.
    """

    low: float
    high: float
    chi2: float
    count: int
    p_value: float


@dataclass(frozen=True)
class NoiseEstimate:
    """The noise terms of one record, in output units.

    Attributes
    ----------
    estimates : of every term.
    correlation_time, correlation_time_sd : T of the Gauss–Markov process, s; NaN where not determined.
    determined : the terms of the model, in the order of `correlation`.
    correlation : shape (P, P), of the logarithms of the coefficients (the last of log T with Gauss–Markov noise).
    octaves : the fit, octave by octave.
    converged : whether the maximum was found.
    alternative : a term that describes the record as well in place of a determined one, (determined, other).
    """

    estimates: tuple[TermEstimate, ...]
    correlation_time: float
    correlation_time_sd: float
    determined: tuple[NoiseTerm, ...]
    correlation: np.ndarray
    octaves: tuple[Octave, ...]
    converged: bool
    alternative: tuple[tuple[NoiseTerm, NoiseTerm], ...]

    def of(self, term: NoiseTerm) -> TermEstimate:
        """Return the estimate of a term."""
        return next(estimate for estimate in self.estimates if estimate.term is term)


def estimate_terms(likelihood: NoiseLikelihood) -> NoiseEstimate:
    """Return the noise terms that a record determines, and limits for the others."""
    best, evidence = _selected(likelihood)
    full = _with_all(likelihood, best)
    found = [_of_term(likelihood, full, term, best, evidence) for term in _BASIC]
    markov = NoiseTerm.MARKOV in best.terms
    found.append(
        _of_term(likelihood, full, NoiseTerm.MARKOV, best, evidence)
        if markov
        else _unknown(NoiseTerm.MARKOV, math.nan, 0.0)
    )
    found.append(_ramp(likelihood, full, found[_BASIC.index(NoiseTerm.RANDOM_WALK)]))
    covariance = np.linalg.pinv(likelihood.information(best))
    sd = np.sqrt(np.diag(covariance))
    return NoiseEstimate(
        tuple(found),
        full.correlation_time,
        full.correlation_time * float(sd[-1]) if markov else math.nan,
        best.terms,
        covariance / np.outer(sd, sd),
        tuple(_octaves(likelihood, full)),
        full.converged,
        tuple(_alternatives(likelihood, best)),
    )


def _with_all(likelihood: NoiseLikelihood, best: Maximum) -> Maximum:
    """Return the maximum with all basic terms, and Gauss–Markov noise if that is determined."""
    terms = (*_BASIC, *((NoiseTerm.MARKOV,) if NoiseTerm.MARKOV in best.terms else ()))
    near = likelihood.start(terms, best.correlation_time) - _FAINT
    for place, term in enumerate(terms):
        if term in best.terms:
            near[place] = best.parameters[best.terms.index(term)]
    near[len(terms) :] = best.parameters[len(best.terms) :]
    return _highest(likelihood, terms, best.correlation_time, near)


def _highest(likelihood: NoiseLikelihood, terms: tuple[NoiseTerm, ...], time: float, *near: np.ndarray) -> Maximum:
    """Return the highest of the maxima found from several starts: a slow term can take the place of another."""
    far = likelihood.start(terms, time)
    starts = [*near, far]
    for place, term in enumerate(terms):
        if term is not NoiseTerm.WHITE:
            starts.append(far.copy())
            starts[-1][place] -= _FAINT
    return max((likelihood.maximise(terms, start) for start in starts), key=lambda found: found.log_likelihood)


def _selected(likelihood: NoiseLikelihood) -> tuple[Maximum, dict[NoiseTerm, float]]:
    """Return the maximum of the selected model, and the evidence for each of its terms."""
    basic, evidence = _pruned(likelihood, _highest(likelihood, _BASIC, math.nan))
    scanned = _with_markov(likelihood, _BASIC)
    full, full_evidence = _pruned(likelihood, scanned)
    gain = 2 * (full.log_likelihood - basic.log_likelihood)
    extra = len(full.terms) - len(basic.terms)
    # Fewer basic terms may do with the process in; each that it replaces counts for its own threshold.
    if NoiseTerm.MARKOV in full.terms and gain > _LEAST_EVIDENCE_MARKOV + _LEAST_EVIDENCE * (extra - 1):
        return full, full_evidence
    return basic, evidence


def _pruned(likelihood: NoiseLikelihood, maximum: Maximum) -> tuple[Maximum, dict[NoiseTerm, float]]:
    """Leave out terms, the least significant first, until all that are left are significant."""
    while True:
        without = {term: _without(likelihood, maximum, term) for term in maximum.terms if len(maximum.terms) > 1}
        evidence = {term: 2 * (maximum.log_likelihood - other.log_likelihood) for term, other in without.items()}
        lacking = {term: found - _needed(term) for term, found in evidence.items()}
        weakest = min(lacking, key=lambda term: lacking[term], default=None)
        if weakest is None or lacking[weakest] > 0:
            return maximum, evidence
        maximum = without[weakest]


def _needed(term: NoiseTerm) -> float:
    return _LEAST_EVIDENCE_MARKOV if term is NoiseTerm.MARKOV else _LEAST_EVIDENCE


def _without(likelihood: NoiseLikelihood, maximum: Maximum, term: NoiseTerm) -> Maximum:
    """Return the maximum without a term."""
    terms = tuple(other for other in maximum.terms if other is not term)
    kept = [place for place, other in enumerate(maximum.terms) if other is not term]
    if NoiseTerm.MARKOV in terms:
        kept.append(len(maximum.terms))
    near = maximum.parameters[kept]
    time = math.exp(near[-1]) if NoiseTerm.MARKOV in terms else math.nan
    return _highest(likelihood, terms, time, near)


def _with_markov(likelihood: NoiseLikelihood, terms: tuple[NoiseTerm, ...]) -> Maximum:
    """Return the maximum with a Gauss–Markov process, from starts all over the correlation times of the record."""
    whole = (*terms, NoiseTerm.MARKOV)
    times = np.geomspace(2 * likelihood.interval, likelihood.span / 5, _SCAN)
    found = [_at_time(likelihood, whole, float(time)) for time in times]
    start = max(found, key=lambda maximum: maximum.log_likelihood)
    return likelihood.maximise(whole, start.parameters)


def _at_time(likelihood: NoiseLikelihood, terms: tuple[NoiseTerm, ...], time: float) -> Maximum:
    start = likelihood.start(terms, time)
    return likelihood.maximise(terms, start, fixed=len(start) - 1)


def _of_term(
    likelihood: NoiseLikelihood, full: Maximum, term: NoiseTerm, best: Maximum, evidence: dict[NoiseTerm, float]
) -> TermEstimate:
    place = full.terms.index(term)
    if term not in best.terms:
        return _unknown(term, _upper_limit(likelihood, full, place), 0.0, math.exp(full.parameters[place] / 2))
    value = math.exp(full.parameters[place] / 2)
    log_sd = 1 / math.sqrt(max(float(likelihood.information(full)[place, place]), 1.0))
    level = full.log_likelihood - float(scipy.stats.chi2.isf(1 - PROBABILITY, 1)) / 2
    low, high = (_bracketed(likelihood, full, place, side, level, 2 * log_sd) for side in (-1, 1))
    sd = (high - low) / (2 * float(scipy.stats.norm.isf((1 - PROBABILITY) / 2)))
    return TermEstimate(term, value, sd, low, high, math.nan, evidence.get(term, math.inf), value)


def _unknown(term: NoiseTerm, limit: float, evidence: float, maximum: float = 0.0) -> TermEstimate:
    return TermEstimate(term, math.nan, math.nan, math.nan, math.nan, limit, evidence, maximum)


def _upper_limit(likelihood: NoiseLikelihood, full: Maximum, place: int) -> float:
    """Return the coefficient above the estimate at which the profile has fallen by the one-sided quantile."""
    level = full.log_likelihood - float(scipy.stats.chi2.isf(2 * (1 - PROBABILITY), 1)) / 2
    # At zero the likelihood is flat: the search starts where the term begins to matter.
    information = float(likelihood.information(full)[place, place])
    start = full.parameters.copy()
    start[place] += max(0.0, -0.5 * math.log(max(information, 1e-300)))
    here = likelihood.maximise(full.terms, start, fixed=place)
    if here.log_likelihood < level:
        return _root(likelihood, here, place, -_WIDEST, 0.0, level)
    return _bracketed(likelihood, here, place, 1, level, 0.3)


def _bracketed(likelihood: NoiseLikelihood, centre: Maximum, place: int, side: int, level: float, step: float) -> float:
    """Return the coefficient on one side at which the profile of the log likelihood falls to a level; 0 for never."""
    inner, outer = 0.0, side * step
    while _profile(likelihood, centre, place, outer) > level:
        inner, outer = outer, 2 * outer
        if abs(outer) > _WIDEST:
            return 0.0 if side < 0 else math.inf
    return _root(likelihood, centre, place, min(inner, outer), max(inner, outer), level)


def _root(likelihood: NoiseLikelihood, centre: Maximum, place: int, low: float, high: float, level: float) -> float:
    shift = _zero(lambda by: _profile(likelihood, centre, place, by) - level, low, high, 1e-4)
    return math.exp((centre.parameters[place] + shift) / 2)


def _zero(function: Callable[[float], float], low: float, high: float, tolerance: float) -> float:
    return float(scipy.optimize.brentq(function, low, high, xtol=tolerance))  # type: ignore[arg-type]


def _profile(likelihood: NoiseLikelihood, centre: Maximum, place: int, shift: float) -> float:
    """Return the log likelihood with one parameter shifted and the others at their best."""
    start = centre.parameters.copy()
    start[place] += shift
    return likelihood.maximise(centre.terms, start, fixed=place).log_likelihood


def _ramp(likelihood: NoiseLikelihood, full: Maximum, walk: TermEstimate) -> TermEstimate:
    """Return the ramp, averaged over the random walks that the record allows, which wander off likewise.

    One or two coefficients tell a weak random walk from a ramp, so its best value says little: the posterior of the
    ramp is a mixture of normal distributions, over a flat prior of K ≥ 0.
    """
    place = full.terms.index(NoiseTerm.RANDOM_WALK)
    low, high = (0.5 * walk.low, 1.5 * walk.high) if walk.determined else (0.0, 2.0 * walk.limit)
    weights, slopes = [], []
    for k in low + (high - low) * (np.arange(_WALKS) + 0.5) / _WALKS:
        start = full.parameters.copy()
        start[place] = 2 * math.log(k)
        given = likelihood.maximise(full.terms, start, fixed=place)
        weights.append(given.log_likelihood)
        slopes.append(likelihood.ramp(given))
    weight = np.exp(np.array(weights) - max(weights))
    weight /= weight.sum()
    mean, sd = np.array(slopes).T

    def below(slope: float) -> float:
        return float(weight @ scipy.stats.norm.cdf((slope - mean) / sd))

    reach = 20 * float(sd.max())
    ends = (float(mean.min()) - reach, float(mean.max()) + reach)
    tail = (1 - PROBABILITY) / 2
    first = _zero(lambda slope: below(slope) - tail, *ends, 1e-3 * float(sd.min()))
    last = _zero(lambda slope: below(slope) - (1 - tail), *ends, 1e-3 * float(sd.min()))
    middle = float(weight @ mean)
    spread = math.sqrt(float(weight @ (sd**2 + (mean - middle) ** 2)))
    chance = 2 * min(below(0.0), 1 - below(0.0))
    evidence = float(scipy.stats.chi2.isf(max(chance, 1e-300), 1))
    if chance > _CHANCE_RAMP:
        return _unknown(NoiseTerm.RAMP, max(-first, last), evidence)
    return TermEstimate(NoiseTerm.RAMP, middle, spread, first, last, math.nan, evidence, middle)


def _octaves(likelihood: NoiseLikelihood, best: Maximum) -> list[Octave]:
    squares, found = likelihood.power / likelihood.variance(best), []
    for at in likelihood.octaves():
        total, count = float(squares[at].sum()), round(float(likelihood.count[at].sum()))
        chance = 2 * min(float(scipy.stats.chi2.cdf(total, count)), float(scipy.stats.chi2.sf(total, count)))
        frequency = likelihood.frequency[at]
        found.append(Octave(float(frequency.min()), float(frequency.max()), total, count, min(chance, 1.0)))
    return found


def _alternatives(likelihood: NoiseLikelihood, best: Maximum) -> list[tuple[NoiseTerm, NoiseTerm]]:
    """Return pairs of a determined term and one that describes the record as well in its place."""
    found = []
    for term in (NoiseTerm.FLICKER, NoiseTerm.RANDOM_WALK, NoiseTerm.QUANTISATION):
        for other in (NoiseTerm.FLICKER, NoiseTerm.RANDOM_WALK, NoiseTerm.QUANTISATION):
            if term in best.terms and other not in best.terms:
                terms = tuple(other if kept is term else kept for kept in best.terms)
                swapped = likelihood.maximise(terms, likelihood.start(terms, best.correlation_time))
                if 2 * (best.log_likelihood - swapped.log_likelihood) < _LEAST_EVIDENCE:
                    found.append((term, other))
    return found
