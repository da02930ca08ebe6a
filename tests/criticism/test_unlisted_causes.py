"""A single name is not certain where a plain function of covariates explains the residual as well."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from null_data import fitted_to, redrawn

from imubayes.criticism import stepwise_search, unlisted_causes
from imubayes.responses.candidate_effects import candidate_responses
from imubayes.criticism.diagnose import judge

ABSENT = "gyro_misalignment"


@pytest.mark.parametrize(("looked", "verdict"), [(True, "equivalent_effects"), (False, "missing_effect")])
def test_a_name_that_only_the_catalogue_suggests_is_not_certain(
    monkeypatch: pytest.MonkeyPatch, looked: bool, verdict: str
) -> None:
    """In positions of one gyro, misalignment looks like magnetic sensitivity where the catalogue lacks it."""
    fitted = fitted_to("geographic-tumble", "geographic-tumble")
    [truth] = [each for each in candidate_responses(fitted).candidates if each.scan.effect == ABSENT]
    sizes = np.array([coefficient.typical[1] for coefficient in truth.coefficients])
    planted = redrawn(fitted, 7, change=truth.columns @ (6 * sizes * np.array([0.8, -0.6])))

    def lacking(at: Any, *more: Any) -> Any:
        found = candidate_responses(at, *more)
        return replace(found, candidates=tuple(each for each in found.candidates if each.scan.effect != ABSENT))

    monkeypatch.setattr(stepwise_search, "candidate_responses", lacking)
    if not looked:
        # Planted fault: no vector is looked at.
        monkeypatch.setattr(unlisted_causes, "_VECTORS", ())
    found = judge(planted)
    assert found.verdict == verdict
    [group] = found.groups
    assert group.effects == ("gyro_magnetic_sensitivity",)
    assert bool(group.unlisted) == looked
