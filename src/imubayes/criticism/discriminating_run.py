"""The candidate run that best distinguishes the members of an equivalence group, found without a simulation.

Were the leader the truth with the coefficients found, a refit with another member would leave |(I − P_b) w|² of χ² over
all runs, the new one included; the run that makes the smallest of these largest distinguishes them.
"""

from collections.abc import Sequence

import numpy as np

from imubayes.criticism import thresholds
from imubayes.criticism.candidate_effects import Response, candidate_responses
from imubayes.criticism.equivalent_effects import EquivalenceGroup
from imubayes.criticism.projection import Projection, project
from imubayes.criticism.score_test import Candidate
from imubayes.inference.candidate_runs import RunDesign
from imubayes.inference.experiment_design import with_planned
from imubayes.inference.fitted_model import Fit


def discriminating_run(fitted: Fit, group: EquivalenceGroup) -> RunDesign | None:
    """Return the run that best distinguishes the members of a group; None where no feasible run does."""
    if len(group.members) < 2:
        return None
    extended, planned = with_planned(fitted, elsewhere=True)
    if not planned:
        return None
    entries = extended.model.entries
    responses = candidate_responses(extended, only=group.effects)
    projection = project(extended, responses.misfit, responses.jacobian)
    jacobian, prior = np.split(projection.jacobian, [len(entries)])
    members = [_whitened(projection, member, responses.candidates) for member in group.members]
    recorded = len(fitted.model.campaign.runs)
    differences = [
        _least_difference(jacobian, prior, members, (entries.run < recorded) | (entries.run == recorded + place))
        for place in range(len(planned))
    ]
    best = int(np.argmax(differences))
    return planned[best].design if differences[best] >= thresholds.DISTINGUISHABLE_CHI2 else None


def _whitened(
    projection: Projection, member: Candidate, responses: Sequence[Response]
) -> tuple[np.ndarray, np.ndarray]:
    """Return the whitened columns of a member over the entries, and the coefficients found."""
    response = next(each for each in responses if each.scan == member.scan)
    places = {coefficient.parameter.name: place for place, coefficient in enumerate(response.coefficients)}
    values = {
        places[coefficient.parameter.name]: value
        for coefficient, value in zip(member.coefficients, member.value, strict=True)
        if coefficient.parameter.name in places
    }
    columns = projection.whitened(response.columns[:, list(values)])
    return columns[: len(projection.fitted.model.entries)], np.array(list(values.values()))


def _least_difference(
    jacobian: np.ndarray, prior: np.ndarray, members: list[tuple[np.ndarray, np.ndarray]], included: np.ndarray
) -> float:
    """Return the smallest χ² that another member would leave over some entries, (E,) bool, were the first true."""
    leader, values = members[0]
    wanted = np.concatenate([leader[included] @ values, np.zeros(len(prior))])
    differences = []
    for columns, _ in members[1:]:
        size = np.linalg.norm(columns[included], axis=0)
        scaled = columns[included] / np.where(size > 0, size, 1.0)
        rows = np.concatenate([jacobian[included], scaled], axis=1)
        prior_rows = np.concatenate([prior, np.zeros((len(prior), scaled.shape[1]))], axis=1)
        basis, _ = np.linalg.qr(np.concatenate([rows, prior_rows]))
        differences.append(float(np.sum((wanted - basis @ (basis.T @ wanted)) ** 2)))
    return min(differences)
