"""A diagnosis says one thing once: one prediction of a coefficient, the covariate of the effect that is named, an order
that the table shows, and one sum of probabilities.

Records made by hand: what is tested is how they are put together.
"""

from typing import Any

import numpy as np
import pytest

from imubayes.criticism.diagnosis_record import (
    CoefficientEstimate,
    Diagnosis,
    EffectGroup,
    RankedEffect,
    ScreenedEffect,
)
from imubayes.criticism.residual_evidence import _following, input_times
from imubayes.effects import EFFECTS
from imubayes.loop import model_changes
from imubayes.loop.warm_start import ChangedModel
from imubayes.responses.residual_covariates import ResidualCovariate

PPM = "ppm"


def made[Kind](kind: type[Kind], **fields: Any) -> Kind:
    """Return a record of which only these fields are read."""
    found = object.__new__(kind)
    for name, value in fields.items():
        object.__setattr__(found, name, value)
    return found


def test_what_is_added_alone_is_predicted_as_the_diagnosis_did() -> None:
    """The linear model from the start of the refit is another approximation of the same coefficient."""
    told = CoefficientEstimate(name="lag.coefficient[gx]", value=248.72, sd=0.63, unit=PPM)
    linear = CoefficientEstimate(name="lag.coefficient[gx]", value=217.0, sd=36.0, unit=PPM)
    screened = RankedEffect(
        effect="lag", channels=("gx",), probability=0.99, delta_chi2=90.0, shape={}, coefficients=(told,), log_odds=40.0
    )
    extension = made(ChangedModel, delta_chi2=80.0, coefficients=(linear,))
    assert model_changes._predicted_coefficients(extension, screened, True) == (told,)
    # Beside others its coefficient is another one: no diagnosis has estimated that.
    assert model_changes._predicted_coefficients(extension, screened, False) == (linear,)


def covariate(name: str, values: np.ndarray) -> ResidualCovariate:
    return ResidualCovariate(name, "", values, name)


def test_the_covariate_that_is_told_is_one_of_the_effect() -> None:
    """Rates in rising order go with the time; of an effect that depends on the rate the rate is reported."""
    rate = np.linspace(-1.0, 1.0, 60)
    time = covariate("time", np.arange(60.0))
    [member] = [each for each in EFFECTS if each.name == "gyro_scale_quadratic"]
    known = [time, covariate("rate_i", rate)]
    found = _following(member.name, member, "gyro", rate**2, known)
    assert found is not None
    assert found.name == "rate_i"
    # Of an effect that depends on neither, none is reported, however well it follows.
    [other] = [each for each in EFFECTS if each.name == "gyro_bias_temperature"]
    assert _following(other.name, other, "gyro", rate**2, known) is None


@pytest.mark.parametrize("scatter", [0.0, 5.0])
def test_an_input_times_a_function_of_a_covariate_is_seen_as_such(scatter: float) -> None:
    random = np.random.default_rng(1)
    rate, temperature = random.uniform(-1, 1, 200), random.uniform(-40, 60, 200)
    response = rate * (temperature / 50 + (temperature / 50) ** 2) + scatter * random.normal(size=200)
    known = [covariate("rate_i", rate), covariate("temperature_degC", temperature)]
    found = input_times(response, "gyro", known)
    assert (found is not None) == (scatter == 0)
    if found is not None:
        assert found.covariate.name == "temperature_degC"
        np.testing.assert_array_equal(found.input, rate)


def test_a_coefficient_of_a_group_is_that_of_the_diagnosis() -> None:
    """`estimate` prefers the member of a group, whose coefficient is beside the other groups."""
    facts: Any = {"effect": "lag", "channels": ("gx",), "probability": 1.0, "delta_chi2": 90.0, "shape": {}}
    member = ScreenedEffect(coefficients=(), **facts)
    line = RankedEffect(coefficients=(), log_odds=40.0, **facts)
    group = made(EffectGroup, candidates=(member,))
    found = Diagnosis(verdict="missing_effect").model_copy(update={"groups": (group,), "ranking": (line,)})
    assert found.estimate("lag") is member
    assert found.channels_for("lag") == ("gx",)
    assert found.estimate("other") is None
    assert Diagnosis(verdict="adequate", ranking=(line,)).estimate("lag") is line
