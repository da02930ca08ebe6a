"""Outputs of an ideal unit, worked out by hand, and the signs of a few effects."""

import numpy as np
import pytest

from small_campaign import (
    ACCEL_SCALE,
    ARCSEC,
    DEGREE,
    GRAVITY,
    GYRO_SCALE,
    LATITUDE,
    campaign,
    predicted_with,
    whole_catalogue,
)

EARTH = 15.041067 * DEGREE / 3600
RATE = 100 * DEGREE
NORTH, UP = EARTH * np.cos(LATITUDE), EARTH * np.sin(LATITUDE)
OFFSET = {"gx": 0.0, "gy": 3.0, "gz": 6.0, "ax": 0.0, "ay": 0.0, "az": 0.0}


def outputs(run: str, channel: str, effect: str = "gyro_bias", label: str = "", **values: float) -> np.ndarray:
    """Return what a channel reads in each row of a run, nominal offset and scale taken out, in SI.

    All effects of the catalogue are in the model, at their nulls but for what is given.
    """
    bound = whole_catalogue()
    predicted = predicted_with(effect, label, **values)
    runs, channels = [r.name for r in bound.campaign.runs], [c.name for c in bound.campaign.channels]
    chosen = (bound.entries.run == runs.index(run)) & (bound.entries.channel == channels.index(channel))
    scale = GYRO_SCALE if channel[0] == "g" else ACCEL_SCALE
    return (predicted[chosen] - OFFSET[channel]) / scale


def test_a_unit_at_rest_measures_gravity_and_earth_rate():
    assert outputs("rate-flat", "az")[0] == pytest.approx(GRAVITY)
    assert outputs("rate-flat", "ax")[0] == pytest.approx(0.0, abs=1e-12)
    assert outputs("rate-flat", "gz")[0] == pytest.approx(UP, rel=1e-9)
    assert outputs("rate-flat", "gy")[0] == pytest.approx(NORTH, rel=1e-9)
    assert outputs("rate-flat", "gx")[0] == pytest.approx(0.0, abs=1e-15)


def test_whole_turns_average_out_the_horizontal_earth_rate():
    rates = campaign().runs[0].covariates["table_rate"]
    np.testing.assert_allclose(outputs("rate-flat", "gz"), rates + UP, rtol=1e-9)
    turning = rates != 0
    np.testing.assert_allclose(outputs("rate-flat", "gx")[turning], 0.0, atol=1e-15)


def test_the_pyramid_shares_rate_and_gravity_equally():
    rates = campaign().runs[1].covariates["table_rate"]
    for axis in "xyz":
        found = outputs("rate-pyramid", f"g{axis}")
        np.testing.assert_allclose(found[1:5], (rates[1:5] + UP) / np.sqrt(3), rtol=1e-9)
        resting = outputs("rate-pyramid", f"a{axis}")[0]
        assert resting == pytest.approx(GRAVITY / np.sqrt(3), rel=1e-9)


def test_gravity_on_a_dividing_head():
    # Axis horizontal, flat seat: table y points down at angle 0 (elevation 0: y_t = −Up), so f_x = −g sin φ.
    angle = np.arange(8) * np.pi / 4 + 0.1
    np.testing.assert_allclose(outputs("head-flat-20", "ax"), -GRAVITY * np.sin(angle), atol=1e-12)
    np.testing.assert_allclose(outputs("head-flat-20", "ay"), -GRAVITY * np.cos(angle), atol=1e-12)
    np.testing.assert_allclose(outputs("head-flat-20", "az"), 0.0, atol=1e-12)


def test_an_injected_current_stands_for_its_acceleration():
    np.testing.assert_allclose(outputs("inject", "ax"), 12 * GRAVITY, rtol=1e-12)
    spoiled = outputs("inject", "ax", "accel_scale_factor", "ax", scale=500.0)
    np.testing.assert_allclose(spoiled, 12 * GRAVITY, rtol=1e-12)  # the current bypasses the sensor


@pytest.mark.parametrize(
    ("name", "parameter", "value", "run", "channel", "row", "expected"),
    [
        ("gyro_scale_factor", "scale[gz]", 100.0, "rate-flat", "gz", 1, (RATE + UP) * (1 + 1e-4)),
        ("gyro_bias", "bias[gz]", 10.0, "rate-flat", "gz", 0, UP + 10 * DEGREE / 3600),
        ("accel_bias", "bias[az]", 50.0, "rate-flat", "az", 0, GRAVITY * (1 + 50e-6)),
        ("accel_quadratic", "quadratic[az]", 50.0, "rate-flat", "az", 0, GRAVITY * (1 + 50e-6)),
        ("gyro_g_sensitivity", "d_i[gz]", 10.0, "rate-flat", "gz", 0, UP + 10 * DEGREE / 3600),
        ("gyro_bias_temperature", "slope[gz]", 1.0, "rate-pyramid", "gz", 1, (RATE + UP) / 3**0.5 + DEGREE / 360),
        ("converter_gain_drift", "slope[az]", 10.0, "rate-flat", "az", 0, GRAVITY * (1 + 5e-5)),
        ("injection_error", "gain[ax]", 10.0, "inject", "ax", 0, 12 * GRAVITY * (1 + 1e-5)),
        ("injection_error", "offset[ax]", 12.0, "inject", "ax", 0, 12 * GRAVITY * (1 + 1e-6)),
        ("table_rate_error", "rate_error[rate]", 5.0, "rate-flat", "gz", 1, RATE * (1 + 5e-6) + UP),
        # z is tilted toward O = x by ε: it measures ε times the input of x.
        ("accel_misalignment", "toward_o[az]", 100.0, "head-flat-20", "az", 2, -GRAVITY * np.cos(0.1) * 100 * ARCSEC),
        # The body turned by +ε about x has its y axis raised: y measures +g·ε.
        ("mounting_error", "x[flat]", 100.0, "rate-flat", "ay", 0, GRAVITY * np.sin(100 * ARCSEC)),
        ("table_axis_tilt", "x[rate]", 10.0, "rate-flat", "ay", 0, GRAVITY * np.sin(10 * ARCSEC)),
        # At r along x from the axis, an accelerometer along x measures −(Ω² + 2Ω ω_E) r.
        ("lever_arm", "x[ax]", 10.0, "rate-flat", "ax", 1, -(RATE**2 + 2 * RATE * UP) * 0.010),
    ],
)  # fmt: skip
def test_signs_and_sizes(name, parameter, value, run, channel, row, expected):
    field, _, label = parameter.rstrip("]").partition("[")
    found = outputs(run, channel, name, label, **{field: value})[row]
    assert found == pytest.approx(expected, rel=3e-7, abs=1e-12)
