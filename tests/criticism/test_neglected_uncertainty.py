"""Uncertainties of the equipment that a model takes as exact are reported with their effect on the estimates."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from null_data import ROOT, refitted

from imubayes.campaign import load_campaign
from imubayes.criticism.diagnose import judge
from imubayes.display.loop.diagnosis_report import next_command
from imubayes.display.loop.diagnosis_sentences import sentence
from imubayes.inference.fitted_model import Fit
from imubayes.inference.nested_laplace import posterior_precision
from imubayes.inference.posterior_mode import find_mode
from imubayes.model.bind import bind
from imubayes.model.model_file import EffectSpec, read_model
from imubayes.responses.uncertain_equipment import uncertain_equipment
from imubayes_qualification.budgets.taken_as_exact import ExactInput, exact_equipment, included_shifts, with_included


@cache
def fitted(ppm: float, gravity: float | None = None) -> Fit:
    """Return the fit of a campaign whose table rate is known to so many ppm, by a model that takes it as exact.

    Gravity is known to so many µg; None if that is not stated.
    """
    spec = read_model(ROOT / "models" / "hidden-effects.toml")
    spec = replace(spec, effects=tuple(each for each in spec.effects if each.name != "table_rate_error"))
    campaign = load_campaign(ROOT / "data" / "hidden-none")
    tables = {name: replace(table, rate_uncertainty=ppm * 1e-6) for name, table in campaign.tables.items()}
    stated = None if gravity is None else gravity * 1e-6 * campaign.site.gravity
    site = replace(campaign.site, gravity_uncertainty=stated)
    declared = bind(spec, replace(campaign, tables=tables, site=site))
    found = refitted(declared, *(np.zeros(size) for size in declared.problem.size))
    assert found.converged
    return found


def sd(at: Fit, place: int) -> float:
    """Return the posterior standard deviation of a parameter in z, by the inverse of the precision."""
    mode = find_mode(at.model.problem, at.z, at.h)
    return float(np.sqrt(np.linalg.inv(np.asarray(posterior_precision(at.model.problem, mode)))[place, place]))


def gravity_of(at: Fit, scale: str) -> tuple[ExactInput | None, float]:
    """Return gravity as it is taken as exact, and what is in no uncertainty of a scale factor."""
    layout = at.model.layout
    place = layout.names.index(scale)
    gradient = np.zeros((1, len(layout)))
    gradient[0, place] = layout.parameters[place].prior_sd
    found = exact_equipment(at).found({scale: gradient})
    unstated = {each.name: each.value for each in found.unstated}
    return next((each for each in found.inputs if each.effect == "gravity_anomaly"), None), unstated.get(scale, 0.0)


@pytest.mark.parametrize(
    ("stated", "excess", "size", "included"),
    [
        (None, 0.0, 50.0, True),  # normal gravity
        (None, 1e-4, 50.0, False),  # measured, nobody says how well
        pytest.param(20.0, 1e-4, 20.0, True, marks=pytest.mark.slow),
        pytest.param(0.0, 0.0, 0.0, False, marks=pytest.mark.slow),  # exact, and stated so
    ],
)
def test_gravity_is_as_uncertain_as_the_way_it_was_got(stated, excess, size, included):
    at, scale = fitted(1e-3), "accel_scale_factor.scale[ax]"
    campaign = at.model.campaign
    known = None if stated is None else stated * 1e-6 * campaign.site.gravity
    site = replace(campaign.site, gravity=campaign.site.gravity + excess, gravity_uncertainty=known)
    declared = bind(at.model.spec, replace(campaign, site=site))
    gravity, unstated = gravity_of(replace(at, model=declared), scale)
    if not size:
        assert gravity is None
        return
    assert gravity is not None
    assert gravity.size == pytest.approx(size, rel=1e-3)
    assert (gravity.stated, gravity.included) == (stated is not None, included)
    assert abs(gravity.shift(scale)) == pytest.approx(size, rel=0.05)
    # What is in no uncertainty may decide nothing.
    assert (unstated > 40) == (not included)


@pytest.mark.slow  # a second fit; the shifts have their sizes in the other tests at every run
def test_what_is_included_is_what_a_fit_finds_that_knows_of_it():
    at, scale = fitted(1e-3), "accel_scale_factor.scale[ax]"
    gravity, _ = gravity_of(at, scale)
    assert gravity is not None
    spec = replace(at.model.spec, effects=(*at.model.spec.effects, EffectSpec("gravity_anomaly", where="gravity")))
    declared = bind(spec, at.model.campaign)
    within = refitted(declared, *(np.zeros(size) for size in declared.problem.size))

    def deviation(each: Fit) -> float:
        place = each.model.layout.names.index(scale)
        return sd(each, place) * each.model.layout.parameters[place].prior_sd

    own, known = deviation(at), deviation(within)
    assert known > 5 * own, "a law that could not fail"
    assert np.hypot(own, gravity.shift(scale)) == pytest.approx(known, rel=0.03)


def test_what_apply_and_export_contain_moves_the_parameters_as_it_would():
    """A stated rate error of 20 ppm is in every gyro scale factor, 50 µg of gravity in every one of accelerometers."""
    at = fitted(20.0)
    listed = {each.effect: each for each in uncertain_equipment(at)}
    assert (listed["table_rate_error"].stated, listed["gravity_anomaly"].stated) == (True, False)
    assert listed["table_rate_error"].size == pytest.approx(20.0)
    layout = at.model.layout
    for each, shift in included_shifts(at):
        family = {"table_rate_error": "gyro_scale_factor.scale", "gravity_anomaly": "accel_scale_factor.scale"}
        own = [place for place, name in enumerate(layout.names) if name.startswith(family[each.effect])]
        sizes = [abs(shift[place]) * layout.parameters[place].prior_sd for place in own]
        np.testing.assert_allclose(sizes, each.size, rtol=0.05)
    # Draws keep their mean, and those of one cause move together.
    normal = np.random.default_rng(1).normal(size=(500, len(layout)))
    draws, matters = with_included(normal, included_shifts(at))
    assert {each.effect for each in matters} <= set(listed)
    np.testing.assert_allclose(draws.mean(axis=0), normal.mean(axis=0), atol=1e-12)
    # Stated to be exact, nothing is contained.
    exact = replace(at.model.campaign.site, gravity_uncertainty=0.0)
    tables = {name: replace(each, rate_uncertainty=0.0) for name, each in at.model.campaign.tables.items()}
    declared = bind(at.model.spec, replace(at.model.campaign, site=exact, tables=tables))
    assert uncertain_equipment(replace(at, model=declared)) == ()


@pytest.mark.slow
def test_a_table_rate_taken_as_exact_is_told():
    at = fitted(20.0)
    found = judge(at)
    (neglected,) = found.neglected
    assert (neglected.effect, neglected.unit) == ("table_rate_error", "ppm")
    assert neglected.value == pytest.approx(20.0)
    assert neglected.shifts.startswith("gyro_scale_factor.scale")
    # A rate in error is a scale factor error of the same size: the shift is that over its standard deviation.
    place = at.model.layout.names.index(neglected.shifts)
    scale = at.model.layout.parameters[place].prior.sd() * 1e6
    assert neglected.in_sd == pytest.approx(20.0 / (scale * sd(at, place)), rel=0.05)
    assert "No interval includes table_rate_error" in sentence(found)
    assert found.verdict == "adequate"
    assert found.suggested is None
    assert found.proposed is not None
    assert found.proposed.effects == ("table_rate_error",)
    assert next_command(found).startswith("imubayes add table_rate_error --to")


@pytest.mark.slow
def test_what_hardly_matters_is_not_told():
    at = fitted(1e-3)
    found = judge(at)
    assert not found.neglected
    assert found.proposed is None
    assert "No interval includes table_rate_error" not in sentence(found)
    # Nothing is stated of gravity: what its largest typical error would do is reported.
    worst = found.most_biasing
    assert worst is not None
    assert (worst.coefficient, worst.size, worst.size_unit) == ("gravity_anomaly.anomaly[all]", 300.0, "ug")
    # Gravity in error by 300 µg is a scale factor error of 300 ppm.
    place = at.model.layout.names.index(worst.parameter)
    assert worst.parameter.startswith("accel_scale_factor.scale")
    scale = at.model.layout.parameters[place].prior.sd() * 1e6
    # The diagnosis counts in the noise known beforehand, the posterior in the noise as fitted.
    assert abs(worst.in_sd) == pytest.approx(300.0 / (scale * sd(at, place)), rel=0.15)
    assert "gravity_anomaly.anomaly[all] at its largest typical size, 300 µg, would bias accel_scale" in sentence(found)


@pytest.mark.slow
@pytest.mark.parametrize(("gravity", "told"), [(20.0, True), (0.0, False)])
def test_gravity_that_the_campaign_states_is_told_by_its_uncertainty(gravity, told):
    found = judge(fitted(1e-3, gravity))
    assert ([each.effect for each in found.neglected] == ["gravity_anomaly"]) == told
    assert ("No interval includes gravity_anomaly" in sentence(found)) == told
    assert found.most_biasing is None or "gravity" not in found.most_biasing.coefficient
