"""Outputs predicted with each effect of the catalogue, against kinematics and formulas in plain NumPy."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from imubayes.compiled.in_numpy import linearised_in_numpy
from imubayes.model.problem import predict
from small_campaign import (
    ACCEL_SCALE,
    ARCSEC,
    DEGREE,
    GRAVITY,
    GYRO_SCALE,
    LATITUDE,
    at_null,
    predicted_with,
    whole_catalogue,
    wide_campaign,
)

EARTH = 15.041067 * DEGREE / 3600
HOUR = DEGREE / 3600
RATE = 100 * DEGREE
UP = EARTH * np.sin(LATITUDE)
UG = 1e-6 * GRAVITY
SINCE_FIRST = 237.0
"""Hours from the start of the campaign, on 1 March at noon, to the last row of the slow cycle, which begins on 11 March
at eight and lasts an hour."""


def outputs(name: str, run: str, channel: str, **values: float) -> np.ndarray:
    """Return the predicted input of a channel in each row of a run, SI; values: parameters of it or of the tables."""
    bound = whole_catalogue()
    found = predicted_with(name, channel, **values)
    runs, channels = [r.name for r in bound.campaign.runs], [c.name for c in bound.campaign.channels]
    chosen = (bound.entries.run == runs.index(run)) & (bound.entries.channel == channels.index(channel))
    offset = bound.campaign.channels[channels.index(channel)].offset
    return (found[chosen] - offset) / (GYRO_SCALE if channel[0] == "g" else ACCEL_SCALE)


def local_to_body(angle: np.ndarray, wobble: np.ndarray, mounting: np.ndarray) -> Rotation:
    """Return n → body on the dividing head (azimuth 0.3, horizontal axis), with the axis turned by a small vector."""
    base = Rotation.from_euler("z", -0.3) * Rotation.from_euler("x", -np.pi / 2)
    whole = (
        base
        * Rotation.from_rotvec(wobble)
        * Rotation.from_rotvec(np.outer(angle, [0, 0, 1]))
        * Rotation.from_matrix(mounting)
    )
    return whole.inv()


def test_an_encoder_harmonic_shifts_the_angle():
    campaign = wide_campaign()
    angle = next(r for r in campaign.runs if r.name == "head-pyramid-20").covariates["table_angle"]
    given = {"sin_1": 20.0, "cos_1": -30.0, "sin_2": 15.0, "cos_2": 40.0}
    true = angle + ARCSEC * (20 * np.sin(angle) - 30 * np.cos(angle) + 15 * np.sin(2 * angle) + 40 * np.cos(2 * angle))
    force = local_to_body(true, np.zeros((8, 3)), campaign.mountings["pyramid"].body_to_table).apply([0, 0, GRAVITY])
    for place, axis in enumerate("xyz"):
        found = outputs("encoder_harmonic", "head-pyramid-20", f"a{axis}", **given)
        np.testing.assert_allclose(found, force[:, place], rtol=1e-11, atol=1e-11)


def test_an_encoder_harmonic_changes_the_table_rate():
    found = outputs("encoder_harmonic", "swept", "gx", sin_1=20.0, cos_1=0.0, sin_2=0.0, cos_2=0.0)
    run = next(r for r in wide_campaign().runs if r.name == "swept")
    rate, angle, span = (run.covariates[n] for n in ("table_rate", "table_angle", "table_angle_span"))
    mean_slope = (np.sin(angle + span / 2) - np.sin(angle - span / 2)) / span
    still = outputs("gyro_scale_factor", "swept", "gx", scale=0.0)
    np.testing.assert_allclose(found - still, rate * 20 * ARCSEC * mean_slope, rtol=1e-3)


def test_a_wobble_turns_the_axis():
    campaign = wide_campaign()
    angle = next(r for r in campaign.runs if r.name == "head-pyramid-20").covariates["table_angle"]
    size = np.array([[5.0, -8], [12, 20], [-7, 3], [4, 9]])  # cos and sin: x1, y1, x2, y2
    names = ("x_{}_1", "y_{}_1", "x_{}_2", "y_{}_2")
    given = {
        n.format(w): v for n, pair in zip(names, size, strict=True) for w, v in zip(("cos", "sin"), pair, strict=True)
    }
    waves = [size[i, 0] * np.cos(k * angle) + size[i, 1] * np.sin(k * angle) for i, k in enumerate((1, 1, 2, 2))]
    wobble = ARCSEC * np.stack([waves[0] + waves[2], waves[1] + waves[3], 0 * angle], axis=1)
    turn = local_to_body(angle, wobble, campaign.mountings["pyramid"].body_to_table)
    force, earth = turn.apply([0, 0, GRAVITY]), turn.apply([0, EARTH * np.cos(LATITUDE), UP])
    for place, axis in enumerate("xyz"):
        found = outputs("table_wobble", "head-pyramid-20", f"a{axis}", **given)
        np.testing.assert_allclose(found, force[:, place], rtol=1e-11, atol=1e-11)
        found = outputs("table_wobble", "head-pyramid-20", f"g{axis}", **given)
        np.testing.assert_allclose(found, earth[:, place], rtol=1e-9, atol=1e-15)


def test_a_wobble_fixed_in_the_table_is_a_mounting_error():
    given = {"x_cos_1": 30.0, "y_sin_1": 30.0, "x_sin_1": 0.0, "y_cos_1": 0.0}
    wobbled = outputs("table_wobble", "head-flat-20", "az", **given)
    seated = predicted_with("mounting_error", "flat", x=30.0) / ACCEL_SCALE
    entries = whole_catalogue().entries
    names = [r.name for r in wide_campaign().runs]
    chosen = (entries.run == names.index("head-flat-20")) & (entries.channel == 5)
    np.testing.assert_allclose(wobbled, seated[chosen], atol=1e-6 * UG)


def test_a_time_skew_shifts_angle_and_rate():
    run = next(r for r in wide_campaign().runs if r.name == "swept")
    rate, acceleration = run.covariates["table_rate"], run.covariates["table_acceleration"]
    found = outputs("time_skew", "swept", "gx", skew=5.0) - outputs("time_skew", "swept", "gx", skew=0.0)
    np.testing.assert_allclose(found, acceleration * 0.005, rtol=1e-4)
    ahead = outputs("time_skew", "swept", "ay", skew=5.0)
    # x along the axis: y measures gravity along table x, which is horizontal at angle 0.
    angle = run.covariates["table_angle"] + rate * 0.005 + 0.5 * acceleration * 0.005**2
    half = run.covariates["table_angle_span"] / 2
    np.testing.assert_allclose(ahead, -GRAVITY * np.sin(angle) * np.sin(half) / half, rtol=1e-7)


@pytest.mark.parametrize(
    ("name", "value", "run", "channel", "row", "expected"),
    [
        ("gravity_anomaly", {"anomaly": 50.0}, "rate-flat", "az", 0, 50 * UG),
        ("gyro_scale_asymmetry", {"asymmetry": 100.0}, "rate-flat", "gz", 2, 1e-4 * (RATE - UP)),
        ("gyro_scale_quadratic", {"quadratic": 0.5}, "rate-flat", "gz", 2, 0.5e-6 * (100 - UP / DEGREE) * (RATE - UP)),
        ("gyro_scale_cubic", {"cubic": 0.01}, "rate-flat", "gz", 2, -1e-8 * (100 - UP / DEGREE) ** 2 * (RATE - UP)),
        ("gyro_scale_g_dependence", {"dependence": 20.0}, "rate-flat", "gz", 1, 20e-6 * (RATE + UP)),
        ("gyro_g2_sensitivity", {"d_ii": 3.0}, "rate-flat", "gz", 0, 3 * HOUR),
        ("gyro_g2_sensitivity", {"d_oo": 3.0}, "rate-flat", "gy", 0, 3 * HOUR),
        ("gyro_g2_sensitivity", {"d_ss": 3.0}, "rate-flat", "gx", 0, 3 * HOUR),
        ("gyro_g2_sensitivity", {"d_io": 3.0}, "rate-pyramid", "gx", 0, HOUR),
        ("gyro_g2_sensitivity", {"d_os": 3.0}, "rate-pyramid", "gx", 0, HOUR),
        ("gyro_g2_sensitivity", {"d_si": 3.0}, "rate-pyramid", "gx", 0, HOUR),
        ("gyro_bias_temperature_quadratic", {"curvature": 0.1}, "rate-pyramid", "gz", 0, 10 * HOUR),
        ("gyro_bias_temperature_cubic", {"coefficient": 0.01}, "rate-pyramid", "gz", 0, 10 * HOUR),
        ("gyro_warm_up", {"amplitude": 10.0, "tau": 10.0}, "cycle-slow", "gz", 3, 10 * HOUR * np.exp(-1.3)),
        ("gyro_bias_drift", {"slope": 2.0}, "cycle-slow", "gz", 15, 2 * SINCE_FIRST * HOUR),
        ("gyro_scale_temperature_quadratic", {"curvature": 0.5}, "rate-pyramid", "gz", 1, 5e-5 * (RATE + UP) / 3**0.5),
        ("gyro_dead_zone", {"half_width": 2.0}, "rate-flat", "gz", 1, -2 * HOUR),
        ("gyro_dead_zone", {"half_width": 2.0}, "rate-flat", "gz", 2, 2 * HOUR),
        ("gyro_dead_zone", {"half_width": 20.0}, "rate-flat", "gz", 0, -UP),
        ("gyro_magnetic_sensitivity", {"m_i": 10.0}, "rate-flat", "gy", 0, 2.5 * HOUR),
        ("gyro_magnetic_sensitivity", {"m_i": 10.0}, "rate-flat", "gz", 0, -4.0 * HOUR),
        ("gyro_magnetic_sensitivity", {"m_o": 10.0}, "rate-flat", "gx", 0, 2.5 * HOUR),
        ("gyro_output_axis_acceleration", {"coefficient": 2.0}, "swept", "gz", 0, 0.002 * 200 * DEGREE),
        ("accel_cubic", {"cubic": 7.0}, "rate-flat", "az", 0, 7 * UG),
        ("accel_odd_quadratic", {"odd_quadratic": 7.0}, "rate-pyramid", "az", 0, 7 * UG / 3),
        ("accel_cross_coupling", {"k_ip": 6.0}, "rate-pyramid", "ax", 0, 2 * UG),
        ("accel_cross_coupling", {"k_io": 6.0}, "rate-pyramid", "ax", 0, 2 * UG),
        ("accel_cross_axis_quadratic", {"k_oo": 6.0}, "rate-flat", "ay", 0, 6 * UG),
        ("accel_cross_axis_quadratic", {"k_pp": 6.0}, "rate-flat", "ax", 0, 6 * UG),
        ("accel_scale_asymmetry", {"asymmetry": 30.0}, "rate-flat", "az", 0, 30 * UG),
        ("accel_bias_temperature_quadratic", {"curvature": 0.5}, "rate-pyramid", "az", 0, 50 * UG),
        ("accel_bias_temperature_cubic", {"coefficient": 0.05}, "rate-pyramid", "az", 0, 50 * UG),
        ("accel_warm_up", {"amplitude": 10.0, "tau": 10.0}, "cycle-slow", "az", 3, 10 * UG * np.exp(-1.3)),
        ("accel_bias_drift", {"slope": 2.0}, "cycle-slow", "az", 15, 2 * SINCE_FIRST * UG),
        ("accel_scale_temperature_quadratic", {"curvature": 0.5}, "rate-pyramid", "az", 0, 50 * UG / 3**0.5),
        ("accel_vibration_rectification", {"rectification": 5.0}, "shaken", "ax", 2, 5e-6 * 1600 / GRAVITY),
        ("accel_dead_zone", {"half_width": 12.0}, "rate-flat", "az", 0, -12 * UG),
        ("converter_gain_drift_quadratic", {"curvature": 2.0}, "rate-flat", "az", 0, 50 * UG),
        ("converter_offset_drift_quadratic", {"curvature": 2e-4}, "rate-flat", "az", 0, 0.005 / ACCEL_SCALE),
        ("converter_nonlinearity", {"quadratic": 0.01, "cubic": 0.0}, "inject", "ax", 0, 0.24e-3 * 12 * GRAVITY),
        ("converter_nonlinearity", {"quadratic": 0.0, "cubic": 1e-6}, "inject", "ax", 0, 5.76e-4 * 12 * GRAVITY),
        ("converter_leakage", {"leakage": 0.02, "doubling": 5.0}, "rate-flat", "az", 0, 0.02 / ACCEL_SCALE),
        ("converter_dead_zone", {"half_width": 0.02}, "rate-flat", "az", 0, -0.02 / ACCEL_SCALE),
        ("converter_saturation", {"compression": 10.0, "limit": 8.0}, "inject", "ax", 0, -0.4 * GRAVITY),
        ("converter_warm_up", {"amplitude": 0.02, "tau": 10.0}, "cycle-slow", "az", 3, np.exp(-1.3) / 50 / ACCEL_SCALE),
    ],
)  # fmt: skip
def test_signs_and_sizes(name, value, run, channel, row, expected):
    coefficients = {n: 0.0 for n in value if n not in ("tau", "doubling", "limit")}
    if "dead_zone" in name:
        coefficients = dict.fromkeys(coefficients, 1e-9)
    still = outputs(name, run, channel, **(value | coefficients))[row]
    found = outputs(name, run, channel, **value)[row] - still
    assert found == pytest.approx(expected, rel=1e-6, abs=1e-13)


def change_beside(effect: str, value: float, run: str, channel: str, others: dict[str, float]) -> np.ndarray:
    """Return what the coefficient of an effect changes in a channel, (rows,) in SI, beside others that are not zero."""
    one, z = whole_catalogue(), at_null().copy()
    names = [parameter.name for parameter in one.layout.parameters]
    for name, other in others.items():
        z[names.index(name)] = one.layout.parameters[names.index(name)].prior.z(other)
    without = np.asarray(predict(one.problem, jnp.asarray(z)))
    z[names.index(effect)] = one.layout.parameters[names.index(effect)].prior.z(value)
    change = np.asarray(predict(one.problem, jnp.asarray(z))) - without
    runs, channels = [r.name for r in one.campaign.runs], [c.name for c in one.campaign.channels]
    chosen = (one.entries.run == runs.index(run)) & (one.entries.channel == channels.index(channel))
    return change[chosen] / (GYRO_SCALE if channel[0] == "g" else ACCEL_SCALE)


def test_the_asymmetry_is_of_the_input_along_the_true_axis():
    """Of the nominal axis |x| has a corner where a mounting error is 0, and fits of cross axes ended in it."""
    others = {f"gyro_misalignment.{name}[gx]": 600 * ARCSEC for name in ("toward_o", "toward_s")}
    change = change_beside("gyro_scale_asymmetry.asymmetry[gx]", 1e-4, "rate-flat", "gx", others)
    assert change[2] == pytest.approx(1e-4 * 600 * ARCSEC * (RATE - UP), rel=2e-3)


def test_the_asymmetry_is_not_of_what_is_added_to_the_input():
    """A drift by gravity that exceeds Earth rate: the scale factor is that of the input, as the standard has it."""
    others = {
        "gyro_g_sensitivity.d_i[gz]": -20 * HOUR / GRAVITY,
        "gyro_g2_sensitivity.d_ii[gz]": -9 * HOUR / GRAVITY**2,
    }
    change = change_beside("gyro_scale_asymmetry.asymmetry[gz]", 1e-4, "rate-flat", "gz", others)
    assert change[0] == pytest.approx(1e-4 * UP, rel=1e-6)
    others = {"accel_cross_axis_quadratic.k_oo[ay]": -2 / GRAVITY, "accel_cross_axis_quadratic.k_pp[ay]": -2 / GRAVITY}
    change = change_beside("accel_scale_asymmetry.asymmetry[ay]", 1e-4, "rate-flat", "ay", others)
    np.testing.assert_allclose(change, 0.0, atol=1e-12)


def test_a_temperature_rate_changes_the_bias():
    run = next(r for r in wide_campaign().runs if r.name == "cycle-slow")
    minutes, temperature = run.covariates["time"] / 60, run.covariates["temperature"]
    slope = [np.polyfit(minutes[k - 2 : k + 3], temperature[k - 2 : k + 3], 1)[0] for k in range(2, 14)]
    for name, channel, unit in (
        ("gyro_bias_temperature_rate", "gz", HOUR),
        ("accel_bias_temperature_rate", "az", UG),
    ):
        found = outputs(name, "cycle-slow", channel, slope=5.0) - outputs(name, "cycle-slow", channel, slope=0.0)
        np.testing.assert_allclose(found[2:14], 5 * unit * np.array(slope), rtol=1e-6)


def test_numpy_predicts_the_whole_catalogue_as_compiled_code_does():
    bound = whole_catalogue()
    problem, rng = bound.problem, np.random.default_rng(11)  # beside no corner of a formula
    z, along = rng.normal(size=(2, problem.size[0]))
    found = linearised_in_numpy(predict, problem, 0.3 * z)
    assert found is not None
    predicted, push = found
    steps = np.array([-2, -1, 1, 2]) * 3e-7
    at = np.stack([predict(problem, jnp.asarray(0.3 * z + step * along)) for step in (0.0, *steps)])
    scale = np.abs(at).max()
    np.testing.assert_allclose(predicted, at[0], rtol=1e-13, atol=1e-14 * scale)
    weights = np.array([1, -8, 8, -1]) / 36e-7
    wanted = weights @ at[1:]
    np.testing.assert_allclose(push(along), wanted, rtol=1e-6, atol=1e-7 * np.abs(wanted).max())
    wrong = np.where(np.arange(len(along)) == int(np.argmax(np.abs(along))), 0.0, along)
    assert np.abs(push(wrong) - wanted).max() > 1e-7 * np.abs(wanted).max()  # one parameter forgotten
