"""The candidate run that best distinguishes the members of a slot, found without a simulation.

Were the leader the truth with the coefficients found, a refit with another member would leave |(I − P_b) w|² of χ² over
all runs, the new one included; the run that makes the smallest of these largest distinguishes them.
"""

import math
from statistics import NormalDist

import jax.numpy as jnp
import numpy as np

from imubayes.adequacy.known_noise import known_scales
from imubayes.adequacy.known_noise_fit import whitened_rows
from imubayes.criticism.detectability import DETECTION_POWER
from imubayes.criticism.evidence.evidence_record import NAMED_ODDS
from imubayes.criticism.evidence.posterior_summary import ExplanationPosterior, MissingEffect
from imubayes.inference.candidate_runs import RunDesign
from imubayes.inference.experiment_design import with_planned
from imubayes.inference.fitted_model import Fit
from imubayes.model.problem import prior_widths
from imubayes.responses.candidate_effects import candidate_responses

_POWER = NormalDist().inv_cdf(DETECTION_POWER)
_DISTINGUISHED = (_POWER + math.sqrt(_POWER**2 + 2 * NAMED_ODDS)) ** 2
"""χ² by which a planned run has to distinguish the members of a slot, so that one will be named.  Derived: 9.6."""


def discriminating_run(fitted: Fit, posterior: ExplanationPosterior, slot: MissingEffect) -> RunDesign | None:
    """Return the run that best distinguishes the members of a slot; None where no feasible run does."""
    if len(slot.members) < 2:
        return None
    extended, planned = with_planned(fitted, elsewhere=True)
    if not planned:
        return None
    entries = extended.model.entries
    responses = candidate_responses(extended, only=[member.effect for member in slot.members])
    if {each.scan.effect for each in responses.candidates} < {member.effect for member in slot.members}:
        return None
    members = [posterior.response_to(member, responses) for member in slot.members]
    # The runs that are planned have the noise that is known of their channels.
    h = known_scales(extended)
    parts = [responses.jacobian, *(columns for columns, _ in members)]
    white = whitened_rows(extended.model.problem, h, np.concatenate(parts, axis=1))
    jacobian, *columns = np.split(white, np.cumsum([part.shape[1] for part in parts])[:-1], axis=1)
    prior = np.diag(1 / np.asarray(prior_widths(extended.model.problem, jnp.asarray(h))))
    recorded = len(fitted.model.campaign.runs)
    sized = [(own, sizes) for own, (_, sizes) in zip(columns, members, strict=True)]
    differences = [
        _least_difference(jacobian, prior, sized, (entries.run < recorded) | (entries.run == recorded + place))
        for place in range(len(planned))
    ]
    best = int(np.argmax(differences))
    return planned[best].design if differences[best] >= _DISTINGUISHED else None


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
