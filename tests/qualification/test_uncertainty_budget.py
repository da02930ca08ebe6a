"""The budget of a fit: it adds up, and a prior made exact in the budget is one made exact in a refit."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from imubayes.api import Result, fit
from imubayes.campaign import load_campaign
from imubayes.criticism.diagnosis_record import Diagnosis
from imubayes.model.model_file import read_model
from imubayes.results.posterior_quantities import posterior_quantities
from imubayes_qualification.budgets.report_budgets import unit_with_budgets
from imubayes_qualification.budgets.uncertainty_budget import BudgetArrays, FunctionOfQuantities, budget_of
from imubayes_qualification.certificate.conformity import assess

ROOT = Path(__file__).parents[2]
NAMES = ["converter_gain_drift.slope[ax]", "accel_scale_factor.scale[ax]", "accel_bias.bias[ax]", "scale_factor[ax]"]
# No scatter between runs: contributions then depend on no scale that the data leave to its prior.  The prior is of the
# shipped form, so that its programs serve here as well.
TAU = "halfnormal(1e-3 noise)"


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


def test_contributions_add_up_to_the_posterior_variance(budget):
    assert budget.names == tuple(NAMES)
    assert np.all(np.abs(budget.remainder) < 0.02 * budget.posterior)
    # The average over the noise scales is that at their mode but for the width of their posterior.
    np.testing.assert_allclose(budget.averaged.total, budget.improved.at_mode**2, rtol=0.03)


def test_a_prior_made_exact_agrees_with_a_refit(budget):
    exact = fitted(bias="normal(0, 0.001 ug)")
    place = [parameter.name for parameter in budget.priors].index("accel_bias.bias[ax]")
    after = {line.name: line.sd for line in (*exact.summary.parameters, *exact.summary.derived)}
    for row, name in enumerate(budget.names):
        if name != "accel_bias.bias[ax]":
            # 4000 independent draws give the standard deviation of the refit to 1.1 %.
            assert budget.improved.exact_prior[row, place] == pytest.approx(after[name], rel=0.04), name
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
    (drift,) = assess(result, file, Diagnosis(verdict="adequate")).limits
    assert drift.decision.outcome == "pass"
    assert assess(result, file, None).limits[0].decision.withheld == "obstacle"
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


def test_a_fit_that_did_not_converge_cannot_pass(result, tmp_path):
    file = tmp_path / "spec.toml"
    file.write_text('format = 1\nname = "x"\n[[limit]]\nquantity = "accel_bias.bias"\nupper = 1\nunit = "ug"\n')
    failed = replace(result, summary=result.summary.model_copy(update={"converged": False, "message": "it stopped"}))
    found = assess(failed, file, Diagnosis(verdict="adequate"))
    assert found.obstacles == ("not_converged",)
    assert found.outcome == "withheld"


@pytest.mark.slow
def test_an_angle_at_zero_has_a_budget_of_its_components(result):
    """The seat is level to its uncertainty: the angle is Rayleigh, and both tilts of the seat contribute."""
    found = budget_of(result, ["mounting_angle[ax,up]", "mounting_angle[ax,pyramid]"])
    assert found.at_zero == ("mounting_angle[ax,up]",)
    assert np.all(np.abs(found.remainder) < 0.02 * found.posterior)
    row = dict(zip((p.name for p in found.priors), found.averaged.type_b[0] / found.posterior[0], strict=True))
    tilts = [share for name, share in row.items() if name.startswith("mounting_error") and "[up]" in name]
    assert sum(share > 0.1 for share in tilts) == 2
    # Width of the draws, whatever the linear model says.
    draws = posterior_quantities(result).marginal("mounting_angle[ax,up]").draws
    assert found.posterior[0] == pytest.approx(np.var(draws), rel=1e-6)


def test_functions_of_quantities_have_budgets(result):
    """A sum has that of the sum of gradients; a length near zero adds up over its components."""
    draws = posterior_quantities(result).draws
    first, second = NAMES[1], NAMES[2]
    away = {name: draws[name] - draws[name].mean() for name in (first, second)}
    functions = {
        "sum": FunctionOfQuantities(draws[first] + 2 * draws[second], (first, second)),
        "length": FunctionOfQuantities(np.hypot(away[first], away[second]), (first, second), length=True),
        "far": FunctionOfQuantities(np.hypot(1e6 + away[first], away[second]), (first, second), length=True),
        "of another": FunctionOfQuantities(draws[first], ("accel_bias.bias[az]",)),
    }
    found = budget_of(result, NAMES, functions)
    assert found.names == (*NAMES, "sum", "length", "far")
    assert np.all(np.abs(found.remainder) < 0.02 * found.posterior)
    assert found.posterior[4] == pytest.approx(np.var(draws[first] + 2 * draws[second]), rel=0.1)
    place = [parameter.name for parameter in found.priors].index("accel_bias.bias[ax]")
    along = found.averaged.sensitivity[:, place]
    assert along[4] == pytest.approx(along[1] + 2 * along[2], rel=1e-3)
    assert along[6] == pytest.approx(along[1], rel=1e-3), "far from zero a length has the gradient of its large member"
    assert "length" in found.at_zero
    assert "far" not in found.at_zero


@pytest.mark.slow
def test_all_quantities_add_up_within_two_percent(result):
    names = list(posterior_quantities(result).entries)
    found = budget_of(result, names)
    assert np.all(np.abs(found.remainder) < 0.02 * found.posterior), found.names
    # Draws alone are known to two per cent of the variance, several times worse.
    assert np.median(found.posterior_error / found.posterior) < 0.01


def test_the_report_has_one_number_for_each_quantity(result):
    """What the model takes as exact widens draws and budget alike, and every table states the same U."""
    found = unit_with_budgets(result)
    assert found.exact.included, "gravity of this campaign is that of the ellipsoid"
    for each in found.budgets.quantities:
        stated = found.unit.coverage(each.name)
        assert (stated.standard, stated.expanded) == (each.standard_uncertainty, each.expanded_uncertainty)
        assert found.unit.quantities.draws[each.name].std() == pytest.approx(each.standard_uncertainty, rel=0.06)
        assert sum(line.share for line in each.lines) == pytest.approx(1 - each.remainder)
    moved = {shift.name for one in found.exact.included for shift in one.shifts}
    listed = {each.name for each in found.budgets.quantities if any(line.kind == "exact" for line in each.lines)}
    assert moved & {each.name for each in found.budgets.quantities} >= listed > set()
