"""Thermometers of whole degrees: between their steps the temperature is interpolated, never beyond rounding."""

import numpy as np
import pytest
from test_raw_logs import Columns

from imubayes.campaign.reduction import BlockBuilder, reduce_log
from imubayes.campaign.reduction.coarse_thermometer import coarse_temperatures
from imubayes.campaign.reduction.log_survey import BlockSurvey
from imubayes.campaign.run_tables import RowBatch
from imubayes.procedures import Reduction

TIME = np.arange(0.0, 2700.0, 0.1)
COURSES = {
    "warm-up": 20 + 38 * (1 - np.exp(-TIME / 900)),
    "cooling": 60 - 30 * TIME / 2700,
    "there and back": 20 + 15 * np.sin(TIME / 800),
    "soak": np.interp(TIME, [0, 600, 1800, 2700], [20.0, 40.2, 40.2, 25.0]),
}


def surveyed(columns: dict[str, np.ndarray]) -> BlockSurvey:
    columns = {"time_s": TIME, **columns}
    builder = BlockBuilder(tuple(columns))
    builder.push(RowBatch(0, len(TIME), columns, {}, {}))
    return builder.finish()


@pytest.mark.parametrize("course", COURSES)
@pytest.mark.parametrize("noise", [0.0, 0.05])
@pytest.mark.parametrize("step", [1.0, 0.5])
def test_the_temperature_between_steps(course: str, noise: float, step: float) -> None:
    true = COURSES[course]
    reading = step * np.round((true + noise * np.random.default_rng(1).normal(size=len(TIME))) / step)
    found = coarse_temperatures(surveyed({"temperature_degC": reading}))
    if noise > 0.05 * step:
        assert not found  # dithered: means of readings resolve it
        return
    values = found["temperature_degC"].values
    assert found["temperature_degC"].step == pytest.approx(step)
    # Of a stay between two steps no more is known than the reading.
    assert np.std(values - true) < (1.05 if course == "soak" else 0.5) * np.std(reading - true)
    assert np.abs(values - reading).max() <= 0.5 * step + 1e-9


@pytest.mark.parametrize(
    "reading",
    [
        np.repeat([20.0, 30.0, 40.0], 9000),
        COURSES["warm-up"],
        np.round(COURSES["warm-up"], 1),
        np.full(len(TIME), 20.0),
    ],
    ids=["set-points", "fine", "tenths", "constant"],
)
def test_other_temperatures_stay(reading: np.ndarray) -> None:
    assert not coarse_temperatures(surveyed({"temperature_degC": reading}))


def test_rows_of_a_ramp_have_the_temperature_between_the_steps() -> None:
    true = COURSES["warm-up"]
    columns = {"time_s": TIME, "temperature_degC": np.round(true), "a": true.copy()}
    rows = reduce_log(Columns(columns), Reduction.BINNED, len(TIME), surveyed(columns), None)
    # The channel `a` is the temperature itself, averaged over the same rows.
    assert np.std(rows.numbers["temperature_degC"] - rows.numbers["a"]) < 0.05
    assert "'temperature_degC' has steps of 1 °C: it is interpolated between the instants of its steps" in rows.notes
