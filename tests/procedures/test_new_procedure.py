"""Adding a procedure is adding one record: check, simulate, fit, compare and classical then know it."""

import json

import numpy as np
import pytest

from imubayes.campaign import inspect_campaign
from imubayes.cli.main import run
from imubayes.display.figures.measurement import driver
from imubayes.procedures import PROCEDURES, Procedure, Reduction
from imubayes.procedures.base import PlannedRows, PlanRules
from imubayes.procedures.textbook import Estimate, measured
from imubayes.results.result import read_result
from imubayes.simulation.simulate import simulate_plan

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
    """At opposite positions gravity cancels in the mean; the output is 1 V per g."""
    found = []
    for each in runs:
        for channel, output in measured(each, campaign, "accelerometer"):
            name, sd = f"accel_bias.bias[{channel.name}]", np.std(output[::2], ddof=1) / np.sqrt(len(output))
            mean = float(np.mean(output))
            found.append(Estimate(name, each.name, 1e6 * mean, 1e6 * float(sd), "ug", "mean of two points"))
    return found


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


def test_a_registered_procedure_goes_through_every_command(campaign_folder, tmp_path, capsys):
    campaign, model, result = (str(tmp_path / name) for name in ("campaign", "model.toml", "result"))
    assert campaign == str(campaign_folder)
    for words in (
        ["check", campaign, "--model", model],
        ["fit", campaign, "--model", model, "--out", result, "--no-sample"],
        ["compare", result, "--every"],
        ["classical", campaign, "--result", result, "--json-output"],
    ):
        capsys.readouterr()
        assert run(words) == 0, words
    found = read_result(result)
    assert {*found.residuals.table["procedure"]} == {"two_positions"}
    assert np.abs(found.residuals.table["whitened"].to_numpy()).max() < 5
    assert driver(found.residuals.table).name == "table_angle"
    captions = json.loads((tmp_path / "result" / "figures" / "captions.json").read_text())
    assert {"run-two_points.png", "residuals-table-angle.png"} <= set(captions)
    assert all((tmp_path / "result" / "figures" / name).is_file() for name in captions)
    (estimate,) = json.loads(capsys.readouterr().out)["estimates"]
    assert (estimate["name"], estimate["method"]) == ("accel_bias.bias[ax]", "mean of two points")
    assert abs(estimate["difference"]) < 5 * estimate["sd"]


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
