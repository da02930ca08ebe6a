"""A free form is offered if a sensor can make it, and under the name of an effect if it is one."""

import numpy as np
import pytest

from imubayes.criticism.evidence.free_forms import free_forms
from imubayes.criticism.evidence.linear_problem import ChannelRows, LinearProblem, RowKind
from imubayes.criticism.evidence.possible_forms import possible_forms
from imubayes.parameters.declarations import Parameter
from imubayes.parameters.priors import Normal
from imubayes.responses.candidate_effects import Coefficient, Response, ShapeScan
from imubayes.responses.residual_covariates import ResidualCovariate

ROWS = 24
ANGLE = np.linspace(0, 2 * np.pi, ROWS, endpoint=False)
FORCE = np.column_stack([np.cos(ANGLE), np.sin(ANGLE), 0.1 * np.ones(ROWS)])


def problem(kind: RowKind, noise: float, effect: np.ndarray | None = None) -> LinearProblem:
    """Return one channel with a bias, and a candidate with coefficients of some columns, (ROWS, n)."""
    columns = np.zeros((ROWS, 0)) if effect is None else effect
    prior = Normal(0.0, 1.0)
    coefficients = tuple(
        Coefficient(Parameter("candidate", f"k{n}", ("x",), "1", 1.0, prior, typical=(0.1, 1.0)), "x", (0.1, 1.0))
        for n in range(columns.shape[1])
    )
    candidates = (Response(ShapeScan("candidate", {}), coefficients, columns),) if len(coefficients) else ()
    every = np.column_stack([np.ones(ROWS), columns, np.zeros(ROWS)])
    rows = ChannelRows(
        "x", kind, np.arange(1 + columns.shape[1]), every, np.arange(ROWS), ((0, ROWS),), np.ones(ROWS),
        np.cos(ANGLE), 0.05, (), noise=noise,
    )  # fmt: skip
    return LinearProblem(
        candidates, ("run",), np.zeros(ROWS, dtype=int), np.ones(1), np.zeros(1), np.ones(ROWS), (rows,)
    )


def vector(name: str, unit: str, values: np.ndarray) -> list[ResidualCovariate]:
    return [ResidualCovariate(f"{name}_{a}", unit, x, f"{name} {a}") for a, x in zip("ios", values.T, strict=True)]


def names(made: LinearProblem, known: list[ResidualCovariate]) -> set[str]:
    return {each.name for each in possible_forms(made, known) if each.family == "vector"}


@pytest.mark.parametrize(("largest", "offered"), [(0.004, False), (200.0, True)])
def test_an_accelerometer_follows_the_rate_of_a_table_and_not_the_earth_rate(largest: float, offered: bool):
    """On a dividing head the rates are those of the Earth, 0.004 deg/s: 28 g per deg/s has no probability."""
    made, known = problem("accelerometer", 1e-4), vector("rate", "deg/s", largest * FORCE)
    assert bool(names(made, known)) == offered
    assert {each.name for each in free_forms(made, known)} > {
        each.name for each in possible_forms(made, known)
    } or offered


def test_a_form_with_the_columns_of_an_effect_is_that_effect():
    known = vector("force", "g", FORCE)
    assert names(problem("gyro", 1e-5), known)
    assert not names(problem("gyro", 1e-5, FORCE), known)
    assert names(problem("gyro", 1e-5, FORCE[:, :1]), known)


def test_what_is_left_has_the_prior_of_all_forms():
    made, known = problem("gyro", 1e-5), vector("force", "g", FORCE)
    whole = [
        sum(np.exp(each.log_prior) for each in found)
        for found in (possible_forms(made, known), free_forms(made, known))
    ]
    np.testing.assert_allclose(whole[0], whole[1])
