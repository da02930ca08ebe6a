"""A covariate that a correction needs and a recording lacks is refused by name, or its effect is left in and named.

Each effect of the unit is alone in a model.  A recording lacks one covariate that the effect depends on.  Either the
effect is corrected by that covariate, and the recording is refused, or the correction never takes it out, and its whole
possible size is in the uncertainty: that the size is right is the law of `tests/qualification/test_left_in_law.py`.
Nothing is compiled.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from imubayes.effects.base import PlaceEffect, RecordEffect, SignalEffect
from imubayes.effects.shared_formulas import RunBias
from imubayes.inference.fitted_model import Fit
from imubayes.model.bind import Model
from imubayes.model.bound_effects import BoundEffect
from imubayes.results.result import Result
from imubayes.results.stored_tables import Residuals
from imubayes.results.summary import Summary
from imubayes_qualification.onboard.correct_recording import needed_temperatures, not_given
from imubayes_qualification.onboard.response import TEMPERATURES
from imubayes_qualification.onboard.unexpressed_effects import acts_linearly
from small_campaign import in_wide_campaign, whole_catalogue

# The effects of sensors and converters, and of where they sit, that the wide campaign shows.
NAMES = [
    one.name
    for one in in_wide_campaign()
    if issubclass(one, PlaceEffect | SignalEffect | RecordEffect)
    and not issubclass(one, RunBias)
    and "injection" not in one.needs
]


@cache
def of_the_unit() -> dict[str, BoundEffect]:
    return {each.name: each for each in whole_catalogue().assembly.effects if each.name in NAMES}


def alone(effect: BoundEffect) -> Result:
    """Return a result whose unit has this effect only."""
    model: Model = whole_catalogue()
    changed = replace(model, assembly=replace(model.assembly, effects=(effect,)))
    fit = Fit(changed, np.zeros(len(model.layout)), np.zeros(len(model.hyper_layout)), True)
    return Result(Summary.model_construct(converged=True), Residuals.__new__(Residuals), None, _fit=fit)


def lacking_is_noticed(effect: BoundEffect, covariate: str) -> bool:
    """Return whether a recording without a covariate is refused, or the effect is left in as undetermined."""
    asked = needed_temperatures(alone(effect), whole_catalogue().campaign.channels)
    if covariate in asked:
        issue = not_given(covariate, "recording.csv")
        return covariate.replace("_", " ") in issue.what and bool(issue.remedy)
    return not acts_linearly(effect)


def test_there_are_effects_of_both_kinds():
    effects = of_the_unit()
    assert len(effects) > 40
    linear = {name for name, each in effects.items() if acts_linearly(each)}
    assert {"gyro_bias_temperature", "gyro_g_sensitivity", "converter_gain_drift"} <= linear
    assert {"gyro_thermal_lag", "accel_vibration_rectification", "gyro_warm_up"} <= set(effects) - linear


@pytest.mark.parametrize("name", NAMES)
def test_a_covariate_that_is_missing_is_refused_or_left_in(name):
    effect = of_the_unit()[name]
    for covariate in effect.effect_class.needs:
        assert lacking_is_noticed(effect, covariate), covariate
    # What is corrected row by row depends on nothing that no row determines.
    if acts_linearly(effect):
        assert set(effect.effect_class.needs) <= set(TEMPERATURES)


def test_an_effect_that_hides_what_it_needs_is_found():
    """Fault planted: a temperature effect that is corrected, of which the correction does not know the temperature."""
    effect = of_the_unit()["gyro_bias_temperature"]
    hidden = type("Hidden", (effect.effect_class,), {"needs": ()})
    assert lacking_is_noticed(effect, "temperature")
    assert not lacking_is_noticed(replace(effect, effect_class=hidden), "temperature")
