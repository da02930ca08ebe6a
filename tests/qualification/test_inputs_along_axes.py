"""Output and converter temperature to acceleration, on readings written down from the truth of the shipped campaign."""

import tomllib
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from imubayes.foundations.errors import InputError
from imubayes.results.result import read_result
from imubayes_qualification.api.calibrated_unit import apply, correct, onboard_constants
from imubayes_qualification.display.corrected_readings import inputs_lines

ROOT = Path(__file__).parents[2]
TRUTH = tomllib.loads((ROOT / "data" / "accel-channel" / "truth.toml").read_text())["parameters"]

RUN = "inject-12g"


def readings(acceleration, temperature):
    """Outputs in pulse/s of the true unit: bias and scale factor, then gain and offset drift of the converter."""
    warmer = temperature - 25.0
    sensed = (1 + 1e-6 * TRUTH["accel_scale_factor.scale[ax]"]) * (acceleration + 1e-6 * TRUTH["accel_bias.bias[ax]"])
    gain = 1 + 1e-6 * TRUTH["converter_gain_drift.slope[ax]"] * warmer
    output = 20000.0 * sensed * gain + TRUTH["converter_offset_drift.slope[ax]"] * warmer
    return pl.DataFrame({"ax": output, "converter_temperature_degC": temperature})


@pytest.fixture(scope="module")
def result(accel_channel):
    return read_result(accel_channel)


@pytest.mark.slow
def test_the_acceleration_is_found_within_its_uncertainty(result):
    acceleration = np.repeat([0.5, 0.75, 1.0], 4)
    temperature = np.tile([15.0, 25.0, 35.0, 45.0], 3)
    found = apply(result, readings(acceleration, temperature)).table
    score = (found["ax_g"].to_numpy() - acceleration) / found["ax_calibration_sd_g"].to_numpy()
    assert np.abs(score).max() < 4
    # Fault planted: the nominal scale alone is off by thousands of µg, far beyond the uncertainty.
    assert (np.abs(found["ax"].to_numpy() / 20000 - acceleration) > 5 * found["ax_calibration_sd_g"].to_numpy()).any()
    # At 1 g scale factor and bias are known together far better than either alone.
    alone = next(one.sd for one in result.summary.parameters if one.name == "accel_bias.bias[ax]")
    at_1_g = found.filter(pl.col("converter_temperature_degC") == 25.0)["ax_calibration_sd_g"].to_numpy()[-1]
    assert at_1_g < 1e-6 * alone


def test_the_row_has_the_noise_of_its_samples(result):
    one = readings(np.array([1.0, 1.0]), np.array([25.0, 25.0])).with_columns(samples=pl.Series([1, 100]))
    found = apply(result, one).table
    white = found["ax_sd_g"].to_numpy() ** 2 - found["ax_calibration_sd_g"].to_numpy() ** 2
    assert white[0] == pytest.approx(100 * white[1], rel=1e-6)
    assert np.sqrt(white[0]) == pytest.approx(TRUTH["white_noise.sigma[ax]"] / 20000, rel=0.1)


def test_temperatures_beyond_the_calibration_are_noted(result):
    assert apply(result, readings(np.ones(2), np.array([25.0, 80.0]))).beyond["converter_temperature"] == 1
    found = apply(result, readings(np.ones(2), np.array([25.0, 26.0])))
    assert set(found.beyond.values()) == {0}
    assert found.incomplete == 0


def test_what_a_row_lacks_or_exceeds_is_told_of_single_channels_as_well(result):
    """Inputs beyond those of the runs, means of no samples, and temperatures that are none."""
    table = readings(np.array([1.0, 1.0, 1.0, 500.0]), np.full(4, 25.0)).with_columns(samples=pl.Series([1, 0, -3, 1]))
    found = apply(result, table)
    assert found.beyond["accelerometer"] == 1
    assert found.incomplete == 2
    assert found.table["ax_sd_g"].is_null().to_list() == [False, True, True, False]
    said = inputs_lines(found, True)
    assert "1 row beyond the largest specific force" in said[1]
    assert "2 rows without an output" in said[0]
    for value in (np.nan, np.inf, -300.0):
        with pytest.raises(InputError, match="a temperature of"):
            apply(result, table, temperatures={"converter_temperature": value})


def test_bad_readings_are_refused(result, tmp_path):
    table = readings(np.ones(2), np.array([25.0, 26.0]))
    for bad, what in (
        (table.drop("ax"), "no column is a channel"),
        (table.drop("converter_temperature_degC"), "depends on the converter temperature"),
        (table.with_columns(ax=pl.Series(["x", "y"])), "not numeric"),
    ):
        with pytest.raises(InputError, match=what):
            apply(result, bad)
    with pytest.raises(InputError, match="no such file"):
        apply(result, tmp_path / "missing.csv")


def test_what_a_unit_of_few_axes_is_told_to_do_works(result, tmp_path):
    """Constants of a matrix need three axes; `apply` on a table of readings does not."""
    for refused in (
        lambda: onboard_constants(result),
        lambda: correct(result, ROOT / "data" / "accel-channel", tmp_path / "out.csv", run=RUN),
    ):
        with pytest.raises(InputError, match="span three axes") as caught:
            refused()
        assert "apply" in caught.value.issues[0].remedy
    assert "ax_g" in apply(result, readings(np.ones(2), np.array([25.0, 26.0]))).table.columns
