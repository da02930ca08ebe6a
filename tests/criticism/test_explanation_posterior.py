"""From a search to what is told: probabilities that add up, a ranking in order, formulas and far rows.

Residuals are drawn from the linear model of `test_evidence`: no fit.
"""

from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from test_evidence import CHANNELS, RATE, ROWS, RUNS, TEMPERATURE, covariates, drawn, posterior_of, problem, searched
from test_one_number import made

from imubayes.criticism.diagnosis_record import ranking
from imubayes.criticism.evidence.hypothesis_evidence import EvidenceOf, Hypothesis
from imubayes.criticism.evidence.posterior_summary import ExplanationPosterior
from imubayes.criticism.explanation_records import ResidualFormula
from imubayes.criticism.formula_search import coefficient_unit, find_formula
from imubayes.criticism.residual_evidence import outliers
from imubayes.foundations.campaign_data import Channel
from imubayes.inference.fitted_model import Fit
from imubayes.model.bind import Model
from imubayes.responses.residual_covariates import ResidualCovariate

COUNT = RUNS * ROWS
WARMTH = 30 * TEMPERATURE
"""Degrees off 25 °C."""
PLANTED: list[dict[tuple[str, int], float]] = [
    {}, {("scale_asymmetry", 1): 0.3}, {("scale_cubic", 0): 0.6, ("bias_temperature_quadratic", 1): 0.3},
    {("scale_cubic", 0): 0.06},
]  # fmt: skip


def the_fit() -> Any:
    """Return the fit of the residuals, as far as what is reported asks of it."""
    runs = [SimpleNamespace(name=f"run{n}", covariates={}) for n in range(RUNS)]
    sensors = tuple(Channel(c, "gyro", np.eye(3), "V", 1.0, "deg/s", 1.0) for c in CHANNELS)
    campaign = SimpleNamespace(site=SimpleNamespace(gravity=9.8), runs=runs, channels=sensors)
    entries = SimpleNamespace(
        run=np.tile(np.repeat(np.arange(RUNS), ROWS), 2), row=np.tile(np.arange(ROWS), 2 * RUNS),
        channel=np.repeat([0, 1], COUNT), closing=np.zeros(2 * COUNT, dtype=bool),
    )  # fmt: skip
    return made(Fit, model=made(Model, campaign=campaign, entries=entries), z=np.zeros(4))


@pytest.mark.parametrize("planted", PLANTED)
def test_probabilities_add_up(planted: dict[tuple[str, int], float]) -> None:
    posterior = posterior_of(searched(drawn(4, planted)))
    assert posterior.share.sum() == pytest.approx(1)
    assert sum(each.probability for each in posterior.evidence.explanations) == pytest.approx(1)
    assert posterior.evidence.leading.kind == posterior.leading
    assert {each.kind for each in posterior.evidence.explanations if each.log_odds == 0} == {posterior.leading}
    every = list(dict.fromkeys(each.effect for each in posterior.of.variants))
    effects = posterior.evidence.of("effects").probability
    assert posterior.including(every) >= effects - 1e-9
    for slot in posterior.slots:
        shares = [each.share for each in slot.members]
        assert all(a >= b for a, b in pairwise(shares))
        assert 0.95 <= sum(shares) <= 1 + 1e-9
        assert 0 <= slot.probability <= 1
    assert all(posterior.including([each.effect]) == each.probability for each in posterior.evidence.inclusion)


def test_a_share_of_what_noise_takes_up_leaves_the_odds_of_a_form_that_leads(monkeypatch: pytest.MonkeyPatch) -> None:
    residual = drawn(6)
    residual[0] += 3.0 * np.sin(12 * RATE)
    monkeypatch.setattr(ExplanationPosterior, "_beside_excess", lambda _, each: bool(each.hypothesis.variants))
    posterior = posterior_of(searched(residual))
    found = posterior.evidence
    assert posterior.unlisted > 0
    assert sum(each.probability for each in found.explanations) == pytest.approx(1)
    assert found.leading.kind == "outside"
    assert found.of("outside").log_odds == 0


@pytest.mark.parametrize("planted", PLANTED)
def test_the_ranking_is_in_order(planted: dict[tuple[str, int], float]) -> None:
    posterior = posterior_of(searched(drawn(4, planted)))
    found = ranking(posterior)
    assert len({line.effect for line in found}) == len(found)
    assert {line.effect for line in found} <= {each.effect for each in posterior.of.variants}
    assert all(0 <= line.probability <= 1 for line in found)
    order = [(-line.probability, -line.log_odds) for line in found]
    assert order == sorted(order)
    assert {line.effect for line in found[: len(planted)] if line.probability > 0.5} == {
        effect for (effect, _), size in planted.items() if size > 0.1
    }
    for line in found:
        assert line.delta_chi2 >= 0
        assert all(each.sd is not None and each.sd > 0 for each in line.coefficients)


def test_scatter_alone_makes_no_second_hypothesis() -> None:
    posterior = posterior_of(searched(drawn(4, PLANTED[1])))
    keys = [
        (each.hypothesis.variants, each.hypothesis.form, tuple((n.rows, n.stated) for n in each.hypothesis.noise))
        for each in posterior.distinct
    ]
    assert len(set(keys)) == len(keys) <= len(posterior.search.known)


def formula_of(
    shape: np.ndarray, deg_h: float, seed: int = 11, *, noise: float = 0.0, largest_rate: float = 1.0
) -> ResidualFormula | None:
    """Return the formula found where gx has so much of a shape in its residual, in deg/h at the input.

    Parameters
    ----------
    noise : of a row at the input, rad/s; 0 if it is not known.
    largest_rate : deg/s.
    """
    residual = drawn(seed)
    factor, unit = coefficient_unit("gyro", 1.0, 9.8)
    assert unit == "deg/h"
    residual[0] += deg_h * factor * shape
    made_of = problem(residual)
    of = EvidenceOf(replace(made_of, rows=tuple(replace(rows, noise=noise) for rows in made_of.rows)))
    at = of.evaluate(Hypothesis((), of.stated))
    rate = replace(covariates()[0], values=largest_rate * covariates()[0].values)
    known = [rate, ResidualCovariate("temperature_degC", "degC", np.tile(WARMTH + 25, 2), "temperature")]
    return find_formula(of, at, np.ones(2), the_fit(), known, 0)


IN_NOISE = 1 / coefficient_unit("gyro", 1.0, 9.8)[0]
"""deg/h of one standard deviation."""


@pytest.mark.parametrize(
    ("shape", "needs", "expression"),
    [
        (15 * RATE**3, "rate", "sample.rate[0] ** 3"),
        (RATE * WARMTH / 10, "temperature", "sample.rate[0] ** 1 * (sample.ambient.temperature - 25.0) ** 1"),
        ((WARMTH / 15) ** 2, "temperature", "(sample.ambient.temperature - 25.0) ** 2"),
    ],
    ids=["cube", "product", "square"],
)
def test_a_planted_term_is_found_with_its_coefficient(shape: np.ndarray, needs: str, expression: str) -> None:
    found = formula_of(shape, IN_NOISE)
    assert found is not None
    assert (found.channel, found.kind) == ("gx", "gyro")
    [term] = found.terms
    assert needs in term.expression
    assert term.expression == expression, term
    assert term.log_odds > 10
    assert term.sd is not None
    whole = RATE**3 if needs == "rate" else RATE * WARMTH if "rate" in expression else WARMTH**2
    size = IN_NOISE * float(shape @ whole / (whole @ whole))
    assert abs(term.value - size) < 4 * term.sd < 0.5 * size
    assert found.inclusion > 0.6


@pytest.mark.parametrize(("largest_rate", "possible"), [(1.0, False), (1e5, True)])
def test_a_formula_is_one_that_a_sensor_can_have(largest_rate: float, possible: bool) -> None:
    """A gyro that errs by 15 rad/s at 1 deg/s is none, however well its readings follow the rate."""
    found = formula_of(15 * RATE**3, IN_NOISE, noise=1.0, largest_rate=largest_rate)
    rates = [] if found is None else [term for term in found.terms if "rate" in term.expression]
    assert bool(rates) == possible


def test_noise_has_no_formula() -> None:
    found = [formula_of(RATE, 0.0, seed) for seed in range(20)]
    assert sum(each is not None for each in found) <= 2


def test_what_the_model_fits_needs_no_formula() -> None:
    assert formula_of(RATE, 30 * IN_NOISE) is None


def told_of(residual: np.ndarray) -> Any:
    return outliers(ExplanationPosterior(searched(residual), the_fit()))


def test_far_rows_are_told_with_their_distance() -> None:
    residual = drawn(12)
    residual[0, 33] += 15.0
    residual[1, 64] -= 11.0
    found = told_of(residual)
    assert [(each.channel, each.run, each.row) for each in found] == [("gx", "run1", 14), ("gy", "run3", 5)]
    assert [each.distance for each in found] == pytest.approx([15.0, -11.0], abs=3)
    assert all(each.time_s is None for each in found)


@pytest.mark.slow
def test_white_noise_has_none() -> None:
    """One in a hundred campaigns is expected to have one."""
    assert sum(len(told_of(drawn(seed))) for seed in range(20)) <= 1
