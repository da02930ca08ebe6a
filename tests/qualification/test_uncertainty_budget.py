"""The budget of a fit: it adds up, and a prior made exact in the budget is one made exact in a refit."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from imubayes.api import Result, fit
from imubayes.campaign import load_campaign
from imubayes.model.model_file import read_model
from imubayes.qualification.posterior_quantities import posterior_quantities
from imubayes.qualification.uncertainty_budget import BudgetArrays, budget_of

ROOT = Path(__file__).parents[2]
NAMES = ["converter_gain_drift.slope[ax]", "accel_scale_factor.scale[ax]", "accel_bias.bias[ax]", "scale_factor[ax]"]
# A scatter between runs that is known: contributions then depend on no scale that the data leave to its prior.
TAU = "lognormal(0.01 noise, 0.02)"


def fitted(**priors: str) -> Result:
    model = read_model(ROOT / "models" / "accel-channel.toml")
    effects = tuple(
        replace(
            effect, prior={"tau": TAU} if effect.name == "run_scatter" else {**effect.prior, **_own(effect, priors)}
        )
        for effect in model.effects
    )
    return fit(load_campaign(ROOT / "data" / "accel-channel"), replace(model, effects=effects), sample=False)


def _own(effect, priors: dict[str, str]) -> dict[str, str]:
    return {"bias": priors["bias"]} if effect.name == "accel_bias" and "bias" in priors else {}


@pytest.fixture(scope="module")
def result() -> Result:
    return fitted()


@pytest.fixture(scope="module")
def budget(result) -> BudgetArrays:
    return budget_of(result, NAMES)


def test_contributions_add_up_to_the_posterior_variance(result, budget):
    quantities = posterior_quantities(result)
    assert budget.names == tuple(NAMES)
    errors = np.array([2 * quantities.marginal(n).errors.sd / quantities.marginal(n).sd for n in NAMES])
    assert np.all(np.abs(budget.remainder) / budget.posterior < 0.02 + 3 * errors)
    # Exactly so at the mode.
    np.testing.assert_allclose(budget.averaged.total, budget.at_mode**2, rtol=0.02)


def test_a_prior_made_exact_agrees_with_a_refit(budget):
    exact = fitted(bias="normal(0, 0.001 ug)")
    place = [parameter.name for parameter in budget.priors].index("accel_bias.bias[ax]")
    after = {line.name: line.sd for line in (*exact.summary.parameters, *exact.summary.derived)}
    for row, name in enumerate(budget.names):
        if name != "accel_bias.bias[ax]":
            # 4000 independent draws give the standard deviation of the refit to 1.1 %.
            assert budget.exact_prior[row, place] == pytest.approx(after[name], rel=0.04), name
    shares = budget.averaged.type_b[:, place] / budget.posterior
    assert shares[NAMES.index("accel_bias.bias[ax]")] > 0.05, "the prior of the bias contributes to the bias"


def test_what_the_data_tell_is_type_a(budget):
    type_a = budget.averaged.type_a.sum(axis=1) / budget.posterior
    assert type_a[NAMES.index("converter_gain_drift.slope[ax]")] > 0.9
    assert type_a[NAMES.index("accel_scale_factor.scale[ax]")] < 0.1
