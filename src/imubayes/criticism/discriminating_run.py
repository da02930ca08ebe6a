"""Which run would tell two candidates apart, of those that the equipment allows; ranked without a simulation.

Were the leader the truth with the coefficients found, a refit with the other name would leave |(I − P_b) w|² of χ² over
all runs, the new one included; the run that makes this largest separates them.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imubayes.criticism import thresholds
from imubayes.criticism.candidate_effects import Response, candidate_responses
from imubayes.criticism.equivalent_effects import EquivalenceGroup
from imubayes.criticism.projection import project
from imubayes.criticism.score_test import Candidate
from imubayes.inference.experiment_design import with_planned
from imubayes.inference.fitted import Fitted


@dataclass(frozen=True)
class SeparatingRun:
    """A run that separates a group: in words, and the χ² by which the names would then differ at least."""

    sentence: str
    difference: float


def separating_run(fitted: Fitted, group: EquivalenceGroup) -> SeparatingRun | None:
    """Return the run that best tells the members of a group apart; None where no feasible run does."""
    if len(group.members) < 2:
        return None
    wide, planned = with_planned(fitted, elsewhere=True)
    if not planned:
        return None
    model = wide.model
    responses = candidate_responses(wide, only=group.effects)
    projection = project(wide, responses.misfit, responses.jacobian)
    prior = projection.jacobian[len(model.entries) :]
    known = len(fitted.model.campaign.runs)
    spread = _rows(projection, group, responses.candidates)
    best: SeparatingRun | None = None
    for place, one in enumerate(planned):
        included = (model.entries.run < known) | (model.entries.run == known + place)
        difference = _least_difference(projection.jacobian[: len(model.entries)][included], prior, spread, included)
        if best is None or difference > best.difference:
            best = SeparatingRun(one.sentence, difference)
    return best if best is not None and best.difference >= thresholds.DISTINGUISHABLE_CHI2 else None


def _rows(projection, group: EquivalenceGroup, responses: Sequence[Response]) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return for each member its whitened columns and the coefficients found."""
    return [_columns(projection, member, responses) for member in group.members]


def _columns(projection, member: Candidate, responses: Sequence[Response]) -> tuple[np.ndarray, np.ndarray]:
    response = next(one for one in responses if one.scan == member.scan)
    names = [one.parameter.name for one in response.coefficients]
    places = [names.index(one.parameter.name) for one in member.coefficients if one.parameter.name in names]
    values = [
        value for one, value in zip(member.coefficients, member.value, strict=True) if one.parameter.name in names
    ]
    count = len(projection.fitted.model.entries)
    return projection.whitened(response.columns[:, places])[:count], np.array(values)


def _least_difference(
    jacobian: np.ndarray, prior: np.ndarray, members: list[tuple[np.ndarray, np.ndarray]], included: np.ndarray
) -> float:
    """Return the smallest χ² that any other member would leave were the first the truth."""
    leader, values = members[0]
    wanted = np.concatenate([leader[included] @ values, np.zeros(len(prior))])
    differences = []
    for columns, _ in members[1:]:
        size = np.linalg.norm(columns[included], axis=0)
        scaled = columns[included] / np.where(size > 0, size, 1.0)
        whole = np.concatenate([jacobian, scaled], axis=1)
        beside = np.concatenate([prior, np.zeros((len(prior), scaled.shape[1]))], axis=1)
        basis, _ = np.linalg.qr(np.concatenate([whole, beside]))
        differences.append(float(np.sum((wanted - basis @ (basis.T @ wanted)) ** 2)))
    return min(differences)
