"""The budget of a fit: it adds up, and a prior made exact in the budget is one made exact in a refit."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from imubayes.api import Result, fit
from imubayes.campaign import load_campaign
from imubayes.criticism.diagnosis_record import Diagnosis
from imubayes.errors import InputError
from imubayes.model.model_file import read_model
from imubayes.qualification.assess import assess
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


def test_a_unit_passes_only_with_an_adequate_model(result, tmp_path):
    file = tmp_path / "spec.toml"
    limits = '[[limit]]\nquantity = "converter_gain_drift.slope"\nlower = LOWER\nupper = 0\nunit = "ppm/degC"\n'
    file.write_text('format = 1\nname = "converter"\n' + limits.replace("LOWER", "-10"))
    (drift,) = assess(result, file, None).limits
    assert drift.decision.outcome == "pass"
    assert drift.estimate.value == pytest.approx(-3.2, abs=0.2)
    outcomes = {
        verdict: assess(result, file, None if verdict is None else Diagnosis(verdict=verdict)).outcome
        for verdict in ("adequate", "missing_effect", None)
    }
    assert outcomes == {"adequate": "pass", "missing_effect": "withheld", None: "withheld"}
    file.write_text('format = 1\nname = "converter"\n' + limits.replace("LOWER", "-1"))
    assert assess(result, file, Diagnosis(verdict="missing_effect")).outcome == "fail"
    invalid = replace(result, summary=result.summary.model_copy(update={"intervals_valid": False}))
    assert assess(invalid, file, Diagnosis(verdict="adequate")).obstacles == ("invalid_intervals",)


def test_a_fit_that_did_not_converge_is_refused(result, tmp_path):
    file = tmp_path / "spec.toml"
    file.write_text('format = 1\nname = "x"\n[[limit]]\nquantity = "accel_bias.bias"\nupper = 1\nunit = "ug"\n')
    failed = replace(result, summary=result.summary.model_copy(update={"converged": False, "message": "it stopped"}))
    with pytest.raises(InputError, match="no posterior draws"):
        assess(failed, file, Diagnosis(verdict="adequate"))
