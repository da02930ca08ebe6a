"""The effect that makes a classical estimate differ from the joint one is named: an asymmetry, or the seat."""

from dataclasses import replace

import numpy as np
import polars as pl
import pytest

import small_campaign as small
from imubayes.display.classical_comparison import compare_classical, discrepancy_sheet, of_prediction
from imubayes.display.loop.effects_behind import effects_behind
from imubayes.inference.fitted_model import Fit
from imubayes.model.bind import bind
from imubayes.model.derived_quantities import evaluate_derived
from imubayes.model.problem import predict
from imubayes.procedures import classical
from imubayes.results.summary import DerivedSummary, Summary

ASYMMETRY, TILT = 300e-6, 100 * small.ARCSEC
RATES = np.array([0.0, -100.0, -50.0, -20.0, -10.0, 0.0])
# A straight line through |Ω| at rates of one sign, less the slope on the positive side, which is quoted; the tilt about
# x of a body whose diagonal is the axis, which moves cos θ of y and z by as much.
SLOPE = np.polyfit(RATES[1:-1], np.abs(RATES[1:-1]), 1)[0]
EXPECTED = {"gyro_scale_asymmetry": ASYMMETRY * abs(SLOPE - 1), "mounting_error": TILT}


def one_way():
    """Return the campaign with its rate run in the pyramid alone, turned backward only."""
    whole = small.campaign()
    run = next(run for run in whole.runs if run.name == "rate-pyramid")
    backward = {**run.covariates, "table_rate": RATES * small.DEGREE}
    return replace(whole, runs=(replace(run, covariates=backward),))


@pytest.mark.parametrize("cause", EXPECTED)
def test_the_cause_is_named(cause):
    model = bind(small.spec("mounting_error", "gyro_bias", "gyro_scale_factor", "gyro_scale_asymmetry"), one_way())
    truth = np.zeros(len(model.layout))
    for place, parameter in enumerate(model.layout.parameters):
        if parameter.effect == cause and (cause != "mounting_error" or parameter.field == "x"):
            truth[place] = (ASYMMETRY if cause == "gyro_scale_asymmetry" else TILT) / parameter.factor
    z = model.layout.z_of(truth)
    campaign = small.simulated(model, z, 0)
    entries = model.entries
    table = pl.DataFrame({
        "run": ["rate-pyramid"] * len(entries), "row": entries.row, "predicted": np.asarray(predict(model.problem, z)),
        "channel": np.array([channel.name for channel in campaign.channels])[entries.channel],
    })  # fmt: skip
    fit = Fit(model, z, np.zeros(len(model.hyper_layout)), True)
    derived = evaluate_derived(fit.derived.derivation, model.problem, z[None])[0]
    joint = tuple(
        DerivedSummary(name=name.name, unit=name.unit, mean=value, sd=1e-3)
        for name, value in zip(fit.derived.names, derived.tolist(), strict=True)
    )
    summary = Summary.model_construct(derived=joint, parameters=(), combinations=())
    compared = compare_classical(classical(campaign), summary, of_prediction(campaign, table, summary))
    compared = compared.with_causes(effects_behind(fit, table, summary))
    known = [each for each in compared.estimates if each.causes]
    assert known
    for each in known:
        assert [name for name, _ in each.causes] == [cause]
        assert each.causes[0][1] == pytest.approx(each.difference, rel=0.1)
    assert max(abs(each.difference) for each in known) == pytest.approx(1000 * EXPECTED[cause], rel=0.1)
    assert f"neglects {cause}" in discrepancy_sheet(compared).note
