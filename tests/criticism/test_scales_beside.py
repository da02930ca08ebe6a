"""Scores at the scales beside a candidate: right p-values without an effect, evidence of both strata with one."""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
from null_data import fitted_to

from imubayes.criticism import score_test, thresholds
from imubayes.responses.candidate_effects import Coefficient, Response, ShapeScan, candidate_responses
from imubayes.adequacy.projection import PRIOR, Projection, Strata, project
from imubayes.criticism.scales_beside import at_scales_beside
from imubayes.criticism.score_test import Candidate, ProjectedResponse, assess
from imubayes.parameters.priors import Normal
from imubayes.parameters.vector import Parameter
from imubayes.tail_probabilities import chi2_log_survival

ROWS, WITHIN = 24, 0.1


@dataclass(frozen=True)
class Mixed:
    """Rows of a channel with run offsets: one row for each run's mean, then those within the runs."""

    projection: Projection
    response: ProjectedResponse
    floor: tuple[np.ndarray, np.ndarray]

    def as_fitted(self) -> Candidate:
        return assess(self.projection, self.response, np.array([0]))

    def beside(self) -> Candidate:
        return at_scales_beside(self.projection, self.response, np.array([0]), self.floor)[0]


@cache
def template() -> Projection:
    """Return any projection: its rows, strata and basis are replaced."""
    fitted = fitted_to("accel-channel", "accel-channel")
    responses = candidate_responses(fitted)
    return project(fitted, responses.misfit, responses.jacobian)


def mixed(seed: int, scatter: float, slope: float = 0.0, runs: int = 6) -> Mixed:
    """Return a mixed model at its scales by restricted maximum likelihood without a drift.

    White noise of 1, run means scattered by `scatter` times their noise, and a drift of `slope` along a unit direction
    that lies to `WITHIN` of its square within runs.
    """
    random = np.random.default_rng(seed)
    between = np.linspace(-1, 1, runs)
    within = random.normal(size=runs * (ROWS - 1))
    direction = np.concatenate(
        [between / np.linalg.norm(between) * np.sqrt(1 - WITHIN), within / np.linalg.norm(within) * np.sqrt(WITHIN)]
    )
    of_row = np.repeat([1, 0], [runs, len(within)])
    noise = random.normal(size=len(direction)) * np.where(of_row == 1, np.hypot(1, scatter), 1.0)
    mean = np.concatenate([np.full(runs, runs**-0.5), np.zeros(len(within))])[:, None]
    values = noise + slope * direction
    values -= mean[:, 0] * (mean[:, 0] @ values)
    freedom = np.array([len(within), runs - 1, 0.0])
    strata = Strata(np.concatenate([of_row, [PRIOR]]), np.array([0, 0]), np.array([False, True]))
    variance = strata.sums(np.append(values, 0.0) ** 2) / np.maximum(freedom, 1)
    variance[1] = max(variance[1], variance[0])
    scale = np.append(np.sqrt(variance[of_row]), 1.0)
    basis = np.append(mean, [[0.0]], axis=0)
    residual = np.append(values, 0.0) / scale
    projection = replace(template(), basis=basis, residual=residual, strata=strata, freedom=freedom, jacobian=basis)
    column = (np.append(direction, 0.0) / scale)[:, None]
    drift = Coefficient(Parameter("drift", "slope", ("a",), "1", 1.0, Normal(0.0, 1.0)), "a", (0.01, 100.0))
    response = Response(ShapeScan("drift", {}), (drift,), column)
    floor = np.array([0, 0, 2]), np.array([0.0, variance[0] / variance[1], 0.0])
    return Mixed(projection, ProjectedResponse(response, column, projection.project(column)), floor)


def p_values(scatter: float, runs: int = 6) -> np.ndarray:
    return np.array([mixed(seed, scatter, runs=runs).beside().p for seed in range(400)])


@pytest.mark.parametrize("scatter", [0.0, 1.0, 5.0])
def test_p_values_without_an_effect(scatter):
    found = p_values(scatter)
    assert np.mean(found < 0.05) < 0.09
    assert np.mean(found < 0.05 * thresholds.SECOND_LOOK) < 0.05
    assert np.mean(p_values(scatter, runs=4) < 0.001) < 0.01


def test_scales_taken_for_known_would_be_seen(monkeypatch):
    """Planted fault: the degrees of freedom of the scatter between runs are left out."""
    monkeypatch.setattr(score_test, "_log_p", lambda total, count, _, cone: float(chi2_log_survival(total, count)))
    assert np.mean(p_values(5.0, runs=4) < 0.001) > 0.01


def test_a_drift_is_judged_by_the_scatter_beside_it():
    """S = 157 as the scales are, 15 within runs: where chance bends the rows within runs, the scatter that
    the drift caused hides it."""
    draws = [mixed(seed, 0.2, slope=12.5) for seed in range(100)]
    found = [each.beside() for each in draws]
    assert np.mean([each.p > 3e-4 for each in found]) < 0.02 < np.mean([each.as_fitted().p > 3e-4 for each in draws])
    score = [(float(each.value[0]) - 12.5) / float(each.sd[0]) for each in found]
    assert np.sqrt(np.mean(np.square(score))) < 1.6
