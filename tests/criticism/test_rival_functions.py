"""Where the levels of its input do not determine the form of an effect, it is not named alone."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from null_data import fitted_to, redrawn
from scipy.integrate import cumulative_trapezoid, solve_ivp

from imubayes.criticism import stepwise_search, unlisted_causes
from imubayes.responses.candidate_effects import candidate_responses
from imubayes.criticism.diagnose import judge
from imubayes.criticism.equivalent_effects import EquivalenceGroup
from imubayes.criticism.localised_structure import Feature, FeatureScan, FeatureSet
from imubayes.adequacy.projection import project
from imubayes.responses.residual_covariates import ResidualCovariate
from imubayes.criticism.rival_functions import drifts_of_series
from imubayes.criticism.score_test import project_responses
from imubayes.criticism.stepwise_search import SearchResult
from imubayes.effects import EFFECTS

ABSENT = ("converter_nonlinearity", "converter_gain_temperature_rate")


def test_a_saturation_is_not_certain_where_three_levels_of_the_input_do_not_tell_its_form(monkeypatch):
    """A converter loses gain by the square of its input: a saturation or a cube is alike at 0.6, 1 and 12 g."""
    fitted = fitted_to("accel-channel", "accel-channel")
    responses = candidate_responses(fitted)
    at = project(fitted, responses.misfit, responses.jacobian)
    [truth] = [each for each in project_responses(at, responses.candidates) if each.response.scan.effect == ABSENT[0]]
    size = -20 / np.linalg.norm(truth.projected[:, 1])
    planted = redrawn(fitted, 21, change=truth.response.columns[:, 1] * size)

    def lacking(fit: Any, *more: Any) -> Any:
        found = candidate_responses(fit, *more)
        return replace(found, candidates=tuple(each for each in found.candidates if each.scan.effect not in ABSENT))

    monkeypatch.setattr(stepwise_search, "candidate_responses", lacking)
    found = stepwise_search.search(planted)
    [group, *_] = found.groups
    assert group.effects == ("converter_saturation",)
    assert ["force_i"] in [[label.name for label in each] for each in unlisted_causes.unlisted_causes(found, group)]
    # Planted fault: neither other curves of the input nor the forms are compared.
    monkeypatch.setattr(unlisted_causes, "rival_scans", lambda at: [])
    monkeypatch.setattr(unlisted_causes, "_undetermined_forms", lambda same: [])
    assert unlisted_causes.unlisted_causes(found, group) == ()


@pytest.mark.parametrize(("levels", "told"), [((-1.0, 1.0), False), ((-2.0, -1.0, 0.0, 1.0, 2.0), True)])
def test_a_form_is_determined_by_enough_levels(levels, told):
    """Of −1 and 1 a line and a cube are alike; of five levels they are not."""
    x = np.repeat(levels, 10)
    covariate = ResidualCovariate("rate_i", "deg/s", x, "rate along the input axis")
    line, cube = (Feature((covariate,), "power", (place,), f"Ω{place}", plain=True) for place in (0, 1))
    whole = FeatureSet(("g",), (np.arange(len(x)),), (np.stack([x, x**3], axis=1),), (line, cube))
    scan = FeatureScan(whole, np.zeros((len(x), 0)), ())
    same = [(scan, form) for form in (line, cube) if unlisted_causes._is_one_of(scan, form, x[:, None])]
    assert (unlisted_causes._undetermined_forms(same) == []) == told


@pytest.mark.parametrize(
    ("effects", "small", "expected"),
    [
        (("accel_scale_temperature",), True, [["temperature_degC"]]),
        (("accel_bias_temperature",), True, [["temperature_degC", "force_i"]]),
        (("accel_bias_temperature",), False, []),
        (("accel_scale_temperature", "accel_bias_temperature"), True, []),
        (("gyro_g_sensitivity",), True, []),
    ],
)
def test_a_function_that_leaves_out_a_covariate_or_adds_the_input_is_a_rival(monkeypatch, effects, small, expected):
    """What coincides at one force: ΔT, ΔT·f_i and f_i; which of them is new depends on what is in the group."""
    temperature, force = (ResidualCovariate(name, "", np.zeros(1), name) for name in ("temperature_degC", "force_i"))
    same = [Feature(each, "power", (0,)) for each in ((temperature,), (temperature, force), (force,))]
    # The scale factor takes up what goes with the force alone.
    same = same[:2] if effects[0].startswith("accel") else same[2:]
    kind = "gyro" if effects[0].startswith("gyro") else "accelerometer"
    registry = SimpleNamespace(effects={member.name: member for member in EFFECTS})
    campaign = SimpleNamespace(channels=[SimpleNamespace(name="a", kind=kind)])
    fitted = SimpleNamespace(model=SimpleNamespace(registry=registry, campaign=campaign))
    found, group = Mock(spec=SearchResult), Mock(spec=EquivalenceGroup)
    found.first = SimpleNamespace(projection=SimpleNamespace(fitted=fitted))
    group.leader, group.effects = SimpleNamespace(owners=("a",)), effects
    monkeypatch.setattr(unlisted_causes, "may_scale", lambda *_: small)
    rivals = unlisted_causes._of_other_covariates(found, group, same)
    assert [[covariate.name for covariate in each.covariates] for each in rivals] == expected


@pytest.mark.slow
@pytest.mark.parametrize(("looked", "verdict"), [(True, "equivalent_effects"), (False, "missing_effect")])
@pytest.mark.parametrize(
    ("absent", "other"),
    [
        ("accel_bias_temperature", "accel_scale_temperature"),
        ("accel_scale_temperature", "accel_bias_temperature"),
    ],
)
def test_an_effect_over_temperature_is_not_certain_at_one_force(monkeypatch, absent, other, looked, verdict):
    """The unit warms in runs of one force along ay: a bias and a scale factor over temperature look the same there."""
    fitted = fitted_to("rotation-modulation", "rotation-modulation")
    responses = candidate_responses(fitted)
    at = project(fitted, responses.misfit, responses.jacobian)
    [truth] = [each for each in project_responses(at, responses.candidates) if each.response.scan.effect == absent]
    place = [coefficient.owner for coefficient in truth.response.coefficients].index("ay")
    size = 40 / np.linalg.norm(truth.projected[:, place])
    planted = redrawn(fitted, 5, change=truth.response.columns[:, place] * size)

    def lacking(fit: Any, *more: Any) -> Any:
        found = candidate_responses(fit, *more)
        return replace(found, candidates=tuple(each for each in found.candidates if each.scan.effect != absent))

    monkeypatch.setattr(stepwise_search, "candidate_responses", lacking)
    if not looked:
        monkeypatch.setattr(unlisted_causes, "_of_other_covariates", lambda *rest: [])
    found = judge(planted)
    assert found.verdict == verdict
    assert found.groups[0].effects == (other,)


def test_a_drift_is_carried_through_the_motion_of_the_table_that_it_drives():
    """A tenth of the table's rate depends on its angle; a small drift with cos 3φ is added, and both are integrated."""
    time = np.linspace(0.0, 24.0, 4801)

    def angle(small: float) -> np.ndarray:
        found = solve_ivp(
            lambda _, phi: 0.2625 + 0.026 * np.cos(phi) - 0.01 * np.sin(2 * phi) + small * np.cos(3 * phi),
            (0.0, 24.0), [0.3], t_eval=time, rtol=1e-12, atol=1e-13,
        )  # fmt: skip
        return found.y[0]

    change = (angle(1e-6) - angle(-1e-6)) / 2e-6
    told = drifts_of_series(angle(0.0), time)[:, 5]
    assert np.abs(told - change).max() < 1e-4 * np.abs(change).max()
    # Planted fault: the integral alone, as if the rate did not depend on the angle.
    alone = cumulative_trapezoid(np.cos(3 * angle(0.0)), time, initial=0)
    assert np.abs(alone - change).max() > 0.02 * np.abs(change).max()
