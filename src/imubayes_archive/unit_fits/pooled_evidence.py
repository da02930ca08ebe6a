"""Pooled scores of a batch, and the evidence for a candidate effect under three laws by which units may have it.

* ``common``: a coefficient of the same size and sign in all units.
* ``own``: each unit has a size of its own, normal about a common mean, which may be zero.
* ``some``: a share of the units have it, each with a size of its own.

The likelihood of the coefficients of a unit is exp(uᵀb − bᵀVb/2).  With sizes normal about a mean m with a spread s, u
→ (1 + s²V)⁻¹u and V → (1 + s²V)⁻¹V are those of m, and add up over units; logarithms of the evidence add up as well.
Widths of m, spreads and shares are summed over grids.  The scores of all units are held as arrays, from which an effect
can be projected out.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
import polars as pl
from scipy import special

from imubayes.criticism.effect_scores import CandidateKey, CoefficientScores, ScoredEffect, shown_widths
from imubayes_archive.unit_fits.posterior_table import unpacked

_RANK = 1e-8
"""Information, in units of what each coefficient had at first, below which it is rounding."""


@dataclass(frozen=True)
class PooledScores:
    """Scores and information of n campaigns, on the union of their C coefficients.

    Attributes
    ----------
    digests, units : of the campaigns.
    names, measures, signs : of the coefficients: names, units, and the only sign allowed, 0 for either, (C,).
    sizes : shape (C,), largest typical sizes, in their units: what scores count in.
    score, information : shapes (n, C) and (n, C, C); 0 where a campaign lacks a coefficient.
    at_first : shape (n, C), the diagonal of the information before anything was projected out.
    candidates : with places among the coefficients.
    """

    digests: tuple[str, ...]
    units: tuple[str, ...]
    names: tuple[str, ...]
    measures: tuple[str, ...]
    signs: np.ndarray
    sizes: np.ndarray
    score: np.ndarray
    information: np.ndarray
    at_first: np.ndarray
    candidates: Mapping[CandidateKey, ScoredEffect]

    def places_of(self, key: CandidateKey) -> np.ndarray:
        """Return the places of all coefficients that the effect of a candidate has there, of every shape and part."""
        own = self.candidates[key]
        found = [each for each in self.candidates.values() if each.key.effect == own.key.effect]
        return np.unique([k for each in found if set(each.owners) <= set(own.owners) for k in each.places])

    def chosen(self, members: np.ndarray) -> "PooledScores":
        """Return the scores of some campaigns, by their places."""
        return replace(
            self,
            digests=tuple(self.digests[place] for place in members),
            units=tuple(self.units[place] for place in members),
            score=self.score[members],
            information=self.information[members],
            at_first=self.at_first[members],
        )

    def told(self, key: CandidateKey) -> np.ndarray:
        """Return which campaigns have any information of a candidate, (n,) bool."""
        places = list(self.candidates[key].places)
        return np.asarray(self.information[:, places, places].sum(axis=1) > 0)

    def without(self, places: np.ndarray, members: np.ndarray) -> "PooledScores":
        """Return the scores once coefficients, of their own size in each of some campaigns, are projected out.

        Parameters
        ----------
        places : shape (K,).
        members : shape (n,) bool, in which campaigns.
        """
        found = replace(self, score=self.score.copy(), information=self.information.copy())
        for row in np.flatnonzero(members):
            score, information, first = found.score[row], found.information[row], self.at_first[row]
            gain = information[:, places] @ _inverse(information[np.ix_(places, places)], first[places])
            score -= gain @ score[places]
            information -= gain @ information[places]
            lost = np.diag(information) <= _RANK * first
            lost[places] = True
            score[lost], information[lost], information[:, lost] = 0.0, 0.0, 0.0
        return found


def _inverse(information: np.ndarray, first: np.ndarray) -> np.ndarray:
    """Return the pseudo-inverse of an information matrix, (K, K), without directions that are not determined.

    Parameters
    ----------
    first : shape (K,), the information of each coefficient before anything was projected out.
    """
    unit = np.where(first > 0, 1 / np.sqrt(np.where(first > 0, first, 1.0)), 0.0)
    values, axes = np.linalg.eigh(information * np.outer(unit, unit))
    axes = unit[:, None] * axes[:, values > _RANK]
    return (axes / values[values > _RANK]) @ axes.T


def pooled_scores(scores: pl.DataFrame) -> PooledScores:
    """Return the scores of a batch as arrays.

    A candidate has the prior of the first campaign that has it, and a coefficient the largest of its typical sizes.

    Parameters
    ----------
    scores : schema `imubayes_archive.unit_fits.unit_scores.SCORES`.
    """
    whole = scores.filter(pl.col("effect").is_null()).sort("digest")
    names = tuple(sorted({name for row in whole["coefficients"] for name in row}))
    place = {name: index for index, name in enumerate(names)}
    own = [np.array([place[name] for name in row], dtype=int) for row in whole["coefficients"]]
    signs, sizes, measures = np.zeros(len(names), dtype=int), np.zeros(len(names)), [""] * len(names)
    for at, units, size, sign in zip(own, whole["measures"], whole["sizes"], whole["signs"], strict=True):
        signs[at], sizes[at] = np.array(sign, dtype=int), np.maximum(sizes[at], np.array(size))
        for k, unit in zip(at, units, strict=True):
            measures[k] = unit
    score, information = np.zeros((len(own), len(names))), np.zeros((len(own), len(names), len(names)))
    for row, (at, size, u, v) in enumerate(zip(own, whole["sizes"], whole["score"], whole["information"], strict=True)):
        unit = sizes[at] / np.array(size)
        score[row, at] = np.array(u) * unit
        information[row, at[:, None], at] = unpacked(v) * np.outer(unit, unit)
    return PooledScores(
        digests=tuple(whole["digest"]),
        units=tuple(whole["unit"]),
        names=names,
        measures=tuple(measures),
        signs=signs,
        sizes=sizes,
        score=score,
        information=information,
        at_first=np.einsum("nkk->nk", information).copy(),
        candidates=_candidates(scores.filter(pl.col("effect").is_not_null()), place),
    )


def _candidates(rows: pl.DataFrame, place: Mapping[str, int]) -> dict[CandidateKey, ScoredEffect]:
    found: dict[CandidateKey, tuple[set[str], set[int], float, Sequence[float]]] = {}
    columns = ("effect", "shape", "scope", "part", "owners", "coefficients", "log_odds", "widths")
    for effect, shape, scope, part, owners, names, log_odds, widths in rows.select(columns).iter_rows():
        key = CandidateKey(effect, shape, scope, part)
        owned, places, *_ = found.setdefault(key, (set(), set(), log_odds, widths))
        owned.update(owners)
        places.update(place[name] for name in names)
    return {
        key: ScoredEffect(key, tuple(sorted(owners)), tuple(sorted(places)), log_odds, tuple(widths))
        for key, (owners, places, log_odds, widths) in found.items()
    }


Law = Literal["common", "own", "some"]
LAWS: tuple[Law, ...] = ("common", "own", "some")
"""Equally likely."""
_ABOUT_ZERO = 0.5
"""Prior probability that sizes of units' own have the mean zero."""


@dataclass(frozen=True)
class UnitGains:
    """What each of n units says of K coefficients, with a spread of 0 and then of each of Q widths; S = Q + 1.

    Attributes
    ----------
    widths : shape (Q,), in largest typical sizes.
    gain : shape (S, n), log evidence of sizes about zero.
    of_mean : S scores of their mean.
    """

    widths: np.ndarray
    gain: np.ndarray
    of_mean: tuple[CoefficientScores, ...]

    @property
    def told(self) -> np.ndarray:
        """Which units have any information, (n,) bool."""
        return np.einsum("nkk->n", self.of_mean[0].information) > 0


def unit_gains(scores: PooledScores, candidate: ScoredEffect) -> UnitGains:
    """Return what each unit says of a candidate."""
    places, widths = np.array(candidate.places), np.array(candidate.widths)
    known = CoefficientScores(
        scores.score[:, places], scores.information[:, places[:, None], places], scores.signs[places]
    )
    gains = [np.zeros(len(scores.score)), *(known.log_gain(width) for width in candidate.widths)]
    return UnitGains(widths, np.stack(gains), tuple(known.of_mean(spread) for spread in (0.0, *candidate.widths)))


def law_tables(gains: UnitGains, members: np.ndarray) -> dict[Law, np.ndarray]:
    """Return the log evidence of each law, its priors included, to be summed over all axes but the first.

    Parameters
    ----------
    members : shape (G, n) bool, of groups of units.

    Returns
    -------
    ``common``: (G, Q) over widths; ``own``: (G, Q, R) over spreads, then over a mean of zero and its widths; ``some``:
    (G, Q, P) over widths and the shares of `shares_of`.  −∞ where the units would not show it.
    """
    inside = members.astype(float)
    about_zero = (inside @ gains.gain.T)[:, 1:, None]
    about = _gains_of_means(gains, inside)
    own = [about_zero + math.log(_ABOUT_ZERO), about_zero + about[:, 1:] + math.log(1 - _ABOUT_ZERO)]
    own[1] -= math.log(own[1].shape[2])
    shares = shares_of(members.shape[1])
    mixed = np.logaddexp(np.log1p(-shares), np.log(shares) + gains.gain[1:, :, None])
    number = np.maximum(inside @ gains.told, 1.0)
    possible = shares * number[:, None] >= 1
    few = np.where(possible, -np.log(np.maximum(possible.sum(axis=1, keepdims=True), 1)), -np.inf)
    reach = gains.of_mean[0].summed(inside).reach
    # What one unit shows grows to that of n: a mean by √n, the variance of sizes as well, and one unit is enough alone.
    shown = [_log_shown(gains.widths, reach / number**power) for power in (0.0, 0.25, 0.5)]
    return {
        "common": about[:, 0] + shown[0],
        "own": np.concatenate(own, axis=2) + shown[1][:, :, None],
        "some": np.einsum("gn,qnp->gqp", inside, mixed) + few[:, None, :] + shown[2][:, :, None],
    }


def shares_of(count: int) -> np.ndarray:
    """Return the shares of units that may have an effect, from a half down to one of them, (P,)."""
    return 0.5 ** np.arange(1, max(1, int(math.log2(max(count, 1)))) + 1)


def _gains_of_means(gains: UnitGains, inside: np.ndarray) -> np.ndarray:
    """Return the log evidence of a mean of each width, (G, S, Q), over that of zero.

    Of one sign only the mean of equal sizes counts: sizes of their own are about zero, half of their normal law.
    """
    found = np.full((len(inside), len(gains.gain), len(gains.widths)), -np.inf)
    for spread, known in enumerate(gains.of_mean[: 1 if np.any(gains.of_mean[0].sign) else None]):
        together = known.summed(inside)
        for q, width in enumerate(gains.widths):
            found[:, spread, q] = together.log_gain(width)
    return found


def _log_shown(widths: np.ndarray, reach: np.ndarray) -> np.ndarray:
    """Return the log prior of widths that units show, (G, Q); −∞ of the others: no hypotheses, as in one diagnosis."""
    shown = shown_widths(widths, reach)
    return np.where(shown, -np.log(np.maximum(shown.sum(axis=1, keepdims=True), 1)), -np.inf)


@dataclass(frozen=True, eq=False)
class PooledEvidence:
    """Evidence for one candidate in one group of units.

    Attributes
    ----------
    group : its place.
    units : how many campaigns of the group have any information.
    log_law : shape (3,), logarithm of prior and evidence of each law, over those of nothing missing.
    """

    key: CandidateKey
    group: int
    units: int
    log_law: np.ndarray

    @cached_property
    def log_odds(self) -> float:
        """Natural logarithm of the odds against nothing missing."""
        return float(np.logaddexp.reduce(self.log_law))

    @property
    def shares(self) -> dict[Law, float]:
        """The probability of each law, given the effect."""
        return dict(zip(LAWS, np.exp(self.log_law - self.log_odds).tolist(), strict=True))

    @property
    def law(self) -> Law:
        """The most probable law."""
        return LAWS[int(np.argmax(self.log_law))]


def log_bayes(scores: PooledScores, key: CandidateKey, members: np.ndarray) -> np.ndarray:
    """Return the log Bayes factor of each law in each group, members (G, n) bool, against nothing missing, (G, 3)."""
    tables = law_tables(unit_gains(scores, scores.candidates[key]), members)
    return np.stack([np.logaddexp.reduce(tables[law].reshape(len(members), -1), axis=1) for law in LAWS], axis=1)


def all_evidence(
    scores: PooledScores, members: np.ndarray, log_share: np.ndarray, least: int = 1
) -> list[PooledEvidence]:
    """Return the evidence for every candidate in every group, the strongest first.

    Parameters
    ----------
    members : shape (G, n) bool; the first group are all units.
    log_share : shape (G,), logarithms of the shares of the prior of an effect.
    least : fewest campaigns with information inside any other group, and outside of it.
    """
    found = list[PooledEvidence]()
    for key, candidate in scores.candidates.items():
        told = scores.told(key)
        inside = members.astype(int) @ told
        enough = (inside >= least) & (told.sum() - inside >= least)
        enough[0] = inside[0] > 0
        chosen = np.flatnonzero(enough)
        if not len(chosen):
            continue
        log_law = log_bayes(scores, key, members[chosen]) + candidate.log_odds - math.log(len(LAWS))
        for group, own in zip(chosen.tolist(), log_law + log_share[chosen, None], strict=True):
            if np.isfinite(own).any():
                found.append(PooledEvidence(key, group, int(inside[group]), own))
    return sorted(found, key=lambda each: -each.log_odds)


def probability_of_any(ranked: Sequence[PooledEvidence]) -> float:
    """Return the probability that something is missing: candidates exclude one another."""
    return float(special.expit(special.logsumexp([each.log_odds for each in ranked]))) if ranked else 0.0


@dataclass(frozen=True)
class EffectInUnits:
    """An effect by its most probable law, in the n units of a group.

    Attributes
    ----------
    gain : shape (n,), natural logarithm of the evidence of each unit for it.
    probability : shape (n,), that the unit has it: as a few units have it, else at even odds before its data.
    value, sd : shape (K,), mean over the units that have it, in the unit of each coefficient.
    spread : shape (K,), standard deviation over units; 0 where it is common.
    """

    gain: np.ndarray
    probability: np.ndarray
    value: np.ndarray
    sd: np.ndarray
    spread: np.ndarray


def effect_in_units(scores: PooledScores, key: CandidateKey, law: Law) -> EffectInUnits:
    """Return what an effect is in units, all of `scores`, by a law."""
    gains = unit_gains(scores, scores.candidates[key])
    table = law_tables(gains, np.ones((1, len(scores.units)), dtype=bool))[law][0]
    best = np.unravel_index(int(np.argmax(table)), table.shape)
    spread = 0 if law == "common" else 1 + int(best[0])
    known, gain = gains.of_mean[spread], gains.gain[spread]
    u, v = known.score, known.information
    share = np.ones(len(u))
    if law == "some":
        weight, shares = np.exp(table - special.logsumexp(table)), shares_of(len(u))
        each = special.expit(gains.gain[1:, :, None] + special.logit(shares))
        share = np.einsum("qp,qnp->n", weight, each)
    covariance = np.linalg.inv(np.einsum("n,nkl->kl", share, v) + np.eye(u.shape[1]) / gains.widths[-1] ** 2)
    mean = covariance @ (share @ u)
    if law == "common" or (law == "own" and best[1] > 0):
        gain = gain + u @ mean - 0.5 * np.einsum("k,nkl,l->n", mean, v, mean)
    size = scores.sizes[list(scores.candidates[key].places)]
    width = 0.0 if law == "common" else gains.widths[spread - 1]
    return EffectInUnits(
        gain=gain,
        probability=share if law == "some" else special.expit(gain),
        value=mean * size,
        sd=np.sqrt(np.diag(covariance)) * size,
        spread=width * size,
    )
