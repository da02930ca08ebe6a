"""Covariates that the coefficients of effects multiply, against their formulas in words."""

import numpy as np
import pytest

from imubayes.effects import EFFECTS
from imubayes.responses import residual_covariates
from imubayes.responses.residual_covariates import MEMORY, covariates_of

CATALOGUE = {member.name: member for member in EFFECTS}
FORMULAS = [
    ("gyro_bias", "gyro", [set()]),
    ("gyro_bias_temperature", "gyro", [{"temperature_degC"}]),
    ("accel_scale_temperature", "accelerometer", [{"temperature_degC", "force_i"}]),
    ("gyro_scale_g_dependence", "gyro", [{"rate_i", "force_i"}]),
    ("gyro_misalignment", "gyro", [{"rate_o"}, {"rate_s"}]),
    ("gyro_g_sensitivity", "gyro", [{"force_i"}, {"force_o"}, {"force_s"}]),
    ("accel_cross_coupling", "accelerometer", [{"force_i", "force_o"}, {"force_i", "force_s"}]),
    ("converter_gain_drift", "gyro", [{"converter_temperature_degC", "rate_i"}]),
    ("converter_gain_hysteresis", "accelerometer", [{MEMORY, "force_i"}]),
    ("converter_offset_lag", "accelerometer", [{MEMORY}]),
    ("table_axis_tilt", "gyro", []),
]


@pytest.mark.parametrize(("name", "kind", "expected"), FORMULAS)
def test_a_coefficient_goes_with_the_covariates_of_its_formula(name, kind, expected):
    found = covariates_of(CATALOGUE[name], kind)
    assert sorted(map(sorted, found)) == sorted(map(sorted, expected))


def test_the_signal_itself_is_varied(monkeypatch):
    """Planted fault: if the generic signal is zero, a scale factor over temperature goes with nothing."""
    monkeypatch.setattr(residual_covariates, "_GENERIC", np.zeros(64))
    assert covariates_of(CATALOGUE["accel_scale_temperature"], "accelerometer") == (frozenset(),)
