"""A diagnosis as it is read: the answer first, the evidence after, out of the JSON contract alone."""

import json

import numpy as np
import polars as pl
import pytest

from imubayes.criticism.model_history import Node, Tree, node_id
from imubayes.criticism.residual_covariates import ResidualCovariate
from imubayes.criticism.residual_evidence import Telling
from imubayes.display import diagnosis_report as shown
from imubayes.display.figures.history_steps import error_per_step_figure, history_figure
from imubayes.display.figures.residual_evidence import added_variable_figure
from imubayes.display.figures.save import before_after, save_telling, telling_abscissa
from imubayes.display.history_table import history_json, history_sheet
from imubayes.display.injection_report import planting_lines, planting_sheet
from imubayes.display.terminal import print_diagnosis, print_trials
from imubayes.errors import InputError

PNG = b"\x89PNG"


def line(effect: str, drop: float, p: float, value: float = 120.0) -> dict:
    coefficient = {"name": f"{effect}.size[gx]", "value": value, "sd": 12.0, "unit": "ppm"}
    found = {"effect": effect, "channels": ["gx"], "delta_chi2": drop, "dof": 1, "p_global": p, "shape": {}}
    return {**found, "coefficients": [coefficient]}


def diagnosis(verdict: str = "equivalent_effects") -> dict:
    first, second = line("gyro_scale_asymmetry", 98.4, 1e-18), line("gyro_scale_quadratic", 95.1, 3e-18)
    group = {"effects": [first["effect"], second["effect"]], "channels": ["gx"], "delta_chi2": 98.4, "dof": 1}
    group |= {"p_global": 1e-18, "candidates": [first, second], "separating_run": "one run at −300 deg/s"}
    hidden = {"effect": "accel_quadratic", "absorbed_by": [{"parameter": "run offsets", "share": 0.93}]}
    lacking = {"effect": "lever_arm", "absorbed_by": [], "needs": ["turning"], "reason": "no run supplies turning"}
    pattern = {"channel": "gx", "covariate": "table_rate", "test": "spline", "p": 1e-9, "shape": "Ω²"}
    pattern["coefficient"] = {"value": 0.3, "unit": "ppm"}
    return {
        "format": 1, "verdict": verdict, "sentence": "gx changes with |rate|.", "p_global": 1e-18, "threshold": 0.05,
        "groups": [group] if verdict == "equivalent_effects" else [],
        "ranking": [first, second, line("gyro_g_sensitivity", 2.0, 0.9)],
        "undetectable": [hidden, lacking], "structure": [pattern], "looks": 40.0,
        "next": "imubayes add gyro_scale_asymmetry --to R",
    }  # fmt: skip


def test_the_answer_comes_first(capsys):
    print_diagnosis(diagnosis(), None)
    out = capsys.readouterr().out
    lines = out.splitlines()
    assert lines[0] == "gx changes with |rate|."
    assert "98.4" in lines[1]
    assert "1e-18 after 40 looks" in lines[1]
    assert "one run at −300 deg/s" in lines[2]
    assert lines[3] == "next: imubayes add gyro_scale_asymmetry --to R"
    assert "93 % run offsets" in out
    assert "lever_arm (turning)" in " ".join(out.split())


def test_the_ranking_marks_groups_and_chances():
    sheet = shown.ranking_sheet(diagnosis())
    texts = [[cell.text for cell in row] for row in sheet.rows]
    assert [row[-1] for row in texts] == ["1", "1", ""]
    assert [row[-2].mood for row in sheet.rows] == ["bad", "bad", "dim"]
    assert "size[gx] 120 ± 12 ppm" in texts[0][2]
    assert sheet.narrow is not None
    assert len(shown.ranking_sheet(diagnosis(), "gyro_g_sensitivity").rows) == 1


def test_not_converged_is_not_ranked():
    facts = diagnosis("not_converged") | {"ranking": []}
    assert "not ranked" in " ".join(shown.diagnosis_lines(facts))


def test_the_class_of_the_strongest_pattern_is_given_and_none_is_refused():
    facts = diagnosis("unexplained_structure")
    with pytest.raises(InputError, match="no effect class"):
        shown.found_class(facts)
    facts["structure"] = [*facts["structure"], {"python": "class FoundShape: …"}]
    assert shown.found_class(facts) == "class FoundShape: …"


def test_a_kept_diagnosis_comes_back(tmp_path):
    shown.write_diagnosis(tmp_path, diagnosis(), "gx", "table_rate_deg_s")
    kept = shown.read_diagnosis(tmp_path)
    assert kept["telling"] == {"channel": "gx", "covariate": "table_rate_deg_s"}
    assert shown.screened_candidate(kept, "gyro_scale_quadratic")["delta_chi2"] == 95.1
    assert shown.screened_candidate(kept, "unknown") == {}
    (tmp_path / "diagnosis.json").write_text("{")
    assert shown.read_diagnosis(tmp_path) == {}


@pytest.mark.parametrize("with_covariate", [True, False])
def test_the_telling_picture(tmp_path, with_covariate):
    random = np.random.default_rng(0)
    rate = np.tile([-300.0, -100, 0, 100, 300], 12)
    explained = 1e-5 * np.abs(rate)
    residual = explained + 3e-4 * random.normal(size=60)
    covariate = ResidualCovariate("rate_i", "deg/s", rate, "rate") if with_covariate else None
    runs = np.repeat(["a", "b", "c"], 20)
    telling = Telling("gx", covariate, rate if with_covariate else explained, runs, residual, explained, "deg/s")
    assert save_telling(tmp_path, telling, diagnosis()).read_bytes()[:4] == PNG


def residual_table(size: float) -> pl.DataFrame:
    random = np.random.default_rng(1)
    temperature = np.tile(np.linspace(0, 40, 20), 3)
    noise = 1e-4 * random.normal(size=60)
    return pl.DataFrame(
        {
            "run": np.repeat(["a", "b", "c"], 20), "row": np.tile(np.arange(20), 3), "channel": ["gx"] * 60,
            "temperature_degC": temperature, "time_s": random.permutation(60).astype(float),
            "input_residual": noise + size * (temperature - 20), "input_sd": [1e-4] * 60, "input_unit": ["deg/s"] * 60,
        }
    )  # fmt: skip


def test_before_and_after_are_shown_against_what_tells():
    before, after = residual_table(1e-5), residual_table(0.0)
    drawn = before_after(before, after, "gyro_bias_temperature", {"gx": 1e-4})
    assert drawn is not None
    assert drawn.png()[:4] == PNG
    change = before["input_residual"].to_numpy() - after["input_residual"].to_numpy()
    assert telling_abscissa(before, change)[1] == "temperature / °C"
    assert telling_abscissa(before, change, "time_s")[1].startswith("time")
    # Planted fault: what follows nothing is shown by row.
    assert telling_abscissa(before, np.random.default_rng(2).normal(size=60))[1].startswith("row")
    assert before_after(before, after.with_columns(pl.lit("other").alias("run")), "x") is None


def node(title: str, parent: str | None, held_out: dict, selected: bool, taken: bool = True) -> Node:
    added = ({"effect": title, "channels": ["gx"]},) if parent else ()
    return Node(
        node_id("d", title, 0, parent or ""), title, parent, (), added, "", 300.0, 290.0,
        {"gx": (2e-4 if parent else 5e-4, "deg/s"), "ax": (1e-5, "g")}, {"expected": 90.0, "found": 88.0}, held_out,
        "d", title, 0, taken, "" if taken else "It did not converge.", selected,
    )  # fmt: skip


def tree() -> Tree:
    gain = {"delta": 40.2, "se": 6.1, "helped": 11, "of": 12, "by": "run", "verdict": "helps"}
    useless = gain | {"delta": -0.4, "se": 0.3, "helped": 5, "verdict": "not"}
    nodes = {
        "/r/a": node("first", None, {}, False),
        "/r/b": node("gyro_g_sensitivity", "../a", gain, True),
        "/r/c": node("gyro_scale_quadratic", "../b", useless, False),
        "/r/d": node("gyro_warm_up", "../a", {}, False, taken=False),
    }
    return Tree(nodes, {"/r/a": None, "/r/b": "/r/a", "/r/c": "/r/b", "/r/d": "/r/a"})


def test_the_tree_is_told():
    made = tree()
    assert [place for _, place in made.in_order()] == ["/r/a", "/r/b", "/r/c", "/r/d"]
    assert made.way_to("/r/c") == ("/r/a", "/r/b", "/r/c")
    assert made.selecting("/r/a") == {"/r/a": True, "/r/b": False, "/r/c": False, "/r/d": False}
    rows = [" ".join(cell.text for cell in row) for row in history_sheet(made).rows]
    assert rows[1].startswith("● └─ + gyro_g_sensitivity")
    assert rows[2].startswith("○    └─ + gyro_scale_quadratic")
    assert "no help" in rows[2]
    assert rows[3].startswith("✕")
    assert json.dumps(history_json(made))
    assert history_figure(history_json(made)["nodes"]).png()[:4] == PNG


def test_small_pictures():
    drawn = error_per_step_figure(["first", "+ gyro_g_sensitivity"], {"deg/s": [5e-4, 2e-4]}, {"deg/s": 1.9e-4})
    assert drawn.png()[:4] == PNG
    assert "noise of single rows" in drawn.caption
    x = np.linspace(-2, 2, 40)
    assert "slope 1.00" in added_variable_figure(x, x, ["a", "b"] * 20, "effect").axes[0].get_title(loc="left")


def test_planting_says_what_was_missed(capsys):
    missed = {"effect": "gyro_warm_up", "planted": [], "delta_chi2": 50.0, "verdict": "adequate", "detected": False}
    missed |= {"group_first": False, "first_group": [], "p_global": 0.3, "sentence": ""}
    null = {"draws": 20, "false_alarms": 1, "rate": 0.05, "interval_95": [0.001, 0.25], "allowed": 0.05}
    facts = {"campaign": "c", "model": "m", "size": {"delta_chi2": 50.0}, "effects": [missed], "detected": 0}
    facts |= {"group_first": 0, "skipped": [{"effect": "lever_arm", "reason": "no run"}], "null": null}
    print_trials(facts)
    out = " ".join(capsys.readouterr().out.split())
    assert "You would have missed: gyro_warm_up." in out
    assert "1 false alarms in 20 draws" in out
    assert planting_sheet(facts).rows[0][3].mood == "bad"
    assert any("lever_arm" in one for one in planting_lines(facts))
