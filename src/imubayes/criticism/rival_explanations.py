"""Pairs of effects that explain together what another effect seems to explain.

A stepwise search names the single effect that explains most.  Where two effects are missing at once, a third one may
imitate their sum better than either does alone: with the north of a station and the scale factor of a gyro in error, an
error of its level.  Pairs are therefore compared with what the search found, by the marginal likelihood

    log B = ½ uᵀ(V + 1)⁻¹u − ½ log det(1 + V)

with u = Xᵀr and V = XᵀX of the responses X to sizes as large as they get in practice, past what the model absorbs, and
the residual r, both at the noise that remains.  It weighs sizes beyond the typical range, and each further coefficient.

One of a pair may act on some of the leader's channels alone: an effect on one channel beside another one on all of them
may pass for the first on all.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, groupby, product

import numpy as np
from scipy import special

from imubayes.criticism import thresholds
from imubayes.criticism.score_test import Candidate, response_of
from imubayes.criticism.search_input import Screening


@dataclass(frozen=True)
class RivalEffects:
    """Effects that explain the residual as what was found does, and the logarithm of their odds against that."""

    members: tuple[Candidate, ...]
    log_odds: float


@dataclass(frozen=True)
class _Terms:
    """Candidates as terms of a linear model.

    Attributes
    ----------
    candidates : N of them.
    places : the places of the coefficients of each among all.
    precision, score : shapes (C, C) and (C,), V and u of all coefficients.
    sign : shape (C,), the only sign that a coefficient may have; 0 for either.
    """

    candidates: tuple[Candidate, ...]
    places: tuple[tuple[int, ...], ...]
    precision: np.ndarray
    score: np.ndarray
    sign: np.ndarray

    @staticmethod
    def of(at: Screening, candidates: Sequence[Candidate], variance: np.ndarray) -> "_Terms":
        """Return the terms at the noise variance of each stratum."""
        root = 1 / np.sqrt(at.projection.strata.at_rows(variance))
        columns = [_columns(at, each) for each in candidates]
        ends = np.cumsum([each.shape[1] for each in columns]).tolist()
        places = tuple(tuple(range(end - each.shape[1], end)) for end, each in zip(ends, columns, strict=True))
        stacked = root[:, None] * np.concatenate(columns, axis=1)
        sign = np.array([coefficient.sign for each in candidates for coefficient in each.coefficients])
        return _Terms(tuple(candidates), places, stacked.T @ stacked, stacked.T @ (root * at.projection.residual), sign)

    def log_odds(self, together: Sequence[tuple[int, ...]]) -> np.ndarray:
        """Return the log odds of terms together against none of them, (n,); every set has as many coefficients a term.

        Every further effect that is missing as well is less likely beforehand.
        """
        sets = np.array([[place for term in each for place in self.places[term]] for each in together])
        counts = [len(self.places[term]) for term in together[0]]
        widths = [np.repeat(each, counts) for each in product(thresholds.RIVAL_WIDTHS, repeat=len(counts))]
        evidence = np.asarray(special.logsumexp([self._log_evidence(sets, each) for each in widths], axis=0))
        return evidence - math.log(len(widths)) - (len(counts) - 1) * thresholds.DECISIVE_LOG_ODDS

    def _log_evidence(self, sets: np.ndarray, width: np.ndarray) -> np.ndarray:
        """Return log B, (n,), of coefficients with a normal prior, (n, c) and (c,); half-normal where they have a sign.

        A coefficient that its sign holds at 0 explains nothing; of others the prior has twice the density.
        """
        sign, used = self.sign[sets], np.ones(sets.shape, dtype=bool)
        whole = np.outer(width, width) * self.precision[sets[:, :, None], sets[:, None, :]]
        while True:
            score = np.where(used, width * self.score[sets], 0.0)
            precision = np.where(used[:, :, None] & used[:, None, :], whole, 0.0) + np.eye(len(width))
            value = np.linalg.solve(precision, score[..., None])[..., 0]
            held = used & (sign * value < 0)
            if not held.any():
                break
            used &= ~held
        _, log_determinant = np.linalg.slogdet(precision)
        signed = np.sum(used & (sign != 0), axis=1)
        return 0.5 * (np.sum(score * value, axis=1) - log_determinant) + math.log(2) * signed


def rival_pairs(at: Screening, leaders: Sequence[Candidate], variance: np.ndarray) -> list[RivalEffects]:
    """Return the pairs without the first leader that the data do not exclude beside the leaders, the likeliest first.

    Parameters
    ----------
    at : the screening in which the leaders were found, none of them projected out.
    leaders : what a search found, the first of them in doubt.
    variance : noise variance of each stratum beside them.
    """
    first = leaders[0]
    concerned = [first, *(each for each in leaders[1:] if acts_with(at, each, first) or _on_some(each, first))]
    rivals = _best_shapes(at, first)
    terms = _Terms.of(at, [*concerned, *rivals], variance)
    found = float(terms.log_odds([tuple(range(len(concerned)))])[0])
    places = range(len(concerned), len(terms.candidates))
    alone = {place: float(terms.log_odds([(place,)])[0]) for place in places}
    pairs = [pair for pair in combinations(places, 2) if _are_rivals(terms, first, pair)]
    least = found - 2 * thresholds.DECISIVE_LOG_ODDS
    likely = [
        RivalEffects((terms.candidates[a], terms.candidates[b]), value - found)
        for (a, b), value in _pairs(terms, pairs)
        # A second effect that adds nothing to the first one makes no explanation of its own.
        if value > max(least, alone[a], alone[b])
    ]
    return sorted(likely, key=lambda each: -each.log_odds)


def _are_rivals(terms: _Terms, first: Candidate, pair: tuple[int, int]) -> bool:
    """Tell whether a pair is of two effects, of which one at least acts wherever the leader does."""
    a, b = (terms.candidates[place] for place in pair)
    return a.effect != b.effect and not (_on_some(a, first) and _on_some(b, first))


def _pairs(terms: _Terms, pairs: Sequence[tuple[int, int]]) -> Iterator[tuple[tuple[int, int], float]]:
    """Yield pairs of terms with their log odds against none."""

    def size(pair: tuple[int, int]) -> tuple[int, int]:
        return len(terms.places[pair[0]]), len(terms.places[pair[1]])

    for _, alike in groupby(sorted(pairs, key=size), key=size):
        together = list(alike)
        yield from zip(together, terms.log_odds(together).tolist(), strict=True)


def _best_shapes(at: Screening, leader: Candidate) -> list[Candidate]:
    """Return each other effect that acts where the leader does, and each one on some of its channels.

    Each at the shape that explains most.
    """
    best: dict[tuple[str, tuple[str, ...]], Candidate] = {}
    for each in at.candidates:
        known = best.get((each.effect, each.owners))
        other = acts_with(at, each, leader) and each.effect != leader.effect
        if (other or _on_some(each, leader)) and (known is None or each.delta_chi2 > known.delta_chi2):
            best[each.effect, each.owners] = each
    return list(best.values())


def acts_with(at: Screening, candidate: Candidate, leader: Candidate) -> bool:
    """Tell whether a candidate acts on the leader's channels, or one of the two on what moves all channels."""
    channels = {channel.name for channel in at.projection.fitted.model.campaign.channels}
    shared = candidate.owners == leader.owners
    return shared or not channels & set(candidate.owners) or not channels & set(leader.owners)


def _on_some(candidate: Candidate, leader: Candidate) -> bool:
    """Tell whether a candidate acts on some of the leader's channels and on no others."""
    return set(candidate.owners) < set(leader.owners)


def _columns(at: Screening, candidate: Candidate) -> np.ndarray:
    """Return the projected responses to the largest typical size of each coefficient, (R, C)."""
    found, chosen = response_of(at.prepared, candidate)
    return found.projected[:, chosen] * [coefficient.typical[1] for coefficient in candidate.coefficients]
