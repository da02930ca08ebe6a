"""Binding a model to a campaign: errors in four parts, names, units and priors of the parameters."""

from dataclasses import replace

import numpy as np
import pytest

from imubayes.foundations.errors import InputError, Issue
from imubayes.model.bind import bind
from imubayes.model.model_file import EffectSpec, ModelSpec
from small_campaign import ARCSEC, campaign, spec, tumble_campaign

NOISE = EffectSpec("white_noise", where="model: white_noise")


def refused(*effects: EffectSpec, among=None) -> tuple[Issue, ...]:
    with pytest.raises(InputError) as caught:
        bind(ModelSpec("m", (*effects, NOISE), where="model.toml"), among or campaign())
    for problem in caught.value.issues:
        assert problem.what
        assert problem.where
        assert problem.remedy
    return caught.value.issues


def effect(name: str, **settings) -> EffectSpec:
    return EffectSpec(name, where=f"model.toml: {name}", **settings)


@pytest.mark.parametrize(
    ("listed", "what", "allowed"),
    [
        (effect("gyro_bais"), "no effect 'gyro_bais'", "gyro_bias"),
        (effect("gyro_bias", channels=("ax",)), "'ax' is not a gyro", "gx, gy, gz"),
        (effect("gyro_bias", channels=("gw",)), "'gw' does not exist", "g"),
        (effect("gyro_bias", channels=()), "'channels' is empty", "gx"),
        (effect("mounting_error", channels=("gx",)), "not on channels", "no 'channels'"),
        (effect("gyro_bias", per="table"), "cannot have one value per table", "channel"),
        (effect("mounting_error", per="channel"), "cannot have one value per channel", "mounting"),
        (effect("gyro_bias", prior={"bais": "normal(0, 1 deg/h)"}), "no parameter 'bais'", "bias"),
        (effect("gyro_bias", prior={"bias": "normal(0, 1 ppm)"}), "'ppm' is not a unit", "deg/h"),
        (effect("gyro_bias", prior={"bias": "normal(0)"}), "arguments", "normal("),
        (effect("gyro_bias", options={"reference_degC": 20.0}), "no setting 'reference_degC'", "no settings"),
        (effect("gyro_bias_temperature", options={"referense_degC": 20.0}), "no setting", "reference_degC"),
        (effect("gyro_bias_temperature", options={"reference_degC": float("nan")}), "not a number", "a number"),
        (effect("run_scatter", prior={"tau": "normal(0, 1 output)"}), "may not be negative", "lognormal"),
        (effect("gyro_run_bias", prior={"offset": "uniform(-1, 1 deg/h)"}), "has to be normal", "normal"),
    ],
)
def test_what_does_not_fit_is_refused(listed, what, allowed):
    (problem,) = refused(listed)
    assert what in problem.what
    assert problem.where.startswith("model.toml")
    assert allowed in problem.allowed


def test_the_closest_name_stands_first():
    assert refused(effect("gyro_bais"))[0].allowed.startswith("gyro_bias")


def test_an_effect_that_no_run_shows_is_refused_with_what_there_is():
    only_ramps = campaign().only("ramp")
    (problem,) = refused(effect("lever_arm"), among=only_ramps)
    assert "no run can show 'lever_arm'" in problem.what
    assert "it needs a run that turns" in problem.what
    assert "converter_temperature" in problem.allowed


def test_an_effect_of_a_kind_the_unit_lacks_is_refused():
    whole = campaign()
    gyros = replace(
        whole,
        channels=whole.channels[:3],
        runs=tuple(
            replace(run, observed=run.observed[:, :3], sample_sd=run.sample_sd[:, :3])
            for run in whole.runs
            if run.procedure != "current_injection"
        ),
    )
    (problem,) = refused(effect("accel_bias"), among=gyros)
    assert "the unit has none" in problem.what


def test_an_effect_listed_twice_on_a_channel_is_refused():
    (problem,) = refused(effect("gyro_bias"), effect("gyro_bias", channels=("gx",)))
    assert "already contains the effect 'gyro_bias' on gx" in problem.what
    (problem,) = refused(effect("mounting_error"), effect("mounting_error"))
    assert "already contains the effect 'mounting_error'" in problem.what


def test_an_effect_may_be_listed_for_different_channels():
    model = bind(
        ModelSpec("m", (effect("gyro_bias", channels=("gx",)), effect("gyro_bias", channels=("gy", "gz")), NOISE)),
        campaign(),
    )
    assert model.layout.names == tuple(f"gyro_bias.bias[g{axis}]" for axis in "xyz")


@pytest.mark.parametrize("pair", [("gyro_run_bias", "run_scatter"), ("run_scatter", "accel_run_bias")])
def test_effects_with_the_same_response_exclude_each_other(pair):
    (problem,) = refused(*(effect(name) for name in pair))
    assert "do not go together" in problem.what


def test_a_model_without_noise_is_refused():
    with pytest.raises(InputError, match="no noise"):
        bind(ModelSpec("m", (effect("gyro_bias"),), where="model.toml"), campaign())


def test_a_model_of_noise_alone_is_refused():
    with pytest.raises(InputError, match="no parameter to fit"):
        bind(ModelSpec("m", (NOISE,), where="model.toml"), campaign())


def test_all_issues_are_raised_together():
    problems = refused(effect("gyro_bais"), effect("gyro_bias", per="table"), effect("accel_bias", channels=("gx",)))
    assert len(problems) == 3


@pytest.mark.parametrize(
    ("per", "names"),
    [
        (None, ["gyro_bias.bias[gx]", "gyro_bias.bias[gy]", "gyro_bias.bias[gz]"]),
        ("all", ["gyro_bias.bias[all]"]),
        ("mounting", [f"gyro_bias.bias[g{a},{m}]" for a in "xyz" for m in ("flat", "pyramid", "x-up")]),
    ],
)
def test_axes_that_share_a_value(per, names):
    model = bind(ModelSpec("m", (effect("gyro_bias", per=per), NOISE)), campaign())
    assert list(model.layout.names) == names


def test_stated_uncertainties_are_prior_widths():
    model = bind(spec("mounting_error", "table_axis_tilt", "table_rate_error"), campaign())
    widths = {p.name: p.prior_sd for p in model.layout.parameters}
    assert widths["mounting_error.x[pyramid]"] == pytest.approx(300.0)
    assert widths["table_axis_tilt.y[head]"] == pytest.approx(20.0)
    assert widths["table_rate_error.rate_error[rate]"] == pytest.approx(5.0)
    own = bind(
        ModelSpec("m", (effect("mounting_error", prior={"x": "normal(0, 7 arcsec)"}), NOISE)), campaign()
    ).layout.parameters
    assert own[0].prior.sd() == pytest.approx(7 * ARCSEC)
    assert own[0].prior_sd == pytest.approx(7.0)


def test_names_and_units_are_those_of_the_interface():
    model = bind(spec("accel_misalignment", "gyro_misalignment", "converter_offset_drift"), campaign())
    units = {p.name: p.unit for p in model.layout.parameters}
    assert units["accel_misalignment.toward_p[ax]"] == "arcsec"
    assert units["gyro_misalignment.toward_s[gz]"] == "arcsec"
    assert units["converter_offset_drift.slope[ax]"] == "output/degC"
    assert model.hyper_layout.names[0] == "white_noise.sigma[ax]"


def test_a_free_tumble_adds_its_nuisance_parameters():
    model = bind(spec("gyro_bias"), tumble_campaign())
    fields = {(p.effect, p.nuisance) for p in (*model.layout.parameters, *model.hyper_layout.parameters)}
    assert {("pose_attitude", True), ("tumble_heading", True), ("rotation_closure", True)} <= fields
    assert ("gyro_bias", False) in fields


@pytest.mark.parametrize("name", ["gyro_scale_factor", "gyro_misalignment"])
def test_rotations_of_a_free_tumble_determine_scale_and_misalignment(name):
    """The rotation integrated from pose to pose depends on scale and axes of the gyros."""
    model = bind(spec(name), tumble_campaign())
    reach = np.asarray(model.problem.sparsity.reach)
    closing = model.entries.closing
    places = [i for i, p in enumerate(model.layout.parameters) if p.effect == name]
    assert reach[closing][:, places].all()


def test_output_units_are_shown_and_not_written_into_priors():
    """Free text such as pulse/s would not parse as the unit of a prior."""
    parameters = bind(spec("gyro_bias"), campaign()).hyper_layout.parameters
    found = {parameter.name: (parameter.unit, parameter.shown_unit) for parameter in parameters}
    assert found["white_noise.sigma[gx]"] == ("output", "pulse/s")


def test_the_order_of_runs_and_channels_does_not_order_the_parameters():
    """Random draws and triangular factors go by the order of the parameters."""
    listed = spec("accel_misalignment", "gyro_run_bias", "mounting_error", "table_axis_tilt")
    here = campaign()
    turned = replace(here, runs=here.runs[::-1], channels=here.channels[::-1])
    model, other = bind(listed, here), bind(listed, turned)
    assert model.parameter_names == other.parameter_names
    assert len(set(model.parameter_names)) == len(model.parameter_names)
