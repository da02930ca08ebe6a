"""Effects that the runs could not show, in a mission: a closed form, and a unit that has one, fitted without it."""

import math
from dataclasses import replace

import numpy as np
import pytest

from imubayes.criticism.diagnosis_record import Diagnosis, UndetectableEffect
from imubayes.display.layout import report_text
from imubayes.foundations.campaign_data import Campaign
from imubayes.inference.run_fit import joint_fit
from imubayes.model.bind import bind
from imubayes.model.model_file import EffectSpec
from imubayes.results.result import Result, result_of
from imubayes_qualification.display.onboard.navigation import navigation_report
from imubayes_qualification.onboard.constants import body_inputs, onboard_constants
from imubayes_qualification.onboard.effects_not_shown import effects_not_shown
from imubayes_qualification.onboard.navigation_impact import (
    HiddenEffects,
    NavigationImpact,
    level_mission,
    motion_of,
    navigation_impact,
)
from imubayes_qualification.onboard.record import OnboardConstants
from small_campaign import ACCEL_SCALE, GRAVITY, LATITUDE, campaign, simulated, spec

MISSION = level_mission(60.0, LATITUDE)
PLAIN = ("gyro_bias", "gyro_scale_factor", "accel_bias", "accel_scale_factor")
QUADRATIC, SLOPE = 50e-6 / GRAVITY, 100e-6 * GRAVITY  # per m/s², m/s² per °C


def without_temperature() -> Campaign:
    known = campaign()
    runs = [
        replace(run, covariates={name: each for name, each in run.covariates.items() if "temperature" not in name})
        for run in known.runs
    ]
    return replace(known, runs=tuple(runs))


def fitted(planted: EffectSpec | None = None) -> Result:
    """Return the fit of the plain model to a unit that may have an effect beside; the noise is the same."""
    plain = spec(*PLAIN)
    truth = plain if planted is None else replace(plain, effects=(*plain.effects, planted))
    model = bind(truth, without_temperature())
    readings = simulated(model, np.zeros(len(model.layout)), 4)
    return result_of(joint_fit(bind(plain, readings), None))


@pytest.fixture(scope="module")
def unit() -> tuple[Result, OnboardConstants]:
    result = fitted()
    return result, onboard_constants(result)


def hidden_in(unit: tuple[Result, OnboardConstants], *effects: str, temperature: float | None = None) -> HiddenEffects:
    listed = tuple(UndetectableEffect(effect=effect, reason="not_supplied") for effect in effects)
    diagnosis = Diagnosis(verdict="adequate", undetectable=listed)
    return effects_not_shown(*unit, diagnosis, motion_of(MISSION), temperature)


def impact(unit: tuple[Result, OnboardConstants], hidden: HiddenEffects | None) -> NavigationImpact:
    return navigation_impact(unit[1], MISSION, "test", aided_height=False, hidden=hidden)


@pytest.mark.slow
def test_a_bias_over_temperature_moves_by_half_of_its_size_times_the_square_of_time(unit):
    hidden = hidden_in(unit, "accel_bias_temperature", temperature=35.0)
    found, without = impact(unit, hidden), impact(unit, None)
    (effect,) = found.not_shown
    moved = 0.5 * 10 * SLOPE * 60.0**2
    assert (effect.source, effect.kind, effect.size) == ("accel_bias_temperature", "accelerometer", 100.0)
    assert effect.horizontal_m == pytest.approx(math.sqrt(2) * moved, rel=2e-3)
    assert effect.vertical_m == pytest.approx(moved, rel=2e-3)
    assert effect.attitude_rad == 0.0
    # It is in no other number.
    assert found.errors == without.errors
    assert found.sources == without.sources


def test_what_the_fit_takes_up_of_an_effect_is_counted(unit, monkeypatch):
    (seen,) = hidden_in(unit, "accel_quadratic").effects
    assert seen.size < 10.0  # these runs would show the largest size that is met
    monkeypatch.setattr("imubayes_qualification.onboard.effects_not_shown._SHOWN", math.inf)
    (found,) = hidden_in(unit, "accel_quadratic").effects
    assert found.size == 50.0
    other = fitted(EffectSpec("accel_quadratic", prior={"quadratic": "normal(50 ug/g^2, 0.0001 ug/g^2)"}))
    force = motion_of(MISSION).body_force[:1]
    read = []
    for constants, size in ((unit[1], 0.0), (onboard_constants(other), QUADRATIC)):
        felt = force + size * force**2
        outputs = {name: ACCEL_SCALE * felt[:, place] for place, name in enumerate(("ax", "ay", "az"))}
        triads = {each.kind: each for each in constants.triads if each.kind == "accelerometer"}
        read.append(body_inputs(triads, outputs, np.full((1, 2), 25.0), 25.0)["accelerometer"][0])
    by_coefficients = found.error[0, 3:].sum(axis=1)
    assert by_coefficients == pytest.approx(read[1] - read[0], rel=0.02, abs=1e-3 * QUADRATIC * GRAVITY**2)
    # Across gravity the effect itself does nothing: there all of it is what the bias took up.
    assert abs(force[0, 0]) < 1e-3
    assert by_coefficients[0] < -0.2 * QUADRATIC * GRAVITY**2


def test_what_is_not_known_of_a_mission_is_named_and_equipment_is_left_out(unit):
    hidden = hidden_in(
        unit, "accel_bias_temperature", "gyro_thermal_lag", "accel_dead_zone", "injection_error", "table_rate_error"
    )
    assert hidden.effects == ()
    assert {each.effect: each.needs for each in hidden.left} == {
        "accel_bias_temperature": ("temperature",),
        "gyro_thermal_lag": ("temperature", "temperature_rate"),
        "accel_dead_zone": (),
    }
    told = report_text(navigation_report(impact(unit, hidden)))
    assert "accel_bias_temperature (needs temperature, see --temperature)" in " ".join(told.split())
    assert "imubayes diagnose" not in told


def test_without_a_diagnosis_the_command_that_makes_one_is_named(unit):
    found = impact(unit, None)
    assert not found.diagnosed
    assert "`imubayes diagnose RESULT` lists these effects" in report_text(navigation_report(found))
