"""The candidate run that best distinguishes the members of an slot, found without a simulation.

Were the leader the truth with the coefficients found, a refit with another member would leave |(I − P_b) w|² of χ² over
all runs, the new one included; the run that makes the smallest of these largest distinguishes them.
"""

import jax.numpy as jnp
import numpy as np

from imubayes.adequacy.known_noise import known_scales
from imubayes.adequacy.known_noise_fit import whitened_rows
from imubayes.criticism.candidate_effects import candidate_responses
from imubayes.criticism.evidence.posterior_summary import Posterior, Slot
from imubayes.inference.candidate_runs import RunDesign
from imubayes.inference.experiment_design import with_planned
from imubayes.inference.fitted_model import Fit
from imubayes.model.problem import prior_widths

_DISTINGUISHED = 16.0
"""χ² by which a planned run has to distinguish the members of a slot: four standard deviations (convention)."""


def discriminating_run(fitted: Fit, posterior: Posterior, slot: Slot) -> RunDesign | None:
    """Return the run that best distinguishes the members of a slot; None where no feasible run does."""
    if len(slot.members) < 2:
        return None
    extended, planned = with_planned(fitted, elsewhere=True)
    if not planned:
        return None
    entries, of = extended.model.entries, posterior.of
    responses = candidate_responses(extended, only=[member.effect for member in slot.members])
    members = []
    for member in slot.members:
        scan = of.problem.candidates[of.variants[member.variant].response].scan
        sizes = {each.name: each.value or 0.0 for each in posterior.coefficients(member.variant, member.found)}
        own = [each for each in responses.candidates if each.scan.effect == scan.effect]
        response = next((each for each in own if each.scan == scan), own[0] if own else None)
        if response is None:
            return None
        names = [each.parameter.name for each in response.coefficients]
        members.append((response.columns[:, [k for k, name in enumerate(names) if name in sizes]],
                        np.array([sizes[name] for name in names if name in sizes])))  # fmt: skip
    # The runs that are planned have the noise that is known of their channels.
    h = known_scales(extended)
    white = whitened_rows(extended.model.problem, h, np.concatenate([responses.jacobian, *(c for c, _ in members)], 1))
    jacobian, *columns = np.split(
        white, np.cumsum([responses.jacobian.shape[1], *(c.shape[1] for c, _ in members)])[:-1], 1
    )
    prior = np.diag(1 / np.asarray(prior_widths(extended.model.problem, jnp.asarray(h))))
    recorded = len(fitted.model.campaign.runs)
    differences = [
        _least_difference(
            jacobian, prior, [(own, sizes) for own, (_, sizes) in zip(columns, members, strict=True)],
            (entries.run < recorded) | (entries.run == recorded + place),
        )
        for place in range(len(planned))
    ]  # fmt: skip
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
