"""What one set of runs cannot distinguish is one answer with several names, and the run that separates them is named.

The simulator shares no code with the models.
"""

import hidden
import numpy as np
import pytest
from hidden_effects import RATES, SEATS
from kinematics import Site, Table
from plan import Plan, Row, Run, rate_table_rows
from random_plans import GYROS, RAW_RATE, mounting
from simulate import write_simulated

from imubayes.api import diagnose, fit
from imubayes.display.loop.diagnosis_report import diagnosis_json

pytestmark = pytest.mark.slow


def plan(runs, model):
    seats = dict.fromkeys(run.mounting for run in runs)
    return Plan(
        name="confounded", purpose="Two causes that look alike.", serial="C1", site=Site(34.25, 400.0), channels=GYROS,
        tables=(Table("rate", 0.0, 90.0, 20.0, 5.0),), mountings=tuple(mounting(seat) for seat in seats),
        runs=tuple(runs), model=model, script="hidden_effects",
    )  # fmt: skip


def diagnosed(folder, runs, without, values):
    """Simulate a campaign with something hidden, fit the model that lacks it, and diagnose."""
    folder.mkdir(exist_ok=True)
    model = folder / "model.toml"
    model.write_text(hidden.without("hidden-effects", without), encoding="utf-8")
    made = plan(runs, model)
    drawn = made.draw(7)
    quiet = {name: value * 0.01 for name, value in drawn.items() if name.startswith("run_scatter")}
    write_simulated(folder, made, 7, values={**drawn, **quiet, **values})
    return diagnosis_json(diagnose(fit(folder, model, sample=False)))


@pytest.mark.parametrize(
    "ppm", [12.0, pytest.param(60.0, marks=pytest.mark.xfail(reason="twelve times what the campaign states: no cause"))]
)
def test_table_rate_against_a_common_scale_factor(tmp_path, ppm):
    rows = rate_table_rows(RATES, np.full(2 + 2 * len(RATES), 25.0), RAW_RATE)
    runs = [Run(f"rate-{seat}", "rate_table", rows, "rate", seat) for seat in SEATS]
    document = diagnosed(
        tmp_path / "rates", runs, ["gyro_scale_factor", "table_rate_error"], {"table_rate_error.rate_error[rate]": ppm}
    )
    first = document["groups"][0]
    assert {"table_rate_error", "gyro_scale_factor"} <= set(first["effects"]), document["sentence"]
    assert "another table than 'rate'" in first["separating_run"]


def thermal(slope, hold):
    """A steady rise of the chamber after a hold, in rows of two minutes."""
    temperature = 10 + slope * 2.0 * np.maximum(np.arange(60) - hold, 0)
    rate = np.where(np.arange(60) >= hold, slope, 0.0)
    return [
        Row(120.0 * (k + 0.5), round(120 * RAW_RATE), float(temperature[k] + slope * (k >= hold)),
            temperature_rate=float(rate[k]))
        for k in range(60)
    ]  # fmt: skip


def test_lag_against_temperature_rate_in_one_ramp(tmp_path):
    """With a time constant below the length of a row the lag is a multiple of the rate, but for the corner."""
    ramp = Run("ramp", "thermal_ramp", thermal(0.4, 10), "rate", "z-up")
    rows = rate_table_rows(RATES, np.full(2 + 2 * len(RATES), 25.0), RAW_RATE)
    runs = [ramp, *(Run(f"rate-{seat}", "rate_table", rows, "rate", seat) for seat in SEATS)]
    lag = {f"gyro_thermal_lag.{name}[gz]": value for name, value in (("coefficient", 1.8), ("tau", 2.0))}
    document = diagnosed(tmp_path / "ramp", runs, [], lag)
    first = document["groups"][0]
    assert {"gyro_thermal_lag", "gyro_bias_temperature_rate"} <= set(first["effects"]), document["sentence"]
    assert "cycled" in first["separating_run"]
