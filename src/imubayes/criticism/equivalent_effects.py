"""Candidates that cannot be told apart are one answer with several names.

Were the leader the truth, a refit with another candidate instead would leave |(I − P_b) w|² of χ² unexplained, w being
the part of the residual that the leader explains and P_b the projection on the other's response: S sin²φ.  Below 16 the
data do not decide between the two names: three standard deviations where some fifty rivals had the chance to lead.
Nor do they where the other, whatever the runs could have told, happens to explain the same almost as well.
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
    p : chance of the leader with all looks counted.
    unexplained : per member what a refit with it instead of the leader would leave of χ².
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
        return tuple(one.effect for one in self.members)


def row_scales(projection: Projection, candidate: Candidate) -> np.ndarray:
    """Return the noise scale of every row after a candidate has been taken out, shape (R,)."""
    return np.sqrt(projection.strata.at_rows(candidate.score.variance))


def unexplained_chi2(projection: Projection, leader: Candidate, other: Candidate) -> tuple[float, float]:
    """Return what another candidate instead of the leader would leave of the leader's χ², and that χ² itself."""
    scale = row_scales(projection, leader)
    wanted = leader.score.fitted / scale
    # The other's response weighted alike; what it cannot reach of the leader's part stays unexplained.
    basis, _ = np.linalg.qr(other.score.span / scale[:, None])
    return float(np.sum((wanted - basis @ (basis.T @ wanted)) ** 2)), float(wanted @ wanted)


def group(projection: Projection, leader: Candidate, ranked: Sequence[Candidate], p: float) -> EquivalenceGroup:
    """Return the leader with everything that the data do not tell apart from it.

    Parameters
    ----------
    ranked : all candidates as screened, best first.
    p : chance of the leader with all looks counted.
    """
    members: dict[str, tuple[Candidate, float]] = {leader.effect: (leader, 0.0)}
    for one in ranked:
        if one.effect == leader.effect:
            continue
        left, whole = unexplained_chi2(projection, leader, one)
        near = one.log_p < leader.log_p + thresholds.DECISIVE_LOG_ODDS and left < whole / 2
        best = members.get(one.effect)
        if (left < thresholds.DISTINGUISHABLE_CHI2 or near) and (best is None or _simpler(one, left, *best)):
            members[one.effect] = (one, left)
    others = sorted((pair for pair in members.values() if pair[0] is not leader), key=lambda pair: pair[0].log_p)
    return EquivalenceGroup((leader, *(one for one, _ in others)), p, (0.0, *(left for _, left in others)))


def _simpler(one: Candidate, left: float, other: Candidate, other_left: float) -> bool:
    """Tell whether a candidate explains the same with fewer directions, or more with as many."""
    return (one.dof, left) < (other.dof, other_left)
