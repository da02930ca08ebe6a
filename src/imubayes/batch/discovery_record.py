"""What the units of an archive show together, as a record."""

from typing import Literal

from imubayes.batch.pooled_evidence import Law
from imubayes.criticism.evidence.effect_variants import EXPECTED
from imubayes.json_record import Record

Equipment = Literal["table", "mounting", "year"]


class PooledCoefficient(Record):
    """A coefficient, as its mean over the units that have it, and the spread over units; 0 where it is common."""

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
    probability : that the unit has it: where few have it as they do, else at even odds before its data.
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
    law: Law
    laws: dict[Law, float]
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
    place : what it may be, the likeliest first, until 95 % are told.
    evidence : of the likeliest.
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
        """The names of what it may be, the likeliest first."""
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
    ranking : candidates beside the findings, the likeliest first.
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
