"""Effects that an archive shows: candidates with evidence added over units, grouped, and with the units behind them.

The candidate with the strongest evidence is taken, with those that cannot be told from it, projected out of every unit,
and the others are judged again, while one is significant.  The same is asked of the units of one table, one mounting or
one year: a fault of equipment shows in many units at once, and in no others.
"""

import math
from collections.abc import Iterator, Sequence
from typing import Literal

import numpy as np
import polars as pl

from imubayes.batch.pooled_evidence import (
    Law,
    PooledEvidence,
    PooledScores,
    adjusted,
    all_evidence,
    pooled_evidence,
    pooled_scores,
)
from imubayes.batch.population import discoveries
from imubayes.criticism import thresholds
from imubayes.errors import input_error
from imubayes.json_record import Record, finite

RATE, EQUIPMENT_RATE, UNIT_RATE = 0.04, 0.01, 0.05
"""False discovery rates of effects over all units, of effects of one table, mounting or year, and of the units named.
The first two together are the 5 % of a single diagnosis (convention)."""
LEAST_UNITS = 5
"""Fewest units of one table, mounting or year that are judged together (convention)."""
DISTINCT_SD = 3.0
"""Standard deviations by which units of one table, mounting or year must differ from the others (convention)."""
MOST_EFFECTS, MOST_RANKED, MOST_UNITS = 4, 12, 8

Equipment = Literal["table", "mounting", "year"]


class PooledCoefficient(Record):
    """The common coefficient over all units; None where it is not determined."""

    name: str
    value: float | None
    sd: float | None
    unit: str


class UnitEvidence(Record):
    """What one unit says of an effect.

    Attributes
    ----------
    chi2, p : of the effect with a size of its own, and its p-value.
    contribution : drop of the unit's χ² by the common coefficient; negative speaks against it.
    """

    unit: str
    digest: str
    chi2: float
    p: float
    contribution: float


class PooledCandidate(Record):
    """Evidence for a candidate over units.

    Attributes
    ----------
    scope : kind of channel, or the channel, mounting or table, that it acts on.
    law : ``common``: the same coefficient in all units; ``own``: of its own size in each; ``some``: in few units.
    units : in how many it was tested.
    log10_p, log10_adjusted : logarithms of its p-value, and of that adjusted for the false discovery rate.
    chi2, dof : of the common coefficient.
    chi2_own, dof_own : of a coefficient for each unit.
    """

    effect: str
    shape: str
    scope: str
    law: Law
    units: int
    log10_p: float
    log10_adjusted: float
    chi2: float
    dof: int
    chi2_own: float
    dof_own: int


class EquipmentEvidence(Record):
    """An effect that the units of one table, mounting or year have, and the others do not have alike.

    Attributes
    ----------
    kind, name : such as ``table``, ``T2``.
    effects : the best, then those that its units cannot tell from it.
    inside, outside : number of units.
    log10_p, log10_adjusted : inside; the second adjusted for the false discovery rate.
    log10_p_outside : of the same effect in the other units.
    """

    kind: Equipment
    name: str
    effects: tuple[str, ...]
    scope: str
    inside: int
    outside: int
    log10_p: float
    log10_adjusted: float
    log10_p_outside: float


class PooledFinding(Record):
    """An effect that the archive shows.

    Attributes
    ----------
    effects : the leader, then those that the archive cannot tell from it.
    evidence : of the leader.
    coefficients : common over the units.
    log10_p_differing : of no difference between the coefficients of the units.
    named : units that show it by themselves, at a false discovery rate of 5 %, the clearest first.
    supporting, opposing : units that say most for it and against it.
    every_unit : every unit that was tested, in the order of the archive.
    """

    effects: tuple[str, ...]
    evidence: PooledCandidate
    coefficients: tuple[PooledCoefficient, ...]
    log10_p_differing: float
    named: tuple[str, ...]
    supporting: tuple[UnitEvidence, ...]
    opposing: tuple[UnitEvidence, ...]
    every_unit: tuple[UnitEvidence, ...]


class PooledDiscovery(Record):
    """What an archive shows that its model lacks.

    Attributes
    ----------
    units, campaigns : with scores.
    candidates : number of candidates judged.
    findings : in order of evidence; empty where nothing is significant.
    equipment : what units of one table, mounting or year have in common; the clearest of each.
    ranking : candidates over all units, the most significant first.
    """

    format: Literal[1] = 1
    model: str
    units: int
    campaigns: int
    candidates: int
    rate: float = RATE
    findings: tuple[PooledFinding, ...]
    equipment: tuple[EquipmentEvidence, ...]
    ranking: tuple[PooledCandidate, ...]

    @property
    def alarm(self) -> bool:
        """Whether an effect is claimed, of all units or of some equipment."""
        return bool(self.findings or self.equipment)


def pooled_discovery(scores: pl.DataFrame, units: pl.DataFrame) -> PooledDiscovery:
    """Return what the scores of a batch show together.

    Parameters
    ----------
    scores : schema `imubayes.batch.unit_scores.SCORES`.
    units : as `imubayes.batch.posterior_table.read_units` returns them.

    Raises
    ------
    InputError
        where no campaign has scores.
    """
    if scores.is_empty():
        raise input_error(
            "no campaign of the batch has scores of candidate effects",
            "results folder",
            "a batch with campaigns that were fitted",
            "run imubayes batch again: it lists why campaigns have no estimates",
        )
    together = pooled_scores(scores)
    ranked = all_evidence(together)
    return PooledDiscovery(
        model=units["model"][0] if units.height else "",
        units=len(set(together.units)),
        campaigns=len(together.digests),
        candidates=len(ranked),
        findings=tuple(_findings(together)),
        equipment=tuple(_equipment(together, units)),
        ranking=tuple(_candidates(ranked)[:MOST_RANKED]),
    )


def _candidates(ranked: Sequence[PooledEvidence]) -> list[PooledCandidate]:
    log_adjusted = adjusted(np.array([each.log_p_any for each in ranked]))
    return [
        PooledCandidate(
            effect=each.key.effect,
            shape=each.key.shape,
            scope=each.key.scope,
            law=each.law,
            units=len(each.tested),
            log10_p=each.log_p_any / math.log(10),
            log10_adjusted=float(value) / math.log(10),
            chi2=each.common_chi2,
            dof=each.common_dof,
            chi2_own=float(each.chi2.sum()),
            dof_own=int(each.dof.sum()),
        )
        for each, value in zip(ranked, log_adjusted, strict=True)
    ]


def _findings(scores: PooledScores) -> Iterator[PooledFinding]:
    """Yield the significant effects, each judged once those before it were projected out."""
    at = scores
    for _ in range(MOST_EFFECTS):
        ranked = all_evidence(at)
        candidates = _candidates(ranked)
        if not candidates or candidates[0].log10_adjusted > math.log10(RATE):
            return
        leader = ranked[0]
        yield _finding(at, leader, candidates[0], ranked)
        for key in [k for k in at.candidates if (k.effect, k.scope) == (leader.key.effect, leader.key.scope)]:
            at = at.without(key)


def _finding(
    at: PooledScores, leader: PooledEvidence, evidence: PooledCandidate, ranked: Sequence[PooledEvidence]
) -> PooledFinding:
    every = [
        UnitEvidence(
            unit=at.units[place], digest=at.digests[place], chi2=float(chi2), p=float(p), contribution=float(change)
        )
        for place, chi2, p, change in zip(leader.tested, leader.chi2, leader.unit_p, leader.contribution, strict=True)
    ]
    carriers = _carriers(leader)
    order = np.argsort(-leader.chi2)
    return PooledFinding(
        effects=(leader.key.effect, *_equivalent(at, leader, ranked)),
        evidence=evidence,
        coefficients=tuple(_coefficients(at, leader)),
        log10_p_differing=leader.log_p_differing / math.log(10),
        named=tuple(dict.fromkeys(every[place].unit for place in order if carriers[place])),
        supporting=tuple(every[place] for place in _supporting(leader, carriers)),
        opposing=tuple(every[place] for place in _opposing(leader, carriers)),
        every_unit=tuple(every),
    )


def _carriers(leader: PooledEvidence) -> np.ndarray:
    """Return which campaigns show the effect by themselves, (n,) bool."""
    return discoveries(leader.unit_p, UNIT_RATE, dependent=False)


def _supporting(leader: PooledEvidence, carriers: np.ndarray) -> np.ndarray:
    """Return the places of the units that say most for the effect, the clearest first."""
    strength = leader.contribution if leader.law == "common" else np.where(carriers, leader.chi2, 0.0)
    order = np.argsort(-strength)[:MOST_UNITS]
    return order[strength[order] > 0]


def _opposing(leader: PooledEvidence, carriers: np.ndarray) -> np.ndarray:
    """Return the places of the units that say most against the effect, the clearest first.

    Against a common coefficient: those it makes worse.  Against sizes of their own: those whose χ² is less than a
    quarter of what the mean square of the carriers' coefficients would give, by two standard deviations.
    """
    if leader.law == "common":
        order = np.argsort(leader.contribution)[:MOST_UNITS]
        return order[leader.contribution[order] < 0]
    if not carriers.any():
        return np.zeros(0, dtype=int)
    short = 0.5 * np.sqrt(leader.expected(carriers)) - np.sqrt(leader.chi2) - 2
    order = np.argsort(-short)[:MOST_UNITS]
    return order[(short[order] > 0) & ~carriers[order]]


def _equivalent(at: PooledScores, leader: PooledEvidence, ranked: Sequence[PooledEvidence]) -> list[str]:
    """Return the effects after which nothing of the leader is left, the most similar first."""
    left: dict[str, float] = {}
    for other in ranked:
        name = other.key.effect
        if name == leader.key.effect or other.log_p_any > math.log(RATE):
            continue
        rest = pooled_evidence(at.without(other.key), leader.key)
        excess, dof = _excess(rest, leader)
        if excess < max(thresholds.DISTINGUISHABLE_CHI2, 2 * math.sqrt(2 * dof)):
            left[name] = min(excess, left.get(name, math.inf))
    return sorted(left, key=lambda name: left[name])


def _excess(rest: PooledEvidence, leader: PooledEvidence) -> tuple[float, int]:
    """Return the χ² of what is left of the leader beyond its degrees of freedom, by the leader's law, and these."""
    if leader.law == "common":
        return rest.common_chi2 - rest.common_dof, rest.common_dof
    members = _carriers(leader) if leader.law == "some" else np.ones(len(rest.chi2), dtype=bool)
    dof = int(rest.dof[members].sum())
    return float(rest.chi2[members].sum()) - dof, dof


def _coefficients(at: PooledScores, leader: PooledEvidence) -> Iterator[PooledCoefficient]:
    places = at.candidates[leader.key]
    deviation = np.sqrt(np.maximum(np.diag(leader.covariance), 0.0))
    for place, value, sd in zip(places, leader.coefficient, deviation, strict=True):
        known = finite(sd) if sd > 0 else None
        yield PooledCoefficient(
            name=at.names[place], value=float(value) if known else None, sd=known, unit=at.measures[place]
        )


def _equipment(scores: PooledScores, units: pl.DataFrame) -> Iterator[EquipmentEvidence]:
    """Yield the strongest effect of each table, mounting and year that is stronger in its units than in the others."""
    groups = list(_groups(scores, units))
    inside = [scores.chosen(np.flatnonzero(members)) for *_, members in groups]
    ranked = [all_evidence(each) for each in inside]
    # Every candidate of every group was looked at; the leader of each may be reported.
    log_adjusted = adjusted(np.array([each.log_p_any for listed in ranked for each in listed]))
    first = np.cumsum([0, *(len(listed) for listed in ranked)])
    for place, (kind, name, members) in enumerate(groups):
        if not ranked[place] or log_adjusted[first[place]] > math.log(EQUIPMENT_RATE):
            continue
        leader = ranked[place][0]
        others = pooled_evidence(scores.chosen(np.flatnonzero(~members)), leader.key)
        if not _stronger(leader, others):
            continue
        yield EquipmentEvidence(
            kind=kind,
            name=name,
            effects=(leader.key.effect, *_equivalent(inside[place], leader, ranked[place])),
            scope=leader.key.scope,
            inside=int(members.sum()),
            outside=int(np.sum(~members)),
            log10_p=leader.log_p_any / math.log(10),
            log10_adjusted=float(log_adjusted[first[place]]) / math.log(10),
            log10_p_outside=others.log_p_any / math.log(10),
        )


def _stronger(inside: PooledEvidence, outside: PooledEvidence) -> bool:
    """Return whether units have more of an effect than the others, by three standard deviations and by a factor of two.

    A common coefficient is compared with that of the others, sizes of their own by the mean χ² of a unit beyond its
    degrees of freedom.
    """
    if not len(outside.tested):
        return True
    if inside.law == "common":
        apart = inside.coefficient - outside.coefficient
        distance = float(apart @ np.linalg.pinv(inside.covariance + outside.covariance, hermitian=True) @ apart)
        information = inside.information.sum(axis=0)
        own, theirs = (float(each.coefficient @ information @ each.coefficient) for each in (inside, outside))
        return distance > DISTINCT_SD**2 + inside.common_dof - 1 and own > 4 * theirs
    own, theirs = inside.chi2 - inside.dof, outside.chi2 - outside.dof
    error = math.sqrt(float(np.var(own)) / len(own) + float(np.var(theirs)) / len(theirs))
    return bool(own.mean() - theirs.mean() > DISTINCT_SD * error and own.mean() > 2 * theirs.mean())


def _groups(scores: PooledScores, units: pl.DataFrame) -> Iterator[tuple[Equipment, str, np.ndarray]]:
    """Yield each table, mounting and year with enough units inside and outside, and which campaigns have it, (n,)."""
    of_digest = {row["digest"]: row for row in units.select("digest", "tables", "mountings", "year").to_dicts()}
    rows = [of_digest[digest] for digest in scores.digests]
    owned: list[tuple[Equipment, list[set[str]]]] = [
        ("table", [set(row["tables"] or ()) for row in rows]),
        ("mounting", [set(row["mountings"] or ()) for row in rows]),
        ("year", [{str(row["year"])} if row["year"] is not None else set() for row in rows]),
    ]
    for kind, own in owned:
        for name in sorted(set().union(*own)):
            members = np.array([name in each for each in own])
            if members.sum() >= LEAST_UNITS and np.sum(~members) >= LEAST_UNITS:
                yield kind, name, members
