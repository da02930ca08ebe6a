"""The smallest detectable size is one that the score test detects with the power stated, also between few runs."""

from dataclasses import replace

import numpy as np
import pytest
from null_data import fitted_to
from scipy import stats

from imubayes.criticism import thresholds
from imubayes.responses.candidate_effects import candidate_responses
from imubayes.criticism.detectability import freedom_of, noncentrality_needed
from imubayes.adequacy.projection import Projection, project, with_run_offsets
from imubayes.criticism.score_test import project_responses, score_test

P = 0.001


def projected(campaign: str, effect: str) -> tuple[Projection, np.ndarray]:
    """Return the projection of a shipped campaign and the response of a coefficient, projected, of unit length, (R, 1).

    Run offsets are a stratum of their own, as where the effect has inflated their scatter.
    """
    fitted = fitted_to(campaign, campaign)
    responses = candidate_responses(fitted)
    at, _ = with_run_offsets(project(fitted, responses.misfit, responses.jacobian))
    [response] = [each for each in responses.candidates if each.scan.effect == effect]
    columns = project_responses(at, [response])[0].projected[:, :1]
    return at, columns / np.linalg.norm(columns)


def power(at: Projection, columns: np.ndarray, size: float, draws: int = 400) -> float:
    """Return the share of draws of unit noise with an effect of some size in it that the score test detects."""
    random, found = np.random.default_rng(1), 0
    for _ in range(draws):
        noise = at.project(random.normal(size=(len(columns), 1)))[:, 0]
        drawn = replace(at, residual=noise + size * columns[:, 0])
        found += score_test(drawn, columns, np.ones(1), least=0.0).p < P
    return found / draws


@pytest.mark.parametrize(
    ("campaign", "effect", "between"),
    [("polar-tumble", "gyro_scale_factor", True), ("geographic-tumble", "gyro_dead_zone", False)],
)
def test_power_at_the_smallest_detectable_size(campaign: str, effect: str, between: bool) -> None:
    at, columns = projected(campaign, effect)
    freedom = freedom_of(at, columns)
    assert (freedom[0] < 4) == between
    # Satterthwaite's approximation errs towards larger sizes where there is about one degree of freedom.
    found = power(at, columns, noncentrality_needed(np.array([P / 2]), freedom)[0])
    assert 0.72 < found < (1.01 if between else 0.88)
    # The normal quantile, as if the scatter between few runs were known, promises too much.
    known = stats.norm.isf(P / 2) + stats.norm.ppf(thresholds.DETECTION_POWER)
    assert (power(at, columns, known) < 0.3) == between


@pytest.mark.parametrize("freedom", [1.0, 2.0, 5.0, 1e9])
def test_the_noncentrality_is_that_of_students_t(freedom: float) -> None:
    [needed] = noncentrality_needed(np.array([P]), np.array([freedom]))
    assert stats.nct.sf(stats.t.isf(P, freedom), freedom, needed) == pytest.approx(thresholds.DETECTION_POWER, abs=0.01)
