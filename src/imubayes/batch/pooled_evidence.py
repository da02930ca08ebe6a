"""Evidence for a candidate effect over many units, for three ways in which units may have it.

* ``common``: a coefficient of the same size and sign in all units.  U = ΣUᵢ and I = ΣIᵢ, and UᵀI⁻¹U is χ².
* ``own``: each unit has a size of its own.  Σ UᵢᵀIᵢ⁻¹Uᵢ is χ² with the sum of the degrees of freedom.
* ``some``: few units have it.  The p-values of the units are combined by the method of Simes (Biometrika 73, 1986).

The smallest of the three p-values, times three, is the p-value of the candidate.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
import polars as pl

from imubayes.batch.posterior_table import unpacked
from imubayes.tail_probabilities import chi2_log_survival, chi2_survival, normal_log_survival

Law = Literal["common", "own", "some"]
LAWS: tuple[Law, ...] = ("common", "own", "some")
# Eigenvalues of an information matrix, in units of what each coefficient had at first, below which a direction is not
# determined, or was projected out.
_RANK = 1e-6


@dataclass(frozen=True)
class CandidateKey:
    """A candidate: effect, values of its shape parameters as text, and the channels tested together."""

    effect: str
    shape: str
    scope: str


@dataclass(frozen=True)
class PooledScores:
    """Scores and information of all units, on the union of their coefficients.

    Attributes
    ----------
    digests, units : n campaigns and their units.
    names : C coefficients; 0 in the score and information of a unit that lacks one.
    score, information : shapes (n, C) and (n, C, C), at the noise scale of each fit.
    size : shape (n, C), roots of the diagonal of the information at first; 0 where a unit lacks the coefficient.
    candidates : key → places of its coefficients, (K,).
    factor : key → calibration of its χ², (n,); NaN where a unit was not tested.
    signs, measures : of each coefficient, (C,): the only sign allowed, 0 for either, and its unit of measure.
    """

    digests: tuple[str, ...]
    units: tuple[str, ...]
    names: tuple[str, ...]
    score: np.ndarray
    information: np.ndarray
    size: np.ndarray
    candidates: Mapping[CandidateKey, np.ndarray]
    factor: Mapping[CandidateKey, np.ndarray]
    signs: np.ndarray
    measures: tuple[str, ...]

    def chosen(self, members: np.ndarray) -> "PooledScores":
        """Return the scores of some campaigns, by their places."""
        return replace(
            self,
            digests=tuple(self.digests[place] for place in members),
            units=tuple(self.units[place] for place in members),
            score=self.score[members],
            information=self.information[members],
            size=self.size[members],
            factor={key: values[members] for key, values in self.factor.items()},
        )

    def without(self, key: CandidateKey) -> "PooledScores":
        """Return the scores once a candidate, of its own size in each unit, is projected out."""
        places = self.candidates[key]
        cross = self.information[:, :, places]
        gain = cross @ inverses(self.information[:, places[:, None], places], self.size[:, places])
        score = self.score - np.einsum("nck,nk->nc", gain, self.score[:, places])
        return replace(self, score=score, information=self.information - gain @ np.swapaxes(cross, 1, 2))


def pooled_scores(scores: pl.DataFrame) -> PooledScores:
    """Return the scores of a batch as arrays.

    Parameters
    ----------
    scores : schema `imubayes.batch.unit_scores.SCORES`.
    """
    whole = scores.filter(pl.col("effect").is_null()).sort("digest")
    tests = scores.filter(pl.col("effect").is_not_null())
    names = tuple(sorted({name for row in whole["coefficients"] for name in row}))
    place = {name: index for index, name in enumerate(names)}
    row_of = {digest: index for index, digest in enumerate(whole["digest"])}
    score, information = np.zeros((len(row_of), len(names))), np.zeros((len(row_of), len(names), len(names)))
    for row, (own, u, triangle) in enumerate(whole.select("coefficients", "score", "information").iter_rows()):
        at = np.array([place[name] for name in own], dtype=int)
        score[row, at] = u
        information[row, at[:, None], at] = unpacked(triangle)
    signs, measures = np.zeros(len(names), dtype=int), [""] * len(names)
    members: dict[CandidateKey, set[str]] = {}
    factor: dict[CandidateKey, np.ndarray] = {}
    columns = ("digest", "effect", "shape", "scope", "coefficients", "measures", "signs", "factor")
    for digest, effect, shape, scope, own, units, sign, each in tests.select(columns).iter_rows():
        key = CandidateKey(effect, shape, scope)
        members.setdefault(key, set()).update(own)
        factor.setdefault(key, np.full(len(row_of), np.nan))[row_of[digest]] = each
        for name, unit, only in zip(own, units, sign, strict=True):
            signs[place[name]], measures[place[name]] = only, unit
    places = {key: np.array(sorted(place[name] for name in own)) for key, own in members.items()}
    return PooledScores(
        digests=tuple(whole["digest"]),
        units=tuple(whole["unit"]),
        names=names,
        score=score,
        information=information,
        size=np.sqrt(np.maximum(np.einsum("nkk->nk", information), 0.0)),
        candidates=places,
        factor=factor,
        signs=signs,
        measures=tuple(measures),
    )


def inverses(information: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Return the pseudo-inverses of information matrices, without directions that are not determined.

    Parameters
    ----------
    information : shape (n, K, K).
    size : shape (n, K), the roots of what each coefficient's information was before anything was projected out.
    """
    scale = np.where(size > 0, 1 / np.where(size > 0, size, 1.0), 0.0)
    values, axes = np.linalg.eigh(information * scale[:, :, None] * scale[:, None, :])
    kept = values > _RANK
    inverse = (axes * np.where(kept, 1 / np.where(kept, values, 1.0), 0.0)[:, None, :]) @ np.swapaxes(axes, 1, 2)
    return inverse * scale[:, :, None] * scale[:, None, :]


@dataclass(frozen=True)
class PooledEvidence:
    """Evidence for one candidate over n units.

    Attributes
    ----------
    tested : places of the campaigns in which it was tested, n of them.
    chi2, dof : shape (n,), calibrated χ² and degrees of freedom of each unit.
    own, information : shapes (n, K) and (n, K, K), coefficient of each unit by itself, and calibrated information.
    coefficient, covariance : shapes (K,) and (K, K), the common coefficient.
    contribution : shape (n,), change of each unit's χ² by the common coefficient; negative speaks against it.
    log_p : by law, logarithm of the p-value.
    common_chi2, common_dof : of the common coefficient.
    """

    key: CandidateKey
    tested: np.ndarray
    chi2: np.ndarray
    dof: np.ndarray
    own: np.ndarray
    information: np.ndarray
    coefficient: np.ndarray
    covariance: np.ndarray
    contribution: np.ndarray
    log_p: Mapping[Law, float]
    common_chi2: float
    common_dof: int

    @property
    def law(self) -> Law:
        """The way of having it with the strongest evidence."""
        return min(LAWS, key=lambda law: self.log_p[law])

    @property
    def log_p_any(self) -> float:
        """Logarithm of the p-value of the candidate, its three laws counted."""
        return min(0.0, self.log_p[self.law] + np.log(len(LAWS)))

    @cached_property
    def unit_p(self) -> np.ndarray:
        """p-value of each unit by itself, (n,)."""
        return np.where(self.dof > 0, chi2_survival(self.chi2, np.maximum(self.dof, 1)), 1.0)

    def expected(self, carriers: np.ndarray) -> np.ndarray:
        """Return the χ² that each unit would have with the coefficients of the carriers, averaged, (n,)."""
        own = self.own[carriers]
        return np.einsum("ck,nkl,cl->n", own, self.information, own) / max(len(own), 1)

    @property
    def log_p_differing(self) -> float:
        """Logarithm of the p-value of no difference between the coefficients of the units."""
        freedom = int(self.dof.sum()) - self.common_dof
        apart = max(float(self.chi2.sum()) - self.common_chi2, 0.0)
        return float(chi2_log_survival(apart, freedom)) if freedom else 0.0


def pooled_evidence(scores: PooledScores, key: CandidateKey) -> PooledEvidence:
    """Return the evidence for a candidate over all units in which it was tested."""
    places, factor = scores.candidates[key], scores.factor[key]
    tested = np.flatnonzero(np.isfinite(factor))
    # The calibration multiplies χ²: score and information are those of a unit whose noise scale is known.
    scale = factor[tested]
    u = scores.score[tested][:, places] * scale[:, None]
    v = scores.information[np.ix_(tested, places, places)] * scale[:, None, None]
    size = scores.size[tested][:, places] * np.sqrt(scale)[:, None]
    inverse = inverses(v, size)
    chi2 = np.einsum("nk,nkl,nl->n", u, inverse, u)
    dof = np.rint(np.einsum("nkl,nlk->n", inverse, v)).astype(int)
    total, whole = u.sum(axis=0), v.sum(axis=0)
    covariance = inverses(whole[None], np.sqrt(np.sum(size**2, axis=0))[None])[0]
    coefficient = covariance @ total
    common_dof = int(np.rint(np.trace(covariance @ whole)))
    log_p: dict[Law, float] = {
        "common": _log_p_common(total, covariance, common_dof, scores.signs[places]),
        "own": float(chi2_log_survival(chi2.sum(), dof.sum())) if dof.sum() else 0.0,
        "some": _simes(chi2_log_survival(chi2[dof > 0], dof[dof > 0])),
    }
    contribution = 2 * u @ coefficient - np.einsum("k,nkl,l->n", coefficient, v, coefficient)
    return PooledEvidence(
        key=key,
        tested=tested,
        chi2=chi2,
        dof=dof,
        own=np.einsum("nkl,nl->nk", inverse, u),
        information=v,
        coefficient=coefficient,
        covariance=covariance,
        contribution=contribution,
        log_p=log_p,
        common_chi2=float(total @ coefficient),
        common_dof=common_dof,
    )


def _log_p_common(total: np.ndarray, covariance: np.ndarray, dof: int, signs: np.ndarray) -> float:
    """Return the log p-value of the common coefficient.

    Coefficients that may have one sign only are tested one by one, with that sign, and the best of them counts
    (Bonferroni).
    """
    if not dof:
        return 0.0
    if not signs.any():
        return float(chi2_log_survival(total @ covariance @ total, dof))
    value, variance = covariance @ total, np.diag(covariance)
    known = variance > 0
    deviation = value[known] / np.sqrt(variance[known])
    only = signs[known]
    each = np.where(
        only == 0, normal_log_survival(np.abs(deviation)) + np.log(2), normal_log_survival(only * deviation)
    )
    return float(min(0.0, each.min() + np.log(len(each)))) if len(each) else 0.0


def _simes(log_p: np.ndarray) -> float:
    """Return the log p-value of several by the method of Simes."""
    if not len(log_p):
        return 0.0
    ordered = np.sort(log_p)
    return float(min(0.0, np.min(ordered + np.log(len(ordered)) - np.log(np.arange(1, len(ordered) + 1)))))


def all_evidence(scores: PooledScores, least: int = 1) -> list[PooledEvidence]:
    """Return the evidence for every candidate tested in at least so many units, the strongest first."""
    keys: Sequence[CandidateKey] = [
        key for key, factor in scores.factor.items() if np.sum(np.isfinite(factor)) >= least
    ]
    return sorted((pooled_evidence(scores, key) for key in keys), key=lambda each: each.log_p_any)


def adjusted(log_p: np.ndarray) -> np.ndarray:
    """Return logarithms of p-values, (m,), adjusted for a false discovery rate under any dependence.

    Benjamini and Yekutieli (Annals of Statistics 29, 2001): candidates are tested on the same residuals, and may be
    correlated in either sign, for which the procedure of Benjamini and Hochberg has no guarantee.
    """
    count = len(log_p)
    if not count:
        return log_p
    order = np.argsort(log_p)
    ranks = np.arange(1, count + 1)
    raised = log_p[order] + np.log(count * np.sum(1 / ranks) / ranks)
    result = np.empty(count)
    result[order] = np.minimum(np.minimum.accumulate(raised[::-1])[::-1], 0.0)
    return result
