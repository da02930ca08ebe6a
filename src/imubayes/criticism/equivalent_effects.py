"""Equivalence groups: candidates that the data cannot distinguish are one answer with several names.

Were the leader the truth, a refit with another candidate instead would leave |(I − P_b) w|² of χ² unexplained, w being
the part of the residual that the leader explains and P_b the projection on the other's response: S sin²φ.  Two
candidates are equivalent where this is below `thresholds.DISTINGUISHABLE_CHI2` and the other explains half of what the
leader does, or where the other is as likely and explains a quarter.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imubayes.criticism import thresholds
from imubayes.criticism.projection import Projection
from imubayes.criticism.score_test import Candidate


@dataclass(frozen=True)
class EquivalenceGroup:
    """Candidates that explain the same; the leader first.

    Attributes
    ----------
    members : one candidate per effect, on the leader's channels as far as it acts on them.
    p : p-value of the leader, corrected for the number of looks.
    unexplained : per member, the χ² that a refit with it instead of the leader would leave.
    """

    members: tuple[Candidate, ...]
    p: float
    unexplained: tuple[float, ...]

    @property
    def leader(self) -> Candidate:
        """The candidate with the strongest evidence."""
        return self.members[0]

    @property
    def effects(self) -> tuple[str, ...]:
        """Names of the effects."""
        return tuple(member.effect for member in self.members)


def unexplained_chi2(projection: Projection, leader: Candidate, other: Candidate) -> tuple[float, float]:
    """Return the χ² that another candidate instead of the leader would leave, and the leader's χ² itself."""
    scale = np.sqrt(projection.strata.at_rows(leader.score.variance))
    explained = leader.score.fitted / scale
    basis, _ = np.linalg.qr(other.score.span / scale[:, None])
    return float(np.sum((explained - basis @ (basis.T @ explained)) ** 2)), float(explained @ explained)


def indistinguishable(projection: Projection, leader: Candidate, other: Candidate) -> bool:
    """Tell whether the data do not distinguish another candidate from the leader."""
    return _instead(projection, leader, other)[1]


def _instead(projection: Projection, leader: Candidate, other: Candidate) -> tuple[float, bool]:
    """Return the χ² that another candidate instead of the leader would leave, and whether that is indistinguishable."""
    left, whole = unexplained_chi2(projection, leader, other)
    # Where the leader itself is worth little, what explains none of it leaves little as well.
    same = left < min(thresholds.DISTINGUISHABLE_CHI2, thresholds.EXPLAINED_ALIKE * whole)
    as_likely = other.log_p < leader.log_p + thresholds.DECISIVE_LOG_ODDS
    return left, same or (as_likely and left < thresholds.EXPLAINED_AS_LIKELY * whole)


def equivalence_group(
    projection: Projection,
    leader: Candidate,
    ranked: Sequence[Candidate],
    p: float,
    also: Sequence[Candidate] = (),
) -> EquivalenceGroup:
    """Return the leader with every candidate that the data do not distinguish from it.

    Parameters
    ----------
    ranked : all candidates as screened, best first.
    p : corrected p-value of the leader.
    also : further candidates that other evidence does not distinguish from the leader.
    """
    members: dict[str, tuple[Candidate, float]] = {}
    for candidate in ranked:
        if candidate.effect == leader.effect:
            continue
        left, same = _instead(projection, leader, candidate)
        told = any(candidate is each for each in also)
        best = members.get(candidate.effect)
        # Of one effect, the candidate with fewer directions, or that explains more with as many.
        simpler = best is None or (candidate.dof, left) < (best[0].dof, best[1])
        if (same or told) and simpler:
            members[candidate.effect] = (candidate, left)
    others = sorted(members.values(), key=lambda pair: pair[0].log_p)
    return EquivalenceGroup((leader, *(candidate for candidate, _ in others)), p, (0.0, *(left for _, left in others)))
