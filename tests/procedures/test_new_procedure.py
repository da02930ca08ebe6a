"""Adding a procedure is adding one record: check, simulate, fit, compare and the textbook then know it."""

import numpy as np
import pytest

from imubayes.campaign import inspect_campaign, load_campaign
from imubayes.display.figures.measurement import driver
from imubayes.inference.run_fit import joint_fit
from imubayes.model.bind import bind
from imubayes.model.model_file import read_model
from imubayes.procedures import PROCEDURES, Procedure, Reduction
from imubayes.procedures.classical import classical
from imubayes.procedures.planned_steps import PlannedRows, PlanRules
from imubayes.procedures.textbook import Estimate, measured
from imubayes.results.residuals import residuals_of
from imubayes.simulation.simulated_campaign import simulate_plan

PLAN = """\
format = 1
name = "toy"
model = "model.toml"

[site]
latitude_deg = 45.0

[[channel]]
name = "ax"
kind = "accelerometer"
input_axis = [1, 0, 0]
output_unit = "V"
scale = 1.0
per = "g"
noise = 1e-4

[[table]]
name = "head"
elevation_deg = 0.0

[[mounting]]
name = "flat"
body_to_table = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]

[[run]]
name = "two points"
procedure = "two_positions"
table = "head"
mounting = "flat"
positions = 12
"""
MODEL = """\
format = 1
name = "toy"

[[effect]]
name = "accel_bias"

[[effect]]
name = "white_noise"
"""


def _planned_rows(steps):
    count = steps.positions
    return PlannedRows(np.full(count, steps.duration), {"table_angle_deg": 180.0 * (np.arange(count) % 2) + 90.0})


def _mean(campaign, runs):
    return [
        Estimate(f"accel_bias.bias[{channel.name}]", run.name, float(np.mean(output)), 0.0, "ug", "mean of two points")
        for run in runs
        for channel, output in measured(run, campaign, "accelerometer")
    ]


TOY = Procedure(
    name="two_positions",
    columns=(("table_angle_deg",),),
    needs_table=True,
    reduction=Reduction.AT_REST,
    abscissae=("table_angle",),
    plan=PlanRules(("positions",), rows=_planned_rows),
    evaluate=_mean,
)


@pytest.fixture
def campaign_folder(tmp_path, monkeypatch):
    monkeypatch.setitem(PROCEDURES, TOY.name, TOY)
    (tmp_path / "model.toml").write_text(MODEL)
    (tmp_path / "plan.toml").write_text(PLAN)
    return simulate_plan(tmp_path / "plan.toml", tmp_path / "campaign")


def test_a_registered_procedure_is_planned_read_fitted_compared_and_evaluated(campaign_folder):
    inspection = inspect_campaign(campaign_folder)
    assert inspection.issues == ()
    campaign = load_campaign(campaign_folder)
    assert campaign.runs[0].procedure == "two_positions"
    (estimate,) = classical(campaign)
    assert isinstance(estimate, Estimate)
    model = bind(read_model(campaign_folder.parent / "model.toml"), campaign)
    residuals = residuals_of(joint_fit(model, None)).table
    assert np.abs(residuals["whitened"].to_numpy()).max() < 5
    assert driver(residuals).name == "table_angle"


def test_what_a_record_asks_for_is_missed(campaign_folder):
    table = next((campaign_folder / "runs").glob("*.csv"))
    table.write_text(table.read_text().replace("table_angle_deg", "temperature_degC", 1))
    (issue,) = inspect_campaign(campaign_folder).issues
    assert issue.what == "a run of procedure 'two_positions' needs the column 'table_angle_deg'"


@pytest.mark.parametrize("procedure", PROCEDURES.values(), ids=lambda procedure: procedure.name)
def test_a_record_is_consistent(procedure):
    assert PROCEDURES[procedure.name] is procedure
    assert procedure.reference
    assert procedure.abscissae
    assert procedure.rate_recorded or procedure.reduction is Reduction.FOLLOWED
