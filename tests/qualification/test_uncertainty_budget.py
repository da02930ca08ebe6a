"""The budget of a fit: it adds up, and a prior made exact in the budget is one made exact in a refit."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from imubayes.api import Result, fit, load
from imubayes.campaign import load_campaign
from imubayes.criticism.diagnosis_record import Diagnosis
from imubayes.foundations.campaign_data import Instruments, Thermometer
from imubayes.inference.fitted_model import Fit
from imubayes.inference.parameter_fit import whitened_columns
from imubayes.model.bind import bind
from imubayes.model.model_file import read_model
from imubayes.model.problem import prior_widths
from imubayes.responses.instrument_errors import instrument_errors
from imubayes.responses.uncertain_equipment import uncertain_equipment
from imubayes.results.posterior_quantities import posterior_quantities
from imubayes_qualification.budgets.report_budgets import unit_with_budgets
from imubayes_qualification.budgets.taken_as_exact import exact_equipment
from imubayes_qualification.budgets.uncertainty_budget import BudgetArrays, FunctionOfQuantities, budget_of
from imubayes_qualification.certificate.conformity import assess

ROOT = Path(__file__).parents[2]
NAMES = ["converter_gain_drift.slope[ax]", "accel_scale_factor.scale[ax]", "accel_bias.bias[ax]", "scale_factor[ax]"]
# No scatter between runs: contributions then depend on no scale that the data leave to its prior.  The prior is of the
# shipped form, so that its programs serve here as well.
TAU = "halfnormal(1e-3 noise)"


def fitted(out: Path | None = None, **priors: str) -> Result:
    model = read_model(ROOT / "models" / "accel-channel.toml")
    effects = tuple(
        replace(
            effect, prior={"tau": TAU} if effect.name == "run_scatter" else {**effect.prior, **_own(effect, priors)}
        )
        for effect in model.effects
    )
    return fit(load_campaign(ROOT / "data" / "accel-channel"), replace(model, effects=effects), out, sample=False)


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


BIAS, SOURCE = "accel_bias.bias[ax]", "injection_error.gain[ax]"
THERMOMETER, TIME_BASE = "converter_thermometer_error.offset[ramp-1g]", "output_time_base.gain[pulse/s]"


def recorded_otherwise(degrees: float = 0.0, share: float = 0.0) -> dict[str, float]:
    """Return the estimates by a record with another temperature of one run, or with all outputs larger by a share."""
    campaign = load_campaign(ROOT / "data" / "accel-channel")
    runs = []
    for run in campaign.runs:
        temperature = run.covariates["converter_temperature"] + degrees * (run.name == "ramp-1g")
        covariates = {**run.covariates, "converter_temperature": temperature}
        runs.append(replace(run, covariates=covariates, observed=run.observed * (1 + share)))
    model = read_model(ROOT / "models" / "accel-channel.toml")
    effects = tuple(
        replace(effect, prior={"tau": TAU}) if effect.name == "run_scatter" else effect for effect in model.effects
    )
    found = fit(replace(campaign, runs=tuple(runs)), replace(model, effects=effects), sample=False)
    return {line.name: line.mean or 0.0 for line in (*found.summary.parameters, *found.summary.derived)}


def test_an_instrument_of_which_nothing_is_stated_is_in_what_u_omits_with_its_effect_per_unit(result):
    """By a refit of a record with that error: a thermometer 0.5 °C off in one run, a counter 20 ppm slow."""
    exact = unit_with_budgets(result).exact
    inputs = {each.parameter: each for each in exact.inputs}
    assert {THERMOMETER, TIME_BASE} <= set(inputs)
    assert not any(inputs[name].included or inputs[name].stated for name in (THERMOMETER, TIME_BASE))
    assert {BIAS, SOURCE} <= {each.name for each in exact.unstated}
    own = recorded_otherwise()
    # True = recorded + δ: a record that is too high by 0.5 °C has δ = −0.5 °C, outputs too large by 20 ppm have 20 ppm.
    cases = ((THERMOMETER, BIAS, -0.5, {"degrees": 0.5}), (TIME_BASE, SOURCE, 20.0, {"share": 20e-6}))
    for parameter, quantity, size, change in cases:
        moved = recorded_otherwise(**change)[quantity] - own[quantity]
        assert moved == pytest.approx(inputs[parameter].sensitivity(quantity) * size, rel=0.02), parameter
        assert abs(moved) > 5, "µg, and ppm: what is nearly nothing would agree with anything"


def test_a_thermometer_with_a_stated_uncertainty_is_not_omitted(result):
    """0 is one that is stated: the run's temperature is exact, and no message says that it is not known."""
    campaign = result.fit.model.campaign
    runs = tuple(replace(run, converter_temperature_uncertainty=0.0) for run in campaign.runs)
    declared = bind(result.fit.model.spec, replace(campaign, runs=runs))
    plain = {each.effect for each in instrument_errors(result.fit)}
    assert plain >= {"converter_thermometer_error", "output_time_base"}
    stated = {each.effect for each in instrument_errors(replace(result.fit, model=declared))}
    assert plain - stated == {"converter_thermometer_error", "converter_thermometer_calibration"}


def bound_with(result: Result, **changed) -> Fit:
    """Return the fit with a campaign that states something else."""
    campaign = replace(result.fit.model.campaign, **changed)
    return replace(result.fit, model=bind(result.fit.model.spec, campaign))


def test_a_thermometer_that_runs_share_has_one_error_for_all(result):
    """What is not stated of it is omitted as one error, that of two runs alone being the sum of theirs."""
    campaign = result.fit.model.campaign
    alone = {each.name: each for each in instrument_errors(result.fit) if each.effect.startswith("converter_")}
    ramps = [run.name for run in campaign.runs if run.name.startswith("ramp")]
    runs = tuple(replace(run, converter_thermometer="Pt" if run.name in ramps else None) for run in campaign.runs)
    fit = bound_with(result, runs=runs, thermometers={"Pt": Thermometer("Pt")})
    shared = {each.name: each for each in instrument_errors(fit) if each.effect.startswith("converter_")}
    name = "converter_thermometer_calibration.{}[Pt]"
    assert shared.keys() - alone.keys() == {name.format("offset"), name.format("gain")}
    assert alone.keys() - shared.keys() >= {f"converter_thermometer_error.offset[{run}]" for run in ramps}
    offset = shared[name.format("offset")]
    summed = sum(alone[f"converter_thermometer_error.offset[{run}]"].column for run in ramps)
    np.testing.assert_allclose(offset.column, summed, rtol=1e-6, atol=1e-12)
    assert (offset.size, offset.unit, shared[name.format("gain")].unit) == (1.0, "degC", "%")
    half = bound_with(result, runs=runs, thermometers={"Pt": Thermometer("Pt", 0.0)})
    assert name.format("offset") not in {each.name for each in instrument_errors(half)}


def test_the_gain_of_a_thermometer_is_about_25_degrees_or_the_mean_of_its_run(result):
    """The response to a gain is that to an offset, times the distance from there in every row."""
    campaign, covariate = result.fit.model.campaign, "converter_temperature"
    place, run = next((k, each) for k, each in enumerate(campaign.runs) if np.ptp(each.covariates[covariate]) > 10)
    read = run.covariates[covariate]
    runs = tuple(replace(each, converter_thermometer="Pt") if each is run else each for each in campaign.runs)
    calibration = "converter_thermometer_calibration"
    named = bound_with(result, runs=runs, thermometers={"Pt": Thermometer("Pt")})
    cases = ((result.fit, run.name, read.mean(), "converter_thermometer_error"), (named, "Pt", 25.0, calibration))
    for each, owner, centre, effect in cases:
        known, entries = {error.name: error.column for error in instrument_errors(each)}, each.model.entries
        own = entries.run == place
        expected = (read[entries.row[own]] - centre) * known[f"{effect}.offset[{owner}]"][own] / 100
        gain = known[f"{calibration}.gain[{owner}]"][own]
        np.testing.assert_allclose(gain, expected, rtol=1e-4, atol=1e-5 * np.max(np.abs(expected)))


def test_a_stated_uncertainty_of_the_time_base_is_in_u(result):
    """By hand: pulses of an injected current determine its gain, which has the relative error of the time base."""
    fitted_with = bound_with(result, instruments=Instruments(time_base=20e-6))
    layout = fitted_with.model.layout
    gradient = np.where(np.array(layout.names) == SOURCE, layout.parameters[layout.index(SOURCE)].prior_sd, 0.0)
    inputs = {each.effect: each for each in exact_equipment(fitted_with).found({SOURCE: gradient[None]}).inputs}
    base = inputs["output_time_base"]
    assert (base.included, base.stated, base.size) == (True, True, pytest.approx(20.0))
    assert abs(base.sensitivity(SOURCE)) == pytest.approx(1.0, rel=2e-3), "ppm per ppm"
    assert base.left == pytest.approx(20.0, rel=0.01)
    assert "output_time_base.gain[pulse/s]" in {each.parameter for each in uncertain_equipment(fitted_with)}
    exact = bound_with(result, instruments=Instruments(time_base=0.0))
    assert "output_time_base" not in {each.effect for each in (*instrument_errors(exact), *uncertain_equipment(exact))}


def test_a_quantity_has_one_uncertainty_in_summary_and_budget(accel_channel):
    """What the certificate contains of gravity, the fit says that it does not."""
    of_folder = load(accel_channel)
    found = unit_with_budgets(of_folder)
    lines = (*of_folder.summary.parameters, *of_folder.summary.derived, *of_folder.summary.combinations)
    own = {line.name: line.sd for line in lines if line.sd is not None}
    compared = [each for each in found.budgets.quantities if each.name in own]
    assert len(compared) > 10
    for each in compared:
        by_exact = sum(given.shift(each.name) ** 2 for given in found.exact.included)
        assert each.standard_uncertainty**2 == pytest.approx(own[each.name] ** 2 + by_exact, rel=1e-12), each.name
    exact = {shift.name for each in found.exact.included for shift in each.shifts}
    assert exact & own.keys()


def test_an_uncertainty_without_sampling_has_no_monte_carlo_error(result):
    """The variance by dense algebra, averaged over noise scales; the draws alone miss it by more than a per cent."""
    fit, name = result.fit, "mounting_error.y[pyramid]"
    place, problem = fit.model.layout.names.index(name), fit.model.problem
    variances = []
    for h in fit.posterior.points[::400, len(fit.z) :]:
        rows = whitened_columns(problem, h, fit.mode.about.jacobian)
        variances.append(np.linalg.inv(rows.T @ rows + np.diag(prior_widths(problem, h) ** -2.0))[place, place])
    exact = fit.model.layout.parameters[place].prior_sd * np.sqrt(np.mean(variances))
    assert result[name].sd == pytest.approx(exact, rel=1e-3)
    assert np.std(result.draws[name]) != pytest.approx(exact, rel=5e-3)
