"""The independent generator against numbers worked out by hand."""
# pyright: reportMissingImports=false

import re
import tomllib
from dataclasses import replace
from pathlib import Path

import detectability
import hidden
import hidden_effects
import hidden_servo
import numpy as np
import plan as plans
import pytest
import servo_table
from kinematics import X_UP, Z_UP, Mounting, Site, Table
from sensor import Channel, Surroundings, bias_over_temperature_and_time

from imubayes.campaign import load_campaign
from imubayes.model.bind import bind
from imubayes.model.model_file import read_model

ROOT = Path(__file__).parents[2]
SITE = Site(0.0, 0.0)
GX = Channel("gx", "gyro", (1.0, 0.0, 0.0), "deg/s", 1.0, "deg/s", 0.01, (0.0, 1.0, 0.0))
AX = Channel("ax", "accelerometer", (1.0, 0.0, 0.0), "g", 1.0, "g", 1e-5, (0.0, 1.0, 0.0), current_mA_per_g=2.0)
TABLES = (Table("rate", 0.0, 90.0, 20.0, 5.0), Table("head", 90.0, 0.0, 20.0))


def a_plan(*rows, table="rate", mounting=X_UP, procedure="rate_table", model="hidden-effects"):
    run = plans.Run("run", procedure, list(rows), table, "seat", "2026-01-01T00:00:00+00:00")
    return plans.Plan("p", "", "", SITE, (GX, AX), TABLES, (Mounting("seat", mounting, 5.0),), (run,), model=model)


def _of(values, name):
    return values.get(name, 0.0)


def difference(plan, values):
    """Rows × channels that some true values add to the readings."""
    moments = plans.Moments(plan)
    return moments.means(moments.outputs(values)) - moments.means(moments.outputs({}))


TURNING = plans.Row(0.0, 1200, 25.0, rate=100.0, angle=None), plans.Row(100.0, 1200, 25.0, rate=-100.0, angle=None)


@pytest.mark.parametrize(
    ("name", "value", "forward", "reverse"),
    [
        ("gyro_scale_asymmetry.asymmetry", 10.0, 1e-3, 1e-3),  # 10 ppm of 100 deg/s, either way
        ("gyro_scale_quadratic.quadratic", 0.1, 1e-3, 1e-3),  # 0.1 ppm/(deg/s) · (100 deg/s)²
        ("gyro_scale_cubic.cubic", 0.001, 1e-3, -1e-3),
        ("gyro_scale_g_dependence.dependence", 20.0, 2e-3, -2e-3),  # the axis points up: 1 g
        ("gyro_g_sensitivity.d_i", 3.6, 1e-3, 1e-3),
        ("gyro_g2_sensitivity.d_ii", 3.6, 1e-3, 1e-3),
        ("gyro_g2_sensitivity.d_io", 3.6, 0.0, 0.0),
        ("gyro_dead_zone.half_width", 3.6, -1e-3, 1e-3),
        ("outside_root_rate.amplitude", 3.6, 1e-2, 1e-2),
    ],
)
def test_gyro_on_a_vertical_table(name, value, forward, reverse):
    found = difference(a_plan(*TURNING), {f"{name}[gx]": value})
    assert np.allclose(found[:, 0], [forward, reverse], rtol=1e-4, atol=1e-9)
    assert np.all(found[:, 1] == 0)


def test_resonance_is_half_at_one_width():
    values = {f"outside_resonance.{key}[gx]": value for key, value in
              {"amplitude": 3.6, "centre": 90.0, "width": 10.0}.items()}  # fmt: skip
    assert np.allclose(difference(a_plan(*TURNING), values)[:, 0], 0.5e-3, rtol=1e-3)


@pytest.mark.parametrize(
    ("name", "value", "at"),
    [
        # at table angle 30°, axis up at 0: a_i = cos 30°; O and P take 0 and ∓sin 30°
        ("accel_cubic.cubic", 100.0, 1e-4 * np.cos(np.pi / 6) ** 3),
        ("accel_odd_quadratic.odd_quadratic", -100.0, -1e-4 * np.cos(np.pi / 6) ** 2),
        ("accel_scale_asymmetry.asymmetry", 100.0, 1e-4 * np.cos(np.pi / 6)),
        ("accel_dead_zone.half_width", 100.0, -1e-4),
        ("outside_threshold.amplitude", 0.0, 0.0),
    ],
)
def test_accelerometer_on_a_dividing_head(name, value, at):
    rows = plans.Row(0.0, 600, 25.0, angle=30.0), plans.Row(40.0, 600, 25.0, angle=210.0)
    # Table axis East; body x up at angle 0 where table y points up.
    seat = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])
    plan = a_plan(*rows, table="head", mounting=seat, procedure="dividing_head")
    up = plans.Moments(plan).motion({})[1][:, 0] / SITE.gravity
    assert np.allclose(np.abs(up), np.cos(np.pi / 6))
    found = difference(plan, {f"{name}[ax]": value})[:, 1]
    odd = name.startswith(("accel_cubic", "accel_odd", "accel_dead"))
    assert np.allclose(found, np.where(up > 0, at, -at if odd else at), rtol=1e-9, atol=1e-15)


def test_cross_terms_sum_to_what_the_squares_leave():
    rows = [plans.Row(40.0 * k, 600, 25.0, angle=17.0 + 45 * k) for k in range(8)]
    plan = a_plan(*rows, table="head", mounting=Z_UP @ X_UP, procedure="dividing_head")
    every = {"accel_quadratic.quadratic": 50.0, "accel_cross_axis_quadratic.k_oo": 50.0,
             "accel_cross_axis_quadratic.k_pp": 50.0}  # fmt: skip
    found = difference(plan, {f"{name}[ax]": value for name, value in every.items()})[:, 1]
    assert np.allclose(found, 50e-6, rtol=1e-9)  # a_i² + a_o² + a_p² = 1


def test_encoder_error_moves_the_angle():
    rows = [plans.Row(40.0 * k, 600, 25.0, angle=30.0 * k) for k in range(12)]
    plan = a_plan(*rows, table="head", mounting=np.eye(3)[[1, 2, 0]], procedure="dividing_head")
    force = plans.Moments(plan).motion({})[1]
    moved = plans.Moments(plan).motion({"encoder_harmonic.sin_2[head]": 10.0, "encoder_harmonic.cos_1[head]": 5.0})[1]
    angle = np.radians(30.0 * np.arange(12))
    by = (10 * np.sin(2 * angle) + 5 * np.cos(angle)) * np.pi / 648000
    turned = np.linalg.norm(moved - force, axis=1) / SITE.gravity
    assert np.allclose(turned, np.abs(by), atol=1e-9)


def test_wobble_tilts_gravity_on_a_vertical_table():
    rows = [plans.Row(40.0 * k, 600, 25.0, angle=90.0 * k) for k in range(4)]
    force = plans.Moments(a_plan(*rows, mounting=Z_UP)).motion({"table_wobble.x_cos_2[rate]": 20.0})[1] / SITE.gravity
    tilt = 20 * np.pi / 648000 * np.array([1, -1, 1, -1])
    # Leaning about table x at angle 0 brings gravity along table y: at angle φ that is body (sin φ, cos φ).
    assert np.allclose(force[:, 0], tilt * np.sin(np.radians([0, 90, 180, 270])), atol=1e-9)
    assert np.allclose(force[:, 1], tilt * np.cos(np.radians([0, 90, 180, 270])), atol=1e-9)


def test_lag_behind_a_ramp_tends_to_slope_times_tau():
    time = np.arange(0, 36000.0, 60.0)
    behind = plans.lagged(time, 10 + time / 600, 600.0)
    assert behind[0] == 10
    assert np.isclose(behind[-1] - (10 + time[-1] / 600), -1.0)  # 0.1 °C/min for 10 min
    assert np.isclose(behind[10] - 11.0, -(1 - np.exp(-1)))  # after one time constant


@pytest.mark.parametrize(
    ("parameters", "around", "expected"),
    [
        ({"bias_temperature_quadratic.curvature": 2.0}, {"temperature": 35.0}, 200.0),
        ({"bias_temperature_cubic.coefficient": 0.2}, {"temperature": 35.0}, 200.0),
        ({"bias_temperature_rate.slope": 3.0}, {"temperature_rate": 0.5}, 1.5),
        ({"warm_up.amplitude": 10.0, "warm_up.tau": 5.0}, {"power_on_min": 10.0}, 10 * np.exp(-2)),
        ({"warm_up.amplitude": 10.0, "warm_up.tau": 5.0}, {}, 0.0),
        ({"bias_drift.slope": 4.0}, {"hours": 2.5}, 10.0),
        ({"thermal_lag.coefficient": 4.0, "thermal_lag.tau": 5.0}, {"lag": lambda tau: -tau / 10}, -2.0),
    ],
)
def test_bias_over_temperature_and_time(parameters, around, expected):
    for kind in ("gyro", "accel"):
        values = {f"{kind}_{name}": value for name, value in parameters.items()}
        found = bias_over_temperature_and_time(
            kind, lambda name, values=values: values.get(name, 0.0), Surroundings(**around)
        )
        assert np.isclose(found, expected)


@pytest.mark.parametrize(
    ("parameters", "expected"),
    [
        # 5 g injected as 10 mA, converter at 35 °C, output in g
        ({"converter_gain_drift_quadratic.curvature": 1.0}, 5 * 100e-6),
        ({"converter_offset_drift_quadratic.curvature": 1e-6}, 1e-4),
        ({"converter_leakage.leakage": 1e-5, "converter_leakage.doubling": 10.0}, 1e-5),
        ({"converter_nonlinearity.quadratic": 2.0}, 2e-6 * 25),
        ({"converter_nonlinearity.cubic": 2.0}, 2e-6 * 125),
        ({"converter_dead_zone.half_width": 1e-4}, -1e-4),
        ({"accel_dead_zone.half_width": 100.0}, 0.0),  # what is injected passes the sensor by
    ],
)
def test_converter_with_injected_current(parameters, expected):
    row = plans.Row(0.0, 10, 25.0, converter_temperature=35.0, current=10.0)
    plan = replace(a_plan(row), channels=(AX,))
    found = difference(plan, {f"{name}[ax]": value for name, value in parameters.items()})
    assert np.isclose(found[0, 0], expected, rtol=1e-9, atol=1e-15)


RAMP = tuple(
    plans.Row(60.0 * k + 30, 10, 25.0, converter_temperature=20.5 + k, converter_rise=1.0, current=10.0)
    for k in range(60)
)


@pytest.mark.parametrize(
    ("parameters", "expected"),
    [
        # 5 g injected, converter at 1 °C/min for an hour: what is reached at its end, output in g
        ({"converter_offset_temperature_rate.slope": 2e-4}, 2e-4),
        ({"converter_offset_lag.coefficient": 1e-4, "converter_offset_lag.tau": 5.0}, -5e-4),
        ({"converter_offset_hysteresis.half_width": 3e-4, "converter_offset_hysteresis.play": 2.0}, 3e-4),
        ({"converter_gain_temperature_rate.slope": 20.0}, 5 * 20e-6),
        ({"converter_gain_lag.coefficient": 10.0, "converter_gain_lag.tau": 5.0}, -5 * 50e-6),
        ({"converter_gain_hysteresis.half_width": 30.0, "converter_gain_hysteresis.play": 2.0}, 5 * 30e-6),
    ],
)
def test_converter_on_a_ramp(parameters, expected):
    plan = replace(a_plan(*RAMP), channels=(AX,))
    found = difference(plan, {f"{name}[ax]": value for name, value in parameters.items()})[:, 0]
    assert np.isclose(found[-1], expected, rtol=1e-4)
    if "rate" not in next(iter(parameters)):
        assert 0 < found[0] / expected < 0.3, "there is nothing to remember where a run begins"


def test_a_loop_is_entered_in_the_middle_and_left_at_either_end():
    place = plans.place_in_loop(np.array([20.0, 21, 23, 30, 29, 26, 20, 22]), 2.0)
    assert np.allclose(place, [0, 0.5, 1, 1, 0.5, -1, -1, 0])


def test_autoregression_has_the_stated_spread_and_correlation():
    noise = plans.correlated(np.random.default_rng(1), 200_000, 2.0, 0.6)
    assert np.isclose(noise.std(), 2.0, rtol=0.02)
    assert np.isclose(np.corrcoef(noise[1:], noise[:-1])[0, 1], 0.6, atol=0.01)


def test_rate_proportional_noise_follows_the_input_axis():
    plan, values = a_plan(*TURNING, mounting=X_UP), {"rate_proportional_noise.k[gx]": 10.0}
    assert np.allclose(plans.rate_noise(plan, plan.runs[0], GX, values), 1e-3)
    level = a_plan(*TURNING, mounting=Z_UP)
    assert np.allclose(plans.rate_noise(level, level.runs[0], GX, values), 0.0, atol=1e-12)


def test_detectability_by_hand():
    """An even effect at ±100 deg/s: the bias takes nearly all of it, the rest is what its prior forbids."""
    plan = replace(a_plan(*TURNING), channels=(GX,))
    values = {"white_noise.sigma[gx]": 0.01, "run_scatter.tau[gx]": 0.0}
    sight = detectability.look(plan, values)
    effect = {"gyro_scale_asymmetry.asymmetry[gx]": 1000.0}  # 0.1 deg/s in both rows: 360 deg/h
    sd = 0.01 / np.sqrt(1200)
    prior = 30 / 3600  # the bias; all else changes the rows oppositely, or by far less
    assert np.isclose(np.sum(sight.shift(effect) ** 2), 2 * (0.1 / sd) ** 2, rtol=1e-4)
    assert np.isclose(sight.detectability(effect), 0.1**2 / (sd**2 / 2 + prior**2), rtol=1e-3)


def test_run_offsets_hide_what_is_constant_in_a_run():
    plan = replace(a_plan(*TURNING), channels=(GX,))
    values = {"white_noise.sigma[gx]": 0.01, "run_scatter.tau[gx]": 10.0}
    assert detectability.look(plan, values).detectability({"gyro_warm_up.amplitude[gx]": 3.6}) == 0
    assert detectability.look(plan, values).detectability({"gyro_bias_drift.slope[gx]": 3.6}) < 1e-3


# A large effect is sized by refits, a minute and more.
@pytest.mark.parametrize(
    "kind", [pytest.param(kind, marks=pytest.mark.slow) if kind == "large" else kind for kind in hidden.KINDS]
)
@pytest.mark.slow
def test_a_random_campaign_is_what_it_says(kind, tmp_path):
    drawn = hidden.random_campaign(tmp_path / "one", 3, kind)
    again = hidden.random_campaign(tmp_path / "two", 3, kind)
    assert [one.parameters for one in drawn.planted] == [one.parameters for one in again.planted]
    for file in (tmp_path / "one").rglob("*.csv"):
        assert file.read_bytes() == (tmp_path / "two" / "runs" / file.name).read_bytes()
    assert 300 <= drawn.readings <= 2500
    text = drawn.model.read_text()
    assert len(drawn.planted) == {"hidden": 1, "outside": 1, "offsets": 1, "two": 2, "large": 1}.get(kind, 0)
    for one in drawn.planted:
        assert f'name = "{one.effect}"' not in text
        if kind == "offsets":
            assert one.s < 1
        else:
            low, high = (1800, 1.1e6) if kind == "large" else (35, 2050)
            assert low <= one.s_alone <= high
    truth = tomllib.loads((tmp_path / "one" / "truth.toml").read_text())
    for one in drawn.planted:
        assert one.parameters.items() <= truth["parameters"].items()


ALONE = {
    "rate_table": "gyro_scale_cubic", "thermal_ramp": "converter_offset_lag", "polar_tumble": "gyro_g2_sensitivity",
    "geographic_tumble": "station_heading", "rotation_modulation": "table_wobble",
    "reference_gyro": "gyro_scale_asymmetry", "head": "accel_cubic", "static_record": "gyro_warm_up",
    "free_tumble": "gyro_scale_cubic", "multi_axis_table": "middle_axis_squareness", "centrifuge": "arm_error",
}  # fmt: skip
LONG = ("free_tumble", "multi_axis_table", "centrifuge", "rotation_modulation", "thermal_ramp")


@pytest.mark.parametrize(
    "procedure",
    [pytest.param(name, marks=pytest.mark.slow) if name in LONG else name for name in (*ALONE, "servo_table")],
)
@pytest.mark.slow
def test_a_campaign_of_one_procedure_holds_that_alone(procedure, tmp_path):
    """It is read as a campaign of that procedure; its model is a shipped one that lacks what is hidden."""
    if procedure == "servo_table":
        drawn, names = hidden_servo.random_campaign(tmp_path, 3, "null-white"), {"servo_table"}
    else:
        drawn = hidden.random_campaign(tmp_path, 3, "hidden", procedure, ALONE[procedure])
        names = {"thermal_ramp": {"thermal_ramp", "current_injection"}, "head": {"dividing_head"}}
        names = names.get(procedure, {procedure})
        (one,) = drawn.planted
        assert one.effect == ALONE[procedure]
        assert f'name = "{one.effect}"' not in drawn.model.read_text()
        assert 35 <= one.s <= 2200
    runs = tomllib.loads((tmp_path / "campaign.toml").read_text())["run"]
    assert {run["procedure"] for run in runs} == names
    bind(read_model(drawn.model), load_campaign(tmp_path))


def test_what_an_autoregression_takes_of_a_shift():
    """Against dense matrices: a slow shift is taken almost in full, one that alternates is not."""
    n, phi = 60, np.linspace(-0.9, 0.995, 380)
    slow, quick = 3 * np.linspace(-1, 1, n), 1.5 * (-1.0) ** np.arange(n)
    for shift in (slow, quick):
        left = []
        for each in phi:
            inverse = np.linalg.inv(each ** np.abs(np.subtract.outer(np.arange(n), np.arange(n))))
            ones = inverse.sum(axis=0)
            square = shift @ inverse @ shift - (shift @ ones) ** 2 / ones.sum()
            left.append(n * np.log((np.trace(inverse) + square) / n) - np.linalg.slogdet(inverse)[1])
        assert np.isclose(detectability.seen_past_correlation(shift), min(left), rtol=1e-6)
    assert detectability.seen_past_correlation(slow) < 0.4 * (slow @ slow)
    assert detectability.seen_past_correlation(np.zeros(n)) < 1e-9


def test_channels_that_a_run_does_not_record_show_nothing():
    plan = replace(a_plan(*TURNING), channels=(GX, AX))
    (run,) = plan.runs
    plan = replace(plan, runs=(replace(run, recorded=("ax",)),))
    values = {f"white_noise.sigma[{name}]": 0.01 for name in ("gx", "ax")}
    sight = detectability.look(plan, values)
    assert sight.detectability({"gyro_g_sensitivity.d_i[gx]": 1e3}) == 0
    assert sight.detectability({"accel_quadratic.quadratic[ax]": 1e5}) > 0


def test_a_tumble_shows_what_its_attitudes_cannot_explain():
    """A scale error lengthens the turns, an attitude moves a rest and both turns beside it, and all of it is free."""
    from tumble_plans import tumble

    plan = tumble(np.random.default_rng(2), SITE)
    moments = plan.moments()
    nothing, scaled = moments.outputs({}), moments.outputs({f"gyro_scale_factor.scale[g{x}]": 1e3 for x in "xyz"})
    rests, (first, last) = len(plan.moves) + 1, (plan.rests[0][1], plan.rests[1][0])
    turned = (last - first) / 100 * np.linalg.norm((scaled - nothing)[rests, 3:])
    move = plan.moves[0]
    cosine = (np.trace(move.attitude.T @ move.final_attitude) - 1) / 2
    assert np.isclose(turned, 1e-3 * np.arccos(cosine), rtol=0.1)  # the axis wanders
    leaning = moments.outputs({"attitude.x[1]": 1e-3}) - nothing
    assert np.flatnonzero(np.linalg.norm(leaning, axis=1) > 1e-6).tolist() == [1, rests, rests + 1]
    assert np.isclose(np.linalg.norm(leaning[1]), 1e-3 * np.hypot(*nothing[1, 1:3]), rtol=1e-3)


def test_a_servo_table_shows_what_its_model_lacks():
    """The shift of the angle over a day by a drift, past bias, start and harmonics, against a line fitted by hand."""
    plan = servo_table.plan(1, {"day": 24.0}, "servo-table")
    values = {"gyro_bias.bias[g]": 0.5, "white_noise.sigma[table_angle]": 1.0 / 3600}
    angle = hidden_servo.Angle(plan, 24.0, 1.0)
    drift = {**values, "gyro_bias_drift.slope[g]": 1e-4}
    shift = (angle.outputs(drift) - angle.outputs(values))[:, 0]
    hours = (np.arange(len(shift)) + 0.5) * hidden_servo.EVERY * servo_table.SECONDS / 3600
    # dφ/dt = −d along the pole, d = 1e-4·t deg/h: half a square of the time.
    np.testing.assert_allclose(shift, -0.5e-4 * hours**2, rtol=1e-3, atol=1e-7)


def test_shipped_campaigns_are_what_the_script_makes(tmp_path):
    for name in ("hidden-none", "hidden-kinematic"):
        hidden_effects.generate(tmp_path / name)
        for file in sorted((tmp_path / name).rglob("*.*")):
            shipped = ROOT / "data" / name / file.relative_to(tmp_path / name)
            words, numbers = told_apart(file.read_text())
            known_words, known_numbers = told_apart(shipped.read_text())
            assert words == known_words, file.name
            last_digit = 2e-5 if file.suffix == ".csv" else 0.0
            # Linear algebra rounds differently from processor to processor.
            np.testing.assert_allclose(numbers, known_numbers, rtol=1e-9, atol=last_digit, err_msg=file.name)


def told_apart(text):
    """Return a text with a mark in place of each number, and the numbers."""
    number = r"[+-]?\d+(?:\.\d+)?(?:e[+-]?\d+)?"
    return re.sub(number, "#", text), np.array(re.findall(number, text), dtype=float)


def test_every_effect_can_be_shown_somewhere():
    """No effect of the list is dead: each moves some reading of some plan past what the plain model absorbs."""
    from random_plans import TEMPLATES, random_plan

    left = set(hidden.ALL)
    for template in TEMPLATES:
        generator = np.random.default_rng(5)
        plan = random_plan(template, generator, "hidden-effects")
        plan = replace(plan, model=None, name="hidden-effects")
        sight = detectability.look(plan, plan.draw(1))
        for effect in sorted(left & set(hidden.applicable(template, hidden.ALL))):
            where = hidden.places(plan, hidden.ALL[effect].on, generator)
            if where and sight.detectability(hidden.unit_effect(plan, effect, where, generator)) > 1:
                left.discard(effect)
    alone = {name for name, kind in hidden.ALL.items() if kind.templates and not {*kind.templates} & {*TEMPLATES}}
    assert left == alone  # of positions named by direction, and of several axes
