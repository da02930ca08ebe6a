"""Effects that the model lacks in all units of a batch or in some, found from all units together.

No unit shows them alone.  Every candidate is weighed over all units, and over the units of one table, mounting or year:
a fault of equipment shows in many units at once, and in no others.  The most probable is taken, projected out of its
units, and the others are weighed again, while something is missing beyond reasonable doubt.  What may stand in the
place of an effect is reported with its share, the other effects held.  The outcome is a typed record.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import polars as pl

from imubayes.criticism.explanation_records import EXPECTED, NAMED
from imubayes.foundations.errors import input_error
from imubayes.foundations.records import Record, finite
from imubayes_archive.unit_fits import pooled_evidence as pooled

Equipment = Literal["table", "mounting", "year"]


class PooledCoefficient(Record):
    """A coefficient, as its mean over the units that have it, and the spread over units; 0 if it is common."""

    name: str
    value: float
    sd: float
    spread: float
    unit: str


class UnitEvidence(Record):
    """What one unit says of an effect.

    Attributes
    ----------
    gain : natural logarithm of its evidence for the effect as its law has it; negative speaks against it.
    probability : that the unit has it: if few have it as they do, else at even odds before its data.
    """

    unit: str
    digest: str
    gain: float
    probability: float


class EquipmentGroup(Record):
    """Campaigns on one table or mounting, or of one year, such as ``table``, ``T2``, inside and outside of it.

    `log_bayes_outside`: natural logarithm of the evidence for the same effect in the others.
    """

    kind: Equipment
    name: str
    inside: int
    outside: int
    log_bayes_outside: float | None


class PooledCandidate(Record):
    """Evidence for a candidate over units.

    Attributes
    ----------
    scope : kind of channel, or the channel, mounting or table, that it acts on.
    part : its only parameter; empty for all.
    equipment : the units that have it, such as ``table T2``; empty for all.
    law : ``common``: the same coefficient in all units; ``own``: of its own size in each; ``some``: in few units.
    laws : the probability of each law.
    units : how many campaigns have any information.
    probability, log_odds : against all other candidates and nothing missing; natural logarithm against nothing.
    """

    effect: str
    shape: str
    scope: str
    part: str
    equipment: str
    law: pooled.Law
    laws: dict[pooled.Law, float]
    units: int
    probability: float
    log_odds: float


class PlaceShare(Record):
    """An effect that may stand in a place, in all units or those of some equipment, with its probability there."""

    effect: str
    scope: str
    equipment: str
    probability: float


class PooledFinding(Record):
    """An effect that the archive shows, the others held.

    Attributes
    ----------
    probability : that something is missing in this place.
    place : what it may be, the most probable first, until 95 % are reported.
    evidence : of the most probable.
    equipment : whose units have it; None for all.
    named : units that have it with a probability above 0.9, the clearest first.
    supporting, opposing : units that say most for it and against it.
    every_unit : every unit with information, in the order of the archive.
    """

    probability: float
    place: tuple[PlaceShare, ...]
    evidence: PooledCandidate
    equipment: EquipmentGroup | None
    coefficients: tuple[PooledCoefficient, ...]
    named: tuple[str, ...]
    supporting: tuple[UnitEvidence, ...]
    opposing: tuple[UnitEvidence, ...]
    every_unit: tuple[UnitEvidence, ...]

    @property
    def effects(self) -> tuple[str, ...]:
        """The names of what it may be, the most probable first."""
        return tuple(dict.fromkeys(each.effect for each in self.place))


class PooledDiscovery(Record):
    """What an archive shows that its model lacks.

    Attributes
    ----------
    units, campaigns : with scores.
    candidates : number of candidates weighed.
    expected : number of missing effects, before the data.
    nothing, nothing_else : probabilities that nothing is missing, and nothing beside the findings.
    findings : in the order in which they were found.
    ranking : candidates beside the findings, the most probable first.
    """

    format: Literal[2] = 2
    model: str
    units: int
    campaigns: int
    candidates: int
    expected: float = EXPECTED
    nothing: float
    nothing_else: float
    findings: tuple[PooledFinding, ...]
    ranking: tuple[PooledCandidate, ...]

    @property
    def alarm(self) -> bool:
        """Whether an effect is claimed, of all units or of some equipment."""
        return bool(self.findings)


LEAST_UNITS = 5
"""Fewest units of one table, mounting or year that are judged together, and fewest of the others (convention)."""
OF_EQUIPMENT = 0.3
"""Share of the prior of an effect for the units of one table, mounting or year alone, in equal parts: as for one
channel alone in a single diagnosis."""
_TOLD = 0.95
_LEAST_GAIN = 1.5
"""Natural logarithm of the odds that an effect needs by itself (calibrated on simulated campaigns)."""
_MOST_EFFECTS, _MOST_RANKED, _MOST_UNITS = 12, 12, 8


def pooled_discovery(scores: pl.DataFrame, units: pl.DataFrame) -> PooledDiscovery:
    """Return what the scores of a batch show together.

    Parameters
    ----------
    scores : schema `imubayes_archive.unit_fits.unit_scores.SCORES`.
    units : as `imubayes_archive.unit_fits.posterior_table.read_units` returns them.

    Raises
    ------
    InputError
        if no campaign has scores.
    """
    if scores.is_empty():
        raise input_error(
            "no campaign of the batch has scores of candidate effects",
            "results folder",
            "a batch with campaigns that were fitted",
            "run imubayes batch again: it lists why campaigns have no estimates",
        )
    together = pooled.pooled_scores(scores)
    search = _PooledSearch(together, list(_groups(together, units)))
    first = search.ranked(())
    findings, last = tuple(search.findings()), search.ranked(search.leaders)
    return PooledDiscovery(
        model=units["model"][0] if units.height else "",
        units=len(set(together.units)),
        campaigns=len(together.digests),
        candidates=len(together.candidates),
        nothing=1 - pooled.probability_of_any(first),
        nothing_else=1 - pooled.probability_of_any(last),
        findings=findings,
        ranking=tuple(search.candidate(each, last) for each in last[:_MOST_RANKED]),
    )


@dataclass(frozen=True)
class _Group:
    """Campaigns that may have an effect by themselves, (n,) bool; all of them have no name."""

    members: np.ndarray
    kind: Equipment = "table"
    name: str = ""

    @property
    def label(self) -> str:
        return f"{self.kind} {self.name}" if self.name else ""


class _PooledSearch:
    """A search for effects, best first."""

    def __init__(self, scores: pooled.PooledScores, equipment: Sequence[_Group]):
        self.scores = scores
        self.groups = [_Group(np.ones(len(scores.units), dtype=bool)), *equipment]
        self._members = np.array([each.members for each in self.groups])
        alone = OF_EQUIPMENT / max(len(equipment), 1)
        self._log_share = np.log([1 - OF_EQUIPMENT if equipment else 1.0, *[alone] * len(equipment)])
        self._known: dict[tuple[pooled.PooledEvidence, ...], list[pooled.PooledEvidence]] = {}
        self.leaders: tuple[pooled.PooledEvidence, ...] = ()

    def held(self, leaders: Sequence[pooled.PooledEvidence]) -> pooled.PooledScores:
        """Return the scores with effects projected out of their units."""
        found = self.scores
        for each in leaders:
            found = found.without(found.places_of(each.key), self.groups[each.group].members)
        return found

    def ranked(self, leaders: Sequence[pooled.PooledEvidence]) -> list[pooled.PooledEvidence]:
        """Return the evidence for every candidate beside some effects, the strongest first."""
        key = tuple(leaders)
        if key not in self._known:
            self._known[key] = pooled.all_evidence(self.held(leaders), self._members, self._log_share, LEAST_UNITS)
        return self._known[key]

    def findings(self) -> Iterator[PooledFinding]:
        """Yield the effects that are missing beyond reasonable doubt."""
        while len(self.leaders) < _MOST_EFFECTS and _is_named(ranked := self.ranked(self.leaders)):
            self.leaders = (*self.leaders, ranked[0])
        for each in self.leaders:
            others = [one for one in self.leaders if one is not each]
            if _is_named(ranked := self.ranked(others)):
                yield self._finding(self.held(others), ranked)
            else:
                self.leaders = tuple(others)

    def candidate(self, each: pooled.PooledEvidence, ranked: Sequence[pooled.PooledEvidence]) -> PooledCandidate:
        """Return the evidence for a candidate among those that it was ranked with, as a record."""
        whole = np.logaddexp.reduce([0.0, *(other.log_odds for other in ranked)])
        return PooledCandidate(
            **vars(each.key), equipment=self.groups[each.group].label, law=each.law, laws=each.shares,
            units=each.units, probability=math.exp(min(each.log_odds - whole, 0.0)), log_odds=each.log_odds,
        )  # fmt: skip

    def _finding(self, at: pooled.PooledScores, ranked: Sequence[pooled.PooledEvidence]) -> PooledFinding:
        leader, group = ranked[0], self.groups[ranked[0].group]
        places = list(at.candidates[leader.key].places)
        chosen = at.chosen(np.flatnonzero(group.members & at.told(leader.key)))
        effect = pooled.effect_in_units(chosen, leader.key, leader.law)
        every = [
            UnitEvidence(unit=unit, digest=digest, gain=gain, probability=min(p, 1.0))
            for unit, digest, gain, p in zip(
                chosen.units, chosen.digests, effect.gain.tolist(), effect.probability.tolist(), strict=True
            )
        ]
        order = sorted(every, key=lambda each: -each.gain)
        return PooledFinding(
            probability=pooled.probability_of_any(ranked),
            place=tuple(self._place(ranked)),
            evidence=self.candidate(leader, ranked),
            equipment=self._equipment(at, leader, group),
            coefficients=tuple(_coefficients(at, places, effect)),
            named=tuple(dict.fromkeys(each.unit for each in order if each.probability > NAMED)),
            supporting=tuple(each for each in order[:_MOST_UNITS] if each.gain > 0),
            opposing=tuple(each for each in order[: -_MOST_UNITS - 1 : -1] if each.gain < 0),
            every_unit=tuple(every),
        )

    def _place(self, ranked: Sequence[pooled.PooledEvidence]) -> Iterator[PlaceShare]:
        """Yield what may stand in the place of the leader, until 95 % are reported."""
        mass: dict[tuple[str, int], list[pooled.PooledEvidence]] = {}
        for each in ranked:
            mass.setdefault((each.key.effect, each.group), []).append(each)
        logs = {key: float(np.logaddexp.reduce([one.log_odds for one in own])) for key, own in mass.items()}
        whole, told = float(np.logaddexp.reduce(list(logs.values()))), 0.0
        for key in sorted(logs, key=lambda each: -logs[each]):
            if told >= _TOLD:
                return
            share = math.exp(min(logs[key] - whole, 0.0))
            told += share
            scope, label = mass[key][0].key.scope, self.groups[key[1]].label
            yield PlaceShare(effect=key[0], scope=scope, equipment=label, probability=share)

    def _equipment(
        self, at: pooled.PooledScores, leader: pooled.PooledEvidence, group: _Group
    ) -> EquipmentGroup | None:
        if not group.name:
            return None
        outside = float(
            np.logaddexp.reduce(pooled.log_bayes(at, leader.key, ~group.members[None]), axis=None)
        ) - math.log(3)
        inside = int(group.members.sum())
        return EquipmentGroup(
            kind=group.kind, name=group.name, inside=inside, outside=len(group.members) - inside,
            log_bayes_outside=finite(outside),
        )  # fmt: skip


def _is_named(ranked: Sequence[pooled.PooledEvidence]) -> bool:
    return pooled.probability_of_any(ranked) > NAMED and ranked[0].log_odds >= _LEAST_GAIN


def _coefficients(
    at: pooled.PooledScores, places: Sequence[int], effect: pooled.EffectInUnits
) -> Iterator[PooledCoefficient]:
    for place, value, sd, spread in zip(places, effect.value, effect.sd, effect.spread, strict=True):
        yield PooledCoefficient(
            name=at.names[place], value=float(value), sd=float(sd), spread=float(spread), unit=at.measures[place]
        )


def _groups(scores: pooled.PooledScores, units: pl.DataFrame) -> Iterator[_Group]:
    """Yield each table, mounting and year with enough units inside and outside."""
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
                yield _Group(members, kind, name)
