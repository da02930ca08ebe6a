"""Effects that `apply` leaves in: named, with the size that they have in the campaign of the fit."""

import numpy as np
import pytest

from imubayes.inference.run_fit import joint_fit
from imubayes.model.bind import bind
from imubayes.model.model_file import EffectSpec, ModelSpec
from imubayes.results.result import Result, result_of
from imubayes_qualification.display.corrected_readings import correction_lines
from imubayes_qualification.onboard.correct_recording import RowTally, correction_of
from imubayes_qualification.onboard.recording_files import CorrectedRecording
from imubayes_qualification.onboard.response import sensor_posterior
from imubayes_qualification.onboard.unexpressed_effects import input_ranges, unexpressed_effects
from small_campaign import GRAVITY, simulated, wide_campaign

WIDTH, COEFFICIENT, TAU = 100e-6 * GRAVITY, 300e-6 * GRAVITY, 1000.0
# Their values are known beforehand, so that the sizes are, too.
MODEL = ModelSpec(
    "left in",
    (
        EffectSpec("accel_bias"),
        EffectSpec("accel_scale_factor"),
        EffectSpec("accel_quadratic", prior={"quadratic": "normal(200 ug/g^2, 0.1 ug/g^2)"}),
        EffectSpec("accel_dead_zone", prior={"half_width": "lognormal(100 ug, 0.01)"}),
        EffectSpec(
            "accel_thermal_lag",
            prior={"coefficient": "normal(300 ug/degC, 1 ug/degC)", "tau": "lognormal(1000 s, 0.001)"},
        ),
        EffectSpec("white_noise"),
    ),
)


@pytest.fixture(scope="module")
def result() -> Result:
    model = bind(MODEL, wide_campaign())
    readings = simulated(model, np.zeros(len(model.layout)), 4)
    return result_of(joint_fit(bind(MODEL, readings), None))


def largest_lag() -> float:
    """Largest T − T_τ of all runs, °C: temperature is linear from row to row, for which the lag is exact."""
    largest = 0.0
    for run in wide_campaign().runs:
        if "time" not in run.covariates or "temperature" not in run.covariates:
            continue
        lag = 0.0
        for step, change in zip(np.diff(run.covariates["time"]), np.diff(run.covariates["temperature"]), strict=True):
            decay = np.exp(-step / TAU)
            lag = lag * decay + change / step * TAU * (1 - decay)
            largest = max(largest, abs(lag))
    return largest


@pytest.mark.slow
def test_effects_with_memory_or_limit_are_named_with_their_size(result):
    correction = correction_of(result, ("gx", "gy", "gz", "ax", "ay", "az"), "recording")
    found = {each.effect: each for each in correction.left_in}
    assert set(found) == {"accel_dead_zone", "accel_thermal_lag"}
    assert {each.cause for each in found.values()} == {"limit", "memory"}
    zone, lag = found["accel_dead_zone"], found["accel_thermal_lag"]
    assert zone.size == pytest.approx(WIDTH, rel=0.03)
    assert lag.size == pytest.approx(COEFFICIENT * largest_lag(), rel=0.03)
    assert zone.size is not None
    assert zone.sd is not None
    assert zone.sd < 0.05 * zone.size
    assert lag.channels == ("ax", "ay", "az")
    assert correction_of(result, ("gx", "gy", "gz"), "recording").left_in == ()
    lines = correction_lines(CorrectedRecording(("accelerometer",), RowTally(rows=3), {}, (), tuple(found.values())))
    (said,) = [line for line in lines if "accel_thermal_lag" in line]
    assert "left in (it depends on earlier rows)" in said
    assert f"up to {lag.size:.2g}" in said


@pytest.mark.slow
def test_what_constants_cannot_express_has_the_size_of_its_nonlinear_part(result):
    """A quadratic term at the largest input; bias and scale factor are linear, and no constant leaves them out."""
    spans = input_ranges(result.fit.model.campaign)
    found = {each.effect: each for each in unexpressed_effects(result, sensor_posterior(result), spans)}
    assert not {"accel_bias", "accel_scale_factor"} & set(found)
    quadratic = found["accel_quadratic"]
    assert quadratic.size is not None
    assert quadratic.cause == "nonlinear"
    # K₂ a², with K₂ in µg/g² of the local g.
    assert quadratic.size == pytest.approx(200e-6 * spans["accelerometer"] ** 2 / GRAVITY, rel=0.02)
    assert quadratic.sd is not None
    assert quadratic.sd < 0.01 * quadratic.size
