"""Classical estimates beside the joint fit: the difference, and the part of it that the mounting angle explains."""

import io
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
import pytest
import synthetic_results as made
from rich.console import Console

from imubayes.campaign import load_campaign
from imubayes.cli.main import run
from imubayes.display.classical_comparison import (
    OfPrediction,
    classical_json,
    classical_sheet,
    compare_classical,
    decision_sheet,
    discrepancy_sheet,
    of_prediction,
    undetermined_sheet,
)
from imubayes.display.layout import terminal
from imubayes.procedures import PROCEDURES, classical
from imubayes.procedures.textbook import Estimate, Undetermined

ROOT = Path(__file__).parents[2]
TRIHEDRAL = 54.735610317245346
UNIT = "pulse/s per deg/s"
FOUND = [
    Estimate("scale_factor[gx]", "rate-pyramid", 1000.0, 0.001, UNIT, "m", "mounting_angle[gx,pyramid]", TRIHEDRAL),
    Estimate("nonlinearity[gx]", "rate-pyramid", 2.0, float("nan"), "ppm", "m"),
    Estimate("delta_k[ax,hot]", "hot, cold", 3.0, 1.0, "%", "m", decision="hot keeps its own line"),
    Undetermined("rate-pyramid", "not this"),
]


def summary(value, degrees):
    scale = made.quantity("scale_factor[gx]", UNIT, value, 0.002)
    angle = made.quantity("mounting_angle[gx,pyramid]", "deg", degrees, 1e-5)
    return made.summary_of(made.tumble_residuals(4), (), (scale, angle))


def test_the_angle_explains_the_difference():
    """The unit leans 10 arcsec further out than the drawing says: the classical k is 68.6 ppm too small."""
    comparison = compare_classical(FOUND, summary(1000.0686, TRIHEDRAL + 10 / 3600))
    facts = classical_json(comparison)
    first, second, *_ = facts["estimates"]
    assert first["of_angle"]["arcsec"] == pytest.approx(10, abs=1e-6)
    assert first["of_angle"]["ppm"] == pytest.approx(-68.6, abs=0.1)
    assert first["difference"] / 1000 * 1e6 == pytest.approx(-68.6, abs=0.1)
    assert second["joint"] is None
    assert second["sd"] is None
    row = [cell.text for cell in classical_sheet(comparison.estimates).rows[0]]
    assert "angle error 10.0 arcsec: -68.6 ppm" in row
    json.dumps(facts, allow_nan=False)


def test_a_narrow_terminal_keeps_both_numbers():
    sheet = classical_sheet(compare_classical(FOUND, summary(1000.0686, TRIHEDRAL)).estimates)
    buffer = io.StringIO()
    Console(file=buffer, width=80).print(terminal(sheet))
    lines = [line.rstrip() for line in buffer.getvalue().splitlines()]
    assert max(map(len, lines)) <= 80
    shown = next(line for line in lines if "scale_factor[gx]" in line)
    assert "1000.0000 ± 0.0010" in shown
    assert "1000.0686 ± 0.0020" in shown
    assert any(UNIT in line for line in lines)
    assert any("2.00000 ppm" in line for line in lines)


def test_without_a_fit_there_is_no_comparison():
    comparison = compare_classical(FOUND)
    assert len(classical_sheet(comparison.estimates).head) == 5
    assert [cell.text for cell in decision_sheet(comparison).rows[0]] == [
        "delta_k[ax,hot]",
        "hot keeps its own line",
        "",
    ]
    assert len(undetermined_sheet(comparison).rows) == 1


def test_on_the_command_line(capsys, monkeypatch):
    assert run(["classical", str(ROOT / "data" / "polar-tumble"), "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert any(one["name"] == "gyro_g_sensitivity.d_i[g]" for one in facts["estimates"])
    assert run(["classical", str(ROOT / "data" / "polar-tumble")]) == 0
    assert "Classical estimates" in capsys.readouterr().out
    assert run(["classical", str(ROOT / "data" / "desk-imu")]) == 0
    assert "scale_factor[az]" in capsys.readouterr().out
    monkeypatch.setitem(PROCEDURES, "free_tumble", replace(PROCEDURES["free_tumble"], evaluate=None))
    assert run(["classical", str(ROOT / "data" / "desk-imu")]) == 1
    assert "No classical evaluation" in capsys.readouterr().out
    assert run(["classical", str(ROOT / "data" / "none")]) == 2


@pytest.mark.parametrize(("of_prediction", "alarm"), [(1000.0005, False), (1000.01, True), (None, True)])
def test_no_alarm_where_predicted_outputs_give_the_same_estimate(of_prediction, alarm):
    """Beyond three sd of what the classical evaluation of the prediction gives, the alarm stays."""
    value = {} if of_prediction is None else {("scale_factor[gx]", "rate-pyramid"): of_prediction}
    predicted = OfPrediction(value, {}, {"rate-pyramid": -15.0})
    sheet = discrepancy_sheet(compare_classical(FOUND, summary(1000.0686, TRIHEDRAL), predicted))
    assert ("disagree" in sheet.title) == alarm
    assert ("evaluates runs at their own temperature" in sheet.note) != alarm
    assert any(cell.mood == "bad" for row in sheet.rows for cell in row) == alarm


def test_the_prediction_is_evaluated_like_the_measurement():
    campaign = load_campaign(ROOT / "data" / "geographic-tumble")
    table = pl.concat(
        pl.DataFrame({"run": run.name, "row": np.arange(run.rows), "channel": channel.name, "predicted": column})
        for run in campaign.runs
        for channel, column in zip(campaign.channels, run.observed.T, strict=True)
    )
    measured = compare_classical(classical(campaign), None, of_prediction(campaign, table, summary(1.0, 0.0)))
    known = [each for each in measured.estimates if np.isfinite(each.classical.sd)]
    assert known
    assert all(each.explained for each in known)
    # Fault planted: outputs that the fit predicts a per cent too large.
    other = of_prediction(campaign, table.with_columns(pl.col("predicted") * 1.01), summary(1.0, 0.0))
    assert not all(each.explained for each in compare_classical(classical(campaign), None, other).estimates)
