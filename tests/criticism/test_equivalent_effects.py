"""Groups of equivalent effects: what explains nothing of what was found is no equivalent of it."""

import math

import pytest
from null_data import fitted_to, redrawn

from imubayes.criticism import thresholds
from imubayes.responses.candidate_effects import candidate_responses
from imubayes.criticism.equivalent_effects import EquivalenceGroup, equivalence_group
from imubayes.adequacy.projection import project
from imubayes.criticism.score_test import project_responses, screen


def group_of_best() -> tuple[EquivalenceGroup, int]:
    """Return the group of the best candidate in readings without an effect, and how many effects were screened."""
    fitted = redrawn(fitted_to("polar-tumble", "polar-tumble"), 3)
    responses = candidate_responses(fitted)
    at = project(fitted, responses.misfit, responses.jacobian)
    candidates = screen(at, project_responses(at, responses.candidates))
    assert candidates[0].delta_chi2 < thresholds.DISTINGUISHABLE_CHI2
    return equivalence_group(at, candidates[0], candidates, 1.0), len({each.effect for each in candidates})


def test_members_explain_some_of_what_a_weak_leader_does(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a weak leader no effect at all leaves little: without the share that is asked for, all are members."""
    group, screened = group_of_best()
    assert max(group.unexplained) < thresholds.EXPLAINED_AS_LIKELY * group.leader.delta_chi2
    assert len(group.members) < screened / 2
    monkeypatch.setattr(thresholds, "EXPLAINED_ALIKE", math.inf)
    assert len(group_of_best()[0].members) == screened
