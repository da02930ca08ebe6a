"""The noise terms of a record: which it determines, estimates with intervals, and upper limits for the others.

The terms that a record determines are found by the likelihood-ratio test of each term beside all others
(`term_evidence`). A term is tested against the best model without it in which every other term is free, present or not:
what the others can take over is no evidence for it.  A search that drops terms one by one would not do.  If flicker
noise and random walk are hard to distinguish, neither is needed beside the other; whichever goes first makes the other
significant, and the wrong one as often as chance has it.  Such terms stay undetermined, and are named as undecided if
the record needs one of them.

Gauss–Markov noise is a term only if the record asks for it.  It can follow flicker noise over two decades of
frequency, so that few records exclude it: it is named as an alternative, not counted against a term.

A term that is not determined is not set to zero: estimates, intervals and limits are those of the likelihood with all
terms in it, or an interval would leave out what the undetermined ones could take over.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import scipy  # loads its parts when they are first used

from imubayes.foundations.tail_probabilities import LEAST_P, normal_survival
from imubayes_recordings.noise_analysis.likelihood import VANISHED, Maximum, NoiseLikelihood
from imubayes_recordings.noise_analysis.noise_terms import NoiseTerm

BASIC = (NoiseTerm.QUANTISATION, NoiseTerm.WHITE, NoiseTerm.FLICKER, NoiseTerm.RANDOM_WALK)
# A coefficient on its bound of 0 has −2 Δ log L ~ ½χ²₀ + ½χ²₁ (Self and Liang 1987): chance 1 % beyond 5.41.  Beside
# other coefficients on their bounds the chance is up to 2 %: 0.7 to 1.9 % in simulated records of each kind.
LEAST_EVIDENCE = 5.41
# Of n coefficients on their bounds together, with binomial weights of χ²₀ … χ²_n: chance 1 %.
_LEAST_EVIDENCE_JOINT = {1: LEAST_EVIDENCE, 2: 7.29, 3: 8.75, 4: 10.02}
# Of two coefficients, χ²₂: chance 1 %; 0.2 % in 405 simulated records, as other terms follow most of the chance.
_LEAST_EVIDENCE_MARKOV = 9.21
_SLOW = (NoiseTerm.FLICKER, NoiseTerm.RANDOM_WALK)
_SCAN = 14
_LONGEST_TIME = 1 / 5  # of a correlation time over the record; a longer one is a random walk
_FROM_BOUND = 1.1  # times the shortest correlation time
_WELL_WITHIN = 1 / 20  # of a correlation time over the record: some twenty independent values
_POLISHED = 2  # of the maxima at fixed correlation times
_FAINT = 8.0  # in log θ: where a term starts that another may replace


@dataclass(frozen=True)
class TermEvidence:
    """What the record says for each term.

    Attributes
    ----------
    full : the maximum with all basic terms, and Gauss–Markov noise if that is determined.
    evidence : −2 Δ log L of leaving a term of `full` out.
    determined : the terms whose evidence chance does not explain.
    undecided : terms that are not determined, of which the record needs at least one.
    alternatives : a determined term, and one that describes the record as well in its place.
    """

    full: Maximum
    evidence: dict[NoiseTerm, float]
    determined: tuple[NoiseTerm, ...]
    undecided: tuple[NoiseTerm, ...]
    alternatives: tuple[tuple[NoiseTerm, NoiseTerm], ...]


def term_evidence(likelihood: NoiseLikelihood) -> TermEvidence:
    """Return the evidence for each term beside all others."""
    basic = highest(likelihood, BASIC)
    with_markov = highest(likelihood, (*BASIC, NoiseTerm.MARKOV))
    gain = 2 * (with_markov.log_likelihood - basic.log_likelihood)
    markov = gain > _LEAST_EVIDENCE_MARKOV and within_record(likelihood, with_markov)
    full = with_markov if markov else basic
    evidence = {term: _lost(likelihood, full, {term}) for term in BASIC}
    determined = [term for term in BASIC if evidence[term] > LEAST_EVIDENCE]
    if markov:
        evidence[NoiseTerm.MARKOV] = gain
        determined.append(NoiseTerm.MARKOV)
    alternatives = () if markov else tuple(_alternatives(likelihood, full, determined))
    undecided = _undecided(likelihood, full, determined)
    return TermEvidence(full, evidence, tuple(determined), undecided, alternatives)


def within_record(likelihood: NoiseLikelihood, found: Maximum) -> bool:
    """Whether a correlation time is that of a process: at its bounds it is a filter, or a random walk."""
    shortest = _FROM_BOUND * likelihood.shortest_time
    return shortest < found.correlation_time < _LONGEST_TIME * likelihood.span


def highest(likelihood: NoiseLikelihood, terms: tuple[NoiseTerm, ...]) -> Maximum:
    """Return the highest maximum of a model: from several starts, and correlation times all over the record."""
    if NoiseTerm.MARKOV in terms:
        times = np.geomspace(likelihood.shortest_time, _LONGEST_TIME * likelihood.span, _SCAN)
        scanned = [_at_time(likelihood, terms, float(time)) for time in times]
        scanned.sort(key=lambda maximum: maximum.log_likelihood, reverse=True)
        starts = [maximum.parameters for maximum in scanned[:_POLISHED]]
    else:
        far = likelihood.start(terms)
        starts = [far]
        for place, term in enumerate(terms):
            if term in _SLOW:
                starts.append(far.copy())
                starts[-1][place] -= _FAINT
    return max((likelihood.maximise(terms, start) for start in starts), key=lambda found: found.log_likelihood)


def _at_time(likelihood: NoiseLikelihood, terms: tuple[NoiseTerm, ...], time: float) -> Maximum:
    start = likelihood.start(terms, time)
    return likelihood.maximise(terms, start, fixed=len(start) - 1)


def _lost(likelihood: NoiseLikelihood, full: Maximum, left_out: set[NoiseTerm]) -> float:
    """Return −2 Δ log L of leaving terms out; infinite if none would be left."""
    terms = tuple(term for term in full.terms if term not in left_out)
    if not terms:
        return math.inf
    return max(0.0, 2 * (full.log_likelihood - highest(likelihood, terms).log_likelihood))


def _undecided(likelihood: NoiseLikelihood, full: Maximum, determined: list[NoiseTerm]) -> tuple[NoiseTerm, ...]:
    """Return the undetermined terms that would do by themselves, all of them if none would, if one is needed."""
    open_terms = {term for term in full.terms if term not in determined}
    if not open_terms or _lost(likelihood, full, open_terms) <= _LEAST_EVIDENCE_JOINT[len(open_terms)]:
        return ()
    enough = {term for term in open_terms if _lost(likelihood, full, open_terms - {term}) <= LEAST_EVIDENCE}
    return tuple(term for term in BASIC if term in (enough or open_terms))


def _alternatives(
    likelihood: NoiseLikelihood, full: Maximum, determined: list[NoiseTerm]
) -> Iterator[tuple[NoiseTerm, NoiseTerm]]:
    """Yield the slow terms that Gauss–Markov noise could replace.

    Beside a random walk it is named only if the record prefers a correlation time well within it: a longer one is
    the random walk.
    """
    for term in (each for each in _SLOW if each in determined):
        other = highest(likelihood, (*(kept for kept in BASIC if kept is not term), NoiseTerm.MARKOV))
        within = term is NoiseTerm.FLICKER or other.correlation_time < _WELL_WITHIN * likelihood.span
        if within and 2 * (full.log_likelihood - other.log_likelihood) < LEAST_EVIDENCE:
            yield term, NoiseTerm.MARKOV


PROBABILITY = 0.95
_CHANCE_RAMP = 0.01
_WALKS = 24
_WIDEST = 60.0  # of an interval in log θ; a coefficient beyond is no coefficient


@dataclass(frozen=True)
class TermEstimate:
    """One coefficient.

    Attributes
    ----------
    term : the noise term.
    value : estimate; NaN where not determined.
    sd : standard uncertainty: the length of the interval over that of a normal distribution of unit sd.
    low, high : profile-likelihood interval of 95 %.
    limit : upper limit of 95 % if not determined; NaN otherwise.
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
class NoiseEstimate:
    """The noise terms of one record, in output units.

    Attributes
    ----------
    estimates : of every term.
    correlation_time, correlation_time_sd : T of the Gauss–Markov process, s; NaN where not determined.
    determined : the determined terms but the ramp, in the order of `correlation`.
    correlation : shape (P, P), of the logarithms of the coefficients (the last of log T with Gauss–Markov noise).
    full : the maximum with all terms.
    undecided : terms that are not determined, of which the record needs at least one.
    alternatives : a determined term, and one that describes the record as well in its place.
    """

    estimates: tuple[TermEstimate, ...]
    correlation_time: float
    correlation_time_sd: float
    determined: tuple[NoiseTerm, ...]
    correlation: np.ndarray
    full: Maximum
    undecided: tuple[NoiseTerm, ...]
    alternatives: tuple[tuple[NoiseTerm, NoiseTerm], ...]

    def of(self, term: NoiseTerm) -> TermEstimate:
        """Return the estimate of a term."""
        return next(estimate for estimate in self.estimates if estimate.term is term)


def estimate_terms(likelihood: NoiseLikelihood) -> NoiseEstimate:
    """Return the noise terms that a record determines, and limits for the others."""
    seen = term_evidence(likelihood)
    full = seen.full
    found = [_of_term(likelihood, term, seen) for term in BASIC]
    markov = NoiseTerm.MARKOV in seen.determined
    found.append(_of_term(likelihood, NoiseTerm.MARKOV, seen) if markov else _unknown(NoiseTerm.MARKOV, math.nan, 0.0))
    found.append(_ramp(likelihood, full, found[BASIC.index(NoiseTerm.RANDOM_WALK)]))
    sd, correlation = _normal_approximation(likelihood, seen)
    return NoiseEstimate(
        tuple(found),
        full.correlation_time,
        full.correlation_time * float(sd[-1]) if markov else math.nan,
        seen.determined,
        correlation,
        full,
        seen.undecided,
        seen.alternatives,
    )


def _normal_approximation(likelihood: NoiseLikelihood, seen: TermEvidence) -> tuple[np.ndarray, np.ndarray]:
    """Return standard uncertainties and correlation of the logarithms of the determined coefficients, and of log T.

    Undetermined terms are free to take their part, unless they have vanished: on its bound a term gives nothing away.
    """
    information = likelihood.information(seen.full)
    wanted = [seen.full.terms.index(term) for term in seen.determined]
    wanted += range(len(seen.full.terms), len(seen.full.parameters))
    free = [place for place in range(len(information)) if place in wanted or information[place, place] > VANISHED]
    chosen = [free.index(place) for place in wanted]
    covariance = np.linalg.pinv(information[np.ix_(free, free)])[np.ix_(chosen, chosen)]
    sd = np.sqrt(np.diag(covariance))
    return sd, covariance / np.outer(sd, sd)


def _of_term(likelihood: NoiseLikelihood, term: NoiseTerm, seen: TermEvidence) -> TermEstimate:
    full, evidence = seen.full, seen.evidence[term]
    place = full.terms.index(term)
    if term not in seen.determined:
        return _unknown(term, _upper_limit(likelihood, full, place), evidence, math.exp(full.parameters[place] / 2))
    value = math.exp(full.parameters[place] / 2)
    log_sd = 1 / math.sqrt(max(float(likelihood.information(full)[place, place]), 1.0))
    level = full.log_likelihood - float(scipy.stats.chi2.isf(1 - PROBABILITY, 1)) / 2
    low, high = (_bracketed(likelihood, full, place, side, level, 2 * log_sd) for side in (-1, 1))
    sd = (high - low) / (2 * float(scipy.stats.norm.isf((1 - PROBABILITY) / 2)))
    return TermEstimate(term, value, sd, low, high, math.nan, evidence, value)


def _unknown(term: NoiseTerm, limit: float, evidence: float, maximum: float = 0.0) -> TermEstimate:
    return TermEstimate(term, math.nan, math.nan, math.nan, math.nan, limit, evidence, maximum)


def _upper_limit(likelihood: NoiseLikelihood, full: Maximum, place: int) -> float:
    """Return the coefficient above the estimate at which the profile has fallen by the one-sided quantile."""
    level = full.log_likelihood - float(scipy.stats.chi2.isf(2 * (1 - PROBABILITY), 1)) / 2
    # At zero the likelihood is flat: the search starts if the term begins to matter.
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

    One or two coefficients distinguish a weak random walk from a ramp, so its best value says little: the posterior of
    the ramp is a mixture of normal distributions, over a flat prior of K ≥ 0.
    """
    if not likelihood.sees_ramp:
        return _unknown(NoiseTerm.RAMP, math.nan, 0.0)
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
        return float(weight @ normal_survival((mean - slope) / sd))

    reach = 20 * float(sd.max())
    ends = (float(mean.min()) - reach, float(mean.max()) + reach)
    tail = (1 - PROBABILITY) / 2
    first = _zero(lambda slope: below(slope) - tail, *ends, 1e-3 * float(sd.min()))
    last = _zero(lambda slope: below(slope) - (1 - tail), *ends, 1e-3 * float(sd.min()))
    middle = float(weight @ mean)
    spread = math.sqrt(float(weight @ (sd**2 + (mean - middle) ** 2)))
    chance = 2 * min(below(0.0), 1 - below(0.0))
    evidence = float(scipy.stats.chi2.isf(max(chance, LEAST_P), 1))
    if chance > _CHANCE_RAMP:
        return _unknown(NoiseTerm.RAMP, max(-first, last), evidence)
    return TermEstimate(NoiseTerm.RAMP, middle, spread, first, last, math.nan, evidence, middle)
