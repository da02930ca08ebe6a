"""Which runs show an effect: by its response at the nominal input, Earth rate and gravity included."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from imubayes import Scalar, Stage
from imubayes.effects.base import SignalEffect
from imubayes.foundations.errors import InputError
from imubayes.model.bind import bind
from imubayes.model.bound_effects import observability
from imubayes.model.effect_registry import Registry
from imubayes.model.model_file import EffectSpec, ModelSpec
from imubayes.model.problem import predict
from imubayes.parameters.declarations import parameter
from small_campaign import campaign, serial_campaign, wide_campaign

NOISE = EffectSpec("white_noise", where="model.toml")


def shown(among, registry=None) -> dict[str, tuple[str, ...]]:
    return {each.effect_class.name: each.runs for each in observability(among, registry)}


def lacking(among) -> dict[str, tuple[str, ...]]:
    return {each.effect_class.name: each.missing for each in observability(among)}


def test_at_rest_the_earth_turns_a_gyro():
    still = campaign().only("head-flat-20")
    runs = shown(still)
    for effect in ("gyro_scale_factor", "gyro_scale_asymmetry", "gyro_scale_g_dependence", "gyro_misalignment"):
        assert runs[effect] == ("head-flat-20",), effect
    missing = lacking(still)
    for effect in ("lever_arm", "table_rate_error", "time_skew", "rate_proportional_noise", "converter_saturation"):
        assert missing[effect] == ("turning",), effect
    assert missing["gyro_output_axis_acceleration"] == ("acceleration",)
    assert missing["reference_bias"] == ("reference",)
    # What a table with a stated azimuth lacks is not a free tumble.
    assert missing["unknown_heading"] == ("unknown_heading",)
    assert missing["unknown_level"] == ("unknown_level",)
    assert missing["carried_closure"] == ("carried",)
    assert missing["pose_attitude"] == ("free tumble",)


def test_only_what_was_not_recorded_or_is_not_felt_is_missing():
    whole = wide_campaign()
    missing = {name for name, needs in lacking(whole).items() if needs}
    assert missing <= {"reference_bias", "reference_scale_factor", "reference_alignment", "reference_noise",
                       "servo_start", "station_heading", "station_level", "tumble_heading", "unknown_heading",
                       "unknown_level", "pose_attitude", "rotation_closure", "thermometer_error",
                       "converter_thermometer_error", "thermometer_calibration",
                       "converter_thermometer_calibration", "hand_acceleration", "hand_velocity", "carried_closure",
                       "rotation_centre", *SERIAL}  # fmt: skip


SERIAL = {
    "outer_axis_zero", "middle_axis_zero", "inner_axis_zero", "outer_axis_squareness", "middle_axis_squareness",
    "outer_axis_intersection", "middle_axis_intersection", "platform_tilt", "arm_error",
}  # fmt: skip


def test_axes_that_do_not_meet_are_felt_where_they_turn():
    """In positions an intersection error is not felt; on a centrifuge axes are parallel and the arm counts."""
    runs = shown(serial_campaign())
    assert set(runs) >= SERIAL
    for effect in ("outer_axis_intersection", "middle_axis_intersection"):
        assert runs[effect] == ("turned",), effect
    for effect in ("outer_axis_squareness", "outer_axis_zero"):
        assert {"posed", "turned"} <= set(runs[effect]), effect
    assert set(runs["platform_tilt"]) == {"spun", "back"}
    assert set(runs["arm_error"]) == {"spun", "back"}
    missing = lacking(serial_campaign().only("posed"))
    assert missing["outer_axis_intersection"] == ("turning",)
    assert missing["middle_axis_squareness"] == ()


def test_an_injected_current_hides_the_sensor():
    runs = shown(campaign())
    assert not {"inject", "inject-low"} & set(runs["accel_bias"])
    assert {"inject", "inject-low"} <= set(runs["converter_nonlinearity"])
    assert set(runs["injection_error"]) == {"inject", "inject-low"}


def test_a_temperature_at_its_reference_shows_nothing():
    flat = campaign().only("rate-flat")
    covariates = flat.runs[0].covariates
    assert np.all(covariates["temperature"] == 25.0)
    assert lacking(flat)["gyro_bias_temperature"] == ("temperature",)
    warmer = replace(flat.runs[0], covariates={**covariates, "temperature": covariates["temperature"] + 3})
    assert lacking(replace(flat, runs=(warmer,)))["gyro_bias_temperature"] == ()


def test_a_table_without_response_has_no_value():
    spec = ModelSpec("m", (EffectSpec("table_rate_error"), EffectSpec("gyro_bias"), NOISE), where="model.toml")
    names = bind(spec, campaign()).layout.names
    assert [name for name in names if name.startswith("table_rate_error")] == ["table_rate_error.rate_error[rate]"]


def test_an_effect_left_out_where_optional():
    spec = ModelSpec("m", (EffectSpec("lever_arm", optional=True), EffectSpec("gyro_bias"), NOISE))
    names = bind(spec, campaign().only("ramp")).layout.names
    assert not [name for name in names if name.startswith("lever_arm")]


def test_rate_noise_alone_is_no_noise():
    spec = ModelSpec("m", (EffectSpec("gyro_bias"), EffectSpec("rate_proportional_noise")), where="model.toml")
    with pytest.raises(InputError, match="no noise"):
        bind(spec, campaign())


class Even(SignalEffect):
    """signal + b²·x: no derivative at its null, and felt all the same."""

    name = "even"
    stage, kinds = Stage.SENSOR, ("gyro",)
    reference = "for this test"
    coefficient: Scalar = parameter("1", "normal(0, 1)", (0.1, 2.0), "the coefficient")

    def apply(self, signal, sample):
        return signal + self.coefficient**2 * sample.rate[0]


class Deaf(Even):
    """signal + 0·b."""

    name = "deaf"

    def apply(self, signal, sample):
        return signal + 0.0 * self.coefficient


def test_it_is_the_response_at_a_size_not_the_derivative():
    registry = Registry(Registry().effects | {"even": Even, "deaf": Deaf})
    runs = shown(campaign().only("head-flat-20"), registry)
    assert runs["even"] == ("head-flat-20",)
    assert runs["deaf"] == ()


@pytest.mark.parametrize(
    "effect", ["gyro_scale_factor", "accel_dead_zone", "table_axis_tilt", "converter_nonlinearity"]
)
def test_the_few_instants_agree_with_all_readings(effect):
    """By the whole prediction at two values of all parameters."""
    spec = ModelSpec("m", (EffectSpec(effect, where="model.toml"), NOISE), where="model.toml")
    model = bind(spec, campaign())
    size = model.problem.size[0]
    here, there = (np.asarray(predict(model.problem, jnp.full(size, z))) for z in (0.3, -0.5))
    changed = {campaign().runs[run].name for run in np.unique(model.entries.run[here != there])}
    assert changed == set(shown(campaign())[effect])
