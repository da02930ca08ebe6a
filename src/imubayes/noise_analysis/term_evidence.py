"""Which noise terms a record determines: the likelihood-ratio test of each term beside all others.

A term is tested against the best model without it in which every other term is free, present or not: what the others
can take over is no evidence for it.  A search that drops terms one by one would not do.  Where flicker noise and random
walk are hard to tell apart, neither is needed beside the other; whichever goes first makes the other significant, and
the wrong one as often as chance has it.  Such terms stay undetermined, and are named as undecided where the record
needs one of them.

Gauss–Markov noise is a term only where the record asks for it.  It can follow flicker noise over two decades of
frequency, so that few records exclude it: it is named as an alternative, not counted against a term.
"""

import math
from dataclasses import dataclass

import numpy as np

from imubayes.noise_analysis.likelihood import Maximum, NoiseLikelihood
from imubayes.noise_analysis.noise_spectra import NoiseTerm

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
    alternatives = () if markov else _alternatives(likelihood, full, determined)
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
    """Return −2 Δ log L of leaving terms out; infinite where none would be left."""
    terms = tuple(term for term in full.terms if term not in left_out)
    if not terms:
        return math.inf
    return max(0.0, 2 * (full.log_likelihood - highest(likelihood, terms).log_likelihood))


def _undecided(likelihood: NoiseLikelihood, full: Maximum, determined: list[NoiseTerm]) -> tuple[NoiseTerm, ...]:
    """Return the undetermined terms that would do by themselves, all of them if none would, where one is needed."""
    open_terms = {term for term in full.terms if term not in determined}
    if not open_terms or _lost(likelihood, full, open_terms) <= _LEAST_EVIDENCE_JOINT[len(open_terms)]:
        return ()
    enough = {term for term in open_terms if _lost(likelihood, full, open_terms - {term}) <= LEAST_EVIDENCE}
    return tuple(term for term in BASIC if term in (enough or open_terms))


def _alternatives(
    likelihood: NoiseLikelihood, full: Maximum, determined: list[NoiseTerm]
) -> tuple[tuple[NoiseTerm, NoiseTerm], ...]:
    """Return the slow terms that Gauss–Markov noise could replace.

    Beside a random walk it is named only where the record prefers a correlation time well within it: a longer one is
    the random walk.
    """
    found = []
    for term in (each for each in _SLOW if each in determined):
        other = highest(likelihood, (*(kept for kept in BASIC if kept is not term), NoiseTerm.MARKOV))
        within = term is NoiseTerm.FLICKER or other.correlation_time < _WELL_WITHIN * likelihood.span
        if within and 2 * (full.log_likelihood - other.log_likelihood) < LEAST_EVIDENCE:
            found.append((term, NoiseTerm.MARKOV))
    return tuple(found)
