"""Scores of all units of a batch as arrays, and what is left of them once an effect is projected out."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import polars as pl

from imubayes.batch.posterior_table import unpacked
from imubayes.batch.unit_scores import CandidateKey
from imubayes.criticism.evidence.effect_variants import EffectVariant

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
    candidates: Mapping[CandidateKey, EffectVariant]

    def places_of(self, key: CandidateKey) -> np.ndarray:
        """Return the places of all coefficients that the effect of a candidate has there, of every shape and part."""
        own = self.candidates[key]
        found = [each for each in self.candidates.values() if each.effect == own.effect]
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
    scores : schema `imubayes.batch.unit_scores.SCORES`.
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


def _candidates(rows: pl.DataFrame, place: Mapping[str, int]) -> dict[CandidateKey, EffectVariant]:
    found: dict[CandidateKey, tuple[set[str], set[int], float, Sequence[float]]] = {}
    columns = ("effect", "shape", "scope", "part", "owners", "coefficients", "log_odds", "widths")
    for effect, shape, scope, part, owners, names, log_odds, widths in rows.select(columns).iter_rows():
        key = CandidateKey(effect, shape, scope, part)
        owned, places, *_ = found.setdefault(key, (set(), set(), log_odds, widths))
        owned.update(owners)
        places.update(place[name] for name in names)
    return {
        key: EffectVariant(key.effect, 0, tuple(sorted(owners)), tuple(sorted(places)), log_odds, tuple(widths))
        for key, (owners, places, log_odds, widths) in found.items()
    }
