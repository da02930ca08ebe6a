"""Explanations of what a campaign shows: mistakes with their sizes and evidence, and which of them are told.

A mistake is told beside those that explain the outputs equally well.  Of one record the open value gives way to a name
that does as well.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from imubayes.campaign.setup_gate.equipment_mistakes import DECISIVE, Mistake, Scope

EQUIVALENT = 10.0
"""Mistakes whose gain is within this of the best are equally good explanations; of hidden ones, `DECISIVE`."""
ALIKE = 0.5
"""Share of the gain of a mistake from which on one that is like it is reported beside it."""
NAMED_WITHIN = 12.0
"""How much less than the open value of a record a named mistake may gain: three and a half standard deviations."""
_SAME_POINT = 0.05  # of how far a name may be from a value, within which two names are one


@dataclass(frozen=True)
class Explanation:
    """A mistake and its size, and by how much its correction raises twice the log evidence.

    Attributes
    ----------
    misfit : per output with the correction.
    rival : gain of what passes for the mistake in a valid set-up.
    stopping : support beyond which the mistake stops a fit.
    uncertainty : standard deviation of the size; 0 if there is none.
    """

    mistake: Mistake
    size: float
    gain: float
    misfit: float
    rival: float = 0.0
    stopping: float = DECISIVE
    uncertainty: float = 0.0

    @property
    def support(self) -> float:
        """The gain less what speaks against the mistake beforehand."""
        return self.gain - self.mistake.unlikelihood

    @property
    def rivalled(self) -> bool:
        """Whether the outputs do not distinguish the mistake from what passes for it in a valid set-up."""
        return self.rival > 0 and self.gain < self.rival + DECISIVE


def equally_good(found: Sequence[Explanation], within: float = EQUIVALENT) -> tuple[Explanation, ...]:
    """Return the best explanations, the first of each kind and scope, and those that are like them."""
    best = max(each.support for each in found)
    equal = [each for each in found if each.support >= best - within]
    gained = [each for each in found if each.gain > ALIKE * max(other.gain for other in equal)]
    like = [each for each in gained if any(each.mistake.like(other.mistake) for other in equal)]
    first = [each for each in like if not any(other.mistake.like(each.mistake) for other in equal)]
    return tuple(distinct([*first, *sorted(equal, key=lambda each: -each.support), *like]))


def alike_in_support(found: Sequence[Explanation]) -> Iterator[list[Explanation]]:
    """Yield the explanations of most support and those that are equally good, then the next ones, while any is left."""
    left = sorted(found, key=lambda each: -each.support)
    while left:
        group = list(equally_good(left))
        yield group
        left = [each for each in left if all(each is not other for other in group)]


def told_by_name(found: Sequence[Explanation]) -> list[Explanation]:
    """Return explanations, of each record those with a name if they do as well as its open value, else the latter.

    A name is a point on the open value: a wrong one is not forced upon a value that is near it.  Of names whose points
    are near each other that nearest to the value is reported.
    """
    records: dict[str, list[Explanation]] = {}
    for each in found:
        if each.mistake.record:
            records.setdefault(each.mistake.record, []).append(each)
    dropped = set[int]()
    for alike in records.values():
        names = [each for each in alike if not each.mistake.open_value]
        for value in alike:
            if value.mistake.open_value:
                dropped |= {id(each) for each in _not_told(value, names)}
    return [each for each in found if id(each) not in dropped]


def _not_told(value: Explanation, names: Sequence[Explanation]) -> list[Explanation]:
    """Return which of an open value and the names of its record are not to be distinguished."""
    names = [each for each in names if _holds(each.mistake, {*value.mistake.scope.runs})]
    nearest = min((_apart(each, value) for each in names), default=math.inf)
    near = [_apart(each, value) <= min(nearest + _SAME_POINT, 1.0) for each in names]
    rest = [each for each, told in zip(names, near, strict=True) if not told]
    if value.mistake.named(value.size):  # it has the name itself
        return [*rest, *(each for each in names if each.mistake.point is not None)]
    return [*rest, value] if any(near) else rest


def _holds(named: Mistake, runs: set[int]) -> bool:
    """Whether a named mistake is one of the record of these runs, and of others at most if its evidence decides."""
    return {*named.scope.runs} == runs or (named.point is None and {*named.scope.runs} > runs)


def _apart(named: Explanation, value: Explanation) -> float:
    """Return how far a named mistake is from the value that the outputs show, over how far it may be."""
    point = named.mistake.point
    if point is None:
        return 0.0 if named.gain >= value.gain - NAMED_WITHIN else math.inf
    return abs(point - value.size) / value.mistake.usual_within


def of_different_records(chain: Sequence[tuple[Explanation, ...]]) -> bool:
    """Whether no record is corrected twice: a second correction of it says that the first was none."""
    return len({_corrects(equal[0].mistake) for equal in chain}) == len(chain)


def _corrects(mistake: Mistake) -> tuple[str, Scope]:
    return mistake.record or f"{mistake.kind} {mistake.variant}", mistake.scope


def distinct(found: Sequence[Explanation]) -> Iterator[Explanation]:
    """Yield the first explanation of each kind and scope."""
    seen = set()
    for each in found:
        key = (each.mistake.kind, each.mistake.scope, each.mistake.variant)
        if key not in seen:
            seen.add(key)
            yield each
