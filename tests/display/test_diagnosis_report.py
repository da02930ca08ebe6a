"""A diagnosis as it is displayed: the answer first, then the evidence."""

import io
import json
from dataclasses import replace

import numpy as np
import polars as pl
import pytest
from matplotlib.collections import LineCollection
from rich.console import Console

from imubayes.criticism.detectability import Absorber, ParameterBias
from imubayes.criticism.diagnosis_record import (
    Amplitude,
    AskedEffect,
    ChainStage,
    CoefficientEstimate,
    CovariateLabel,
    Diagnosis,
    EffectGroup,
    GroupMember,
    RankedEffect,
    ResidualStructure,
    RivalExplanation,
    StrongestStructure,
    UndetectableEffect,
    UntypicalSize,
)
from imubayes.criticism.formula_search import FormulaTerm
from imubayes.criticism.held_out_record import CrossValidation
from imubayes.criticism.injection_recovery import Size, Trial, Trials
from imubayes.criticism.known_noise import KnownNoise
from imubayes.criticism.localised_structure import Step
from imubayes.criticism.model_history import ChannelRms, ChiSquareDrop, Node, Tree, node_id
from imubayes.criticism.noise_violation import NoiseComparison
from imubayes.criticism.residual_covariates import ResidualCovariate
from imubayes.criticism.residual_evidence import ResidualEvidence, input_times
from imubayes.criticism.verdict import EffectChoice, RmsChange, Suggestion, Verdict
from imubayes.display import diagnosis_report as shown
from imubayes.display.figures.evidence_pictures import (
    before_after,
    followed_covariate,
    save_evidence,
    save_recorded_noise,
)
from imubayes.display.figures.history_steps import ChannelSteps, error_per_step_figure
from imubayes.display.figures.residual_evidence import added_variable_figure
from imubayes.display.history_table import history_json, history_sheet
from imubayes.display.injection_report import injection_json, injection_report, injection_sheet
from imubayes.display.noise_violation_text import contradiction_text
from imubayes.display.report_layout import print_report
from imubayes.display.table_layout import terminal
from imubayes.errors import InputError
from imubayes.inference.candidate_runs import RunDesign
from imubayes.results.loop_files import read_diagnosis, write_diagnosis

PNG = b"\x89PNG"


def line(effect: str, drop: float, p: float, value: float = 120.0) -> RankedEffect:
    coefficient = CoefficientEstimate(name=f"{effect}.size[gx]", value=value, sd=12.0, unit="ppm")
    return RankedEffect(
        effect=effect, channels=("gx",), delta_chi2=drop, dof=1, p=p, p_global=p, within_runs=drop, shape={},
        coefficients=(coefficient,),
    )  # fmt: skip


def diagnosis(verdict: Verdict = "equivalent_effects", terms: tuple[FormulaTerm, ...] = ()) -> Diagnosis:
    ranked = (line("gyro_scale_asymmetry", 98.4, 1e-18), line("gyro_scale_quadratic", 95.1, 3e-18))
    members = tuple(GroupMember(unexplained=0.0, **vars(each)) for each in ranked)
    group = EffectGroup(
        effects=tuple(each.effect for each in ranked), channels=("gx",), delta_chi2=98.4, dof=1, p_global=1e-18,
        candidates=members, residual=RmsChange(channel="gx", before=2.8, after=1.5, unit="deg/h"),
        covariate=CovariateLabel(name="rate_i", unit="deg/s", phrase="rate along the input axis"),
        discriminating_run=RunDesign(procedure="rate_table", table="rate", mounting="x-up", max_rate_deg_s=300.0),
    )  # fmt: skip
    hidden = UndetectableEffect(
        effect="accel_quadratic", absorbed_by=(Absorber("run offsets", 0.93),), reason="absorbed", unit="ug/g^2"
    )
    lacking = UndetectableEffect(effect="lever_arm", reason="not_supplied", needs=("turning",))
    pattern = ResidualStructure(
        channel="gx", covariate="table_rate", test="spline", p=1e-9, shape="Ω²", kind="gyro", terms=terms,
        coefficient=Amplitude(value=0.3, sd=None, unit="ppm"),
    )  # fmt: skip
    return Diagnosis(
        verdict=verdict, message="It did not settle." if verdict == "not_converged" else "", p_global=1e-18, result="R",
        groups=(group,) if verdict == "equivalent_effects" else (),
        ranking=(*ranked, line("gyro_g_sensitivity", 2.0, 0.9)), undetectable=(hidden, lacking),
        structure=(pattern,), looks=40.0,
        strongest=StrongestStructure(channel="gx", covariates=(), step=Step("ramp", 3.0, "s")),
        suggested=Suggestion(effects=("gyro_scale_asymmetry",), channels=None)
        if verdict == "equivalent_effects" else None,
    )  # fmt: skip


def test_the_answer_comes_first(capsys):
    print_report(shown.diagnosis_report(diagnosis(), verbose=True))
    out = capsys.readouterr().out
    lines = out.splitlines()
    assert lines[0].startswith("gyro_scale_asymmetry is missing on gx. The residual of gx depends on rate along")
    assert "Δχ² 98.4" in lines[1]
    assert "p = 1e-18 corrected for 40 looks" in lines[1]
    assert "Discriminating run: rate_table on 'rate' in mounting 'x-up'" in lines[2]
    assert lines[3] == "next: imubayes add gyro_scale_asymmetry --to R --out R-gyro_scale_asymmetry"
    assert "93 % run offsets" in out
    assert "lever_arm (turning)" in " ".join(out.split())


def test_an_effect_that_would_do_in_place_of_wandering_noise_is_told():
    effect = EffectChoice(effect="gyro_bias_drift", channels=("gx",))
    rival = RivalExplanation(effects=(effect,), log_odds=1.0)
    found = Diagnosis(verdict="noise_model", wandering="instead", rivals=(rival,))
    [said] = shown.diagnosis_lines(found)
    assert "gyro_bias_drift on gx may be missing instead: record the unit at rest again" in said
    assert "missing instead" not in shown.diagnosis_lines(found.model_copy(update={"rivals": ()}))[0]


def test_wandering_noise_is_named_beside_the_effect_that_it_rivals():
    found = diagnosis().model_copy(update={"wandering": "rival", "suggested": None})
    report = shown.diagnosis_report(found)
    assert report.lines[0].startswith("Either gyro_scale_asymmetry is missing on gx, or the noise wanders")
    assert "Record the unit at rest again: a systematic drift repeats" in "\n".join(report.lines)
    assert shown.next_command(found) == "imubayes compare R"


@pytest.mark.parametrize("determined", [True, False])
def test_an_undetermined_stage_is_said(determined):
    found = diagnosis()
    stage = ChainStage(named="converter", sensor="gyro", determined=determined)
    group = found.groups[0].model_copy(update={"stage": stage})
    said = shown.sentence(found.model_copy(update={"groups": (group,)}))
    assert ("in the gyro or in its converter is not determined: drive the converter alone." in said) != determined


def test_the_ranking_marks_groups_and_chances():
    sheet = shown.ranking_sheet(diagnosis())
    texts = [[cell.text for cell in row] for row in sheet.rows]
    assert [row[-1] for row in texts] == ["1", "1", ""]
    assert [row[-2].mood for row in sheet.rows] == ["bad", "bad", "dim"]
    assert "size[gx] 120 ± 12 ppm" in texts[0][2]
    assert sheet.narrow is not None


@pytest.mark.parametrize(
    ("verdict", "said"),
    [
        ("missing_effect", "is missing"),
        ("adequate", "absent down to 3.00 ppm"),
        ("undetectable", "93 % in run offsets"),
    ],
)
def test_one_effect_is_answered_in_a_sentence(verdict, said):
    asked = AskedEffect(effect="accel_quadratic", smallest_detectable=3.0, unit="ppm")
    found = diagnosis("adequate").model_copy(update={"verdict": verdict, "asked": asked})
    (answer,) = shown.diagnosis_report(found).lines
    assert answer.startswith("These runs cannot show" if verdict == "undetectable" else "accel_quadratic is")
    assert said in answer
    assert shown.next_command(found) == ""


def test_not_converged_is_not_ranked():
    lines = shown.diagnosis_lines(diagnosis("not_converged"))
    assert lines[0] == "It did not settle."
    assert "not ranked" in " ".join(lines)


def test_the_class_of_the_strongest_pattern_is_given_and_none_is_refused():
    with pytest.raises(InputError, match="no effect class"):
        shown.effect_source(diagnosis("unexplained_structure"))
    term = FormulaTerm(
        shape="|Ω_i|", expression="jnp.abs(sample.rate[0])", needs=("turning",), value=0.3, sd=None, unit="ppm",
        delta_chi2=50.0, p_global=1e-9,
    )  # fmt: skip
    source = shown.effect_source(diagnosis("unexplained_structure", (term,)))
    compile(source, "found_shape.py", "exec")
    assert "import jax.numpy as jnp" in source
    assert 'name = "found_gyro_shape"' in source
    assert "needs = ('turning',)" in source
    assert "return signal + self.coefficient * jnp.abs(sample.rate[0])" in source


def test_a_kept_diagnosis_comes_back(tmp_path):
    write_diagnosis(tmp_path, diagnosis())
    kept = read_diagnosis(tmp_path)
    assert kept is not None
    assert kept.model_dump() == diagnosis().model_dump()
    best = kept.estimate("gyro_scale_quadratic")
    assert best is not None
    assert best.delta_chi2 == 95.1
    assert kept.estimate("unknown") is None
    (tmp_path / "diagnosis.json").write_text("{")
    assert read_diagnosis(tmp_path) is None


def test_the_json_has_the_sentence_and_the_next_command():
    facts = shown.diagnosis_json(diagnosis())
    assert facts["sentence"].startswith("gyro_scale_asymmetry is missing")
    assert facts["next"].startswith("imubayes add gyro_scale_asymmetry")
    group = facts["groups"][0]
    assert group["separating_run"] == "rate_table on 'rate' in mounting 'x-up', rates to ±300 deg/s"
    assert group["discriminating_run"]["max_rate_deg_s"] == 300.0
    assert json.dumps(facts)


@pytest.mark.parametrize("with_covariate", [True, False])
def test_the_picture_of_the_evidence(tmp_path, with_covariate):
    random = np.random.default_rng(0)
    rate = np.tile([-300.0, -100, 0, 100, 300], 12)
    explained = 1e-5 * np.abs(rate)
    residual = explained + 3e-4 * random.normal(size=60)
    covariate = ResidualCovariate("rate_i", "deg/s", rate, "rate") if with_covariate else None
    runs, at = np.repeat(["a", "b", "c"], 20), rate if with_covariate else explained
    evidence = ResidualEvidence("gx", "gyro_scale_asymmetry", covariate, at, runs, residual, explained, "deg/s")
    assert save_evidence(tmp_path, evidence).read_bytes()[:4] == PNG


def test_the_picture_of_a_response_that_is_the_input_times_a_function(tmp_path):
    """A parabola over temperature is shown over temperature, whatever the input."""
    random = np.random.default_rng(0)
    force, warm = np.tile(np.cos(np.linspace(0, 2 * np.pi, 24)), 5), np.repeat([-15.0, 5.0, 25.0, 40.0, 58.0], 24)
    known = [
        ResidualCovariate(name, unit, values, name)
        for name, unit, values in (
            ("force_i", "g", force), ("time_s", "s", np.tile(np.arange(24.0), 5)), ("temperature_degC", "degC", warm),
        )
    ]  # fmt: skip
    response = 1e-8 * force * (warm - 25) ** 2
    found = input_times(response, "accelerometer", known)
    assert found is not None
    assert found.covariate.name == "temperature_degC"
    # Faults planted: a response without the input, and one of no covariate.
    assert input_times(1e-8 * (warm - 25) ** 2, "accelerometer", known) is None
    assert input_times(random.normal(size=120), "accelerometer", known) is None
    # The angle of a table that a gyro drives has no input.
    assert input_times(response, "angle", known) is None
    residual, runs = response + 1e-6 * random.normal(size=120), np.repeat(["a", "b", "c", "d", "e"], 24)
    evidence = ResidualEvidence("ax", "effect", None, warm, runs, residual, response, "g", found)
    assert save_evidence(tmp_path, evidence).read_bytes()[:4] == PNG


def comparison(channel: str, ratio: float, p: float) -> NoiseComparison:
    return NoiseComparison(
        channel,
        8 * ratio,
        8.0,
        "samples",
        ratio,
        0.05 * ratio,
        p,
        False,
        "pulse/s",
        200.0,
        f"white_noise.sigma[{channel}]",
    )


def test_noise_that_disagrees_with_its_record_is_told():
    compared = (comparison("ax", 2.14, 1e-40), comparison("ay", 1.02, 0.4), comparison("az", 0.6, 1.0))
    found = diagnosis("adequate").model_copy(update={"recorded_noise": compared})
    assert "fitted noise of ax is 2.14 ± 0.11 times the known noise" in shown.sentence(found)
    assert "1 more channel disagrees" in shown.sentence(found)
    assert [row[0].text for row in shown.recorded_noise_sheet(found).rows] == ["ax", "az"]
    agreeing = found.model_copy(update={"recorded_noise": compared[1:2]})
    assert "known noise" not in shown.sentence(agreeing)


@pytest.mark.parametrize(("p", "told"), [(0.07, True), (0.4, False)])
def test_a_candidate_that_is_nearly_significant_is_told(p, told):
    ranked = (line("gyro_bias_drift", 15.3, p), line("gyro_warm_up", 2.0, 0.9))
    said = shown.sentence(diagnosis("adequate").model_copy(update={"ranking": ranked}))
    assert said.startswith("The model explains the data")
    assert ("The nearest to significance is gyro_bias_drift on gx, p = 0.07." in said) == told


@pytest.mark.parametrize(("in_sd", "told"), [(-663.0, True), (0.2, False)])
def test_what_an_undetectable_effect_would_do_is_told(in_sd, told):
    bias = ParameterBias("accel_bias.bias[ax]", "ug", 300.0, in_sd, "gravity_anomaly.anomaly[all]", 300.0, "ug")
    hidden = UndetectableEffect(effect="gravity_anomaly", reason="absorbed", bias=bias)
    said = shown.sentence(diagnosis("adequate").model_copy(update={"undetectable": (hidden,)}))
    sentence = (
        "No interval includes it: gravity_anomaly.anomaly[all] of 300 µg, the largest typical size, would bias "
        "accel_bias.bias[ax] by 663 of its sd."
    )
    assert (sentence in said) == told
    assert "1 effect of the catalogue is undetectable in these runs." in said


def test_excess_scatter_without_a_name_is_a_verdict_on_the_noise():
    found = diagnosis("noise_model").model_copy(update={"recorded_noise": (comparison("ax", 2.14, 1e-40),)})
    assert "scatter from row to row" in shown.sentence(found)
    assert "2.14 ± 0.11" in shown.sentence(found)
    assert shown.next_command(found) == "imubayes compare R"


def test_noise_that_contradicts_what_is_known_is_said_first():
    """Whatever the verdict, and once: after the groups it may agree, before them it does not."""
    told = (comparison("ax", 53.0, 1e-300), comparison("ay", 2.14, 1e-40))
    found = diagnosis().model_copy(update={"contradicted": told})
    said = shown.sentence(found)
    assert said.startswith(
        "white_noise.sigma[ax], 424 pulse/s, is 53.0 ± 2.7 times what the raw samples of the same rows"
    )
    assert (
        "an effect or noise slower than a row; white_noise.sigma[ay] likewise. gyro_scale_asymmetry is missing" in said
    )
    alone = diagnosis("noise_model").model_copy(update={"contradicted": told, "recorded_noise": told})
    assert "times the known noise" not in shown.sentence(alone)
    scatter = NoiseComparison(
        "gx", 7.7, 3.0, "prior", 2.6, 2.6, 0.2, False, "LSB", 0.0, "run_scatter.tau[gx]", (), True
    )
    sisters = replace(scatter, source="sisters", ratio=38.0, p=1e-6, sisters=("gy", "gz"))
    assert contradiction_text((sisters, scatter)) == (
        "run_scatter.tau[gx], 7.70 LSB, is 38 times that of gy and gz by the means of their runs and 2.6 times the "
        "scale of its prior: scatter between runs stands in for something that the model lacks"
    )
    assert contradiction_text((replace(scatter, p=1e-6),)).endswith("or the prior is too narrow for this unit")


def test_the_picture_of_the_recorded_noise(tmp_path):
    scatter, runs = np.random.default_rng(0).normal(size=60), np.repeat(["a", "b", "c"], 20)
    record = KnownNoise((comparison("ax", 2.14, 1e-40), comparison("ay", 1.0, 0.5)), np.repeat("ax", 60), runs, scatter)
    assert save_recorded_noise(tmp_path, record).read_bytes()[:4] == PNG


def test_more_that_remains_is_said_beside_the_first_effect():
    assert "diagnose again" not in shown.sentence(diagnosis())
    assert "diagnose again" in shown.sentence(diagnosis().model_copy(update={"more_remains": True}))


def test_an_effect_of_unusual_size_is_said_to_be_one():
    assert "typical" not in shown.sentence(diagnosis())
    size = UntypicalSize(name="station_level.north[all]", value=-1456.0, largest=60.0, unit="arcsec")
    group = diagnosis().groups[0].model_copy(update={"beyond_typical": (size,)})
    said = shown.sentence(diagnosis().model_copy(update={"groups": (group,)}))
    assert "station_level.north[all] would be -1460 arcsec, beyond the typical range (up to 60.0)" in said


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


def test_before_and_after_are_shown_against_the_covariate():
    before, after = residual_table(1e-5), residual_table(0.0)
    drawn = before_after(before, after, "gyro_bias_temperature", {"gx": 1e-4})
    assert drawn is not None
    assert drawn.png()[:4] == PNG
    change = before["input_residual"].to_numpy() - after["input_residual"].to_numpy()
    assert followed_covariate(before, change).label == "temperature / °C"
    assert followed_covariate(before, change, "time_s").label.startswith("time")
    # Planted fault: what follows nothing is shown by row.
    assert followed_covariate(before, np.random.default_rng(2).normal(size=60)).label.startswith("row")
    # A change of the scale factor with temperature, in rows of both signs of the input: its ratio is shown.
    stimulus = np.where(before["row"].to_numpy() % 2, 50.0, -50.0)
    observed = before.with_columns(pl.Series("input_observed", stimulus))
    scaled = followed_covariate(observed, change * stimulus)
    assert scaled.label == "temperature / °C"
    assert scaled.over is not None
    assert followed_covariate(observed, change).over is None
    ratio = observed.with_columns(input_residual=pl.col("input_residual") * pl.col("input_observed"))
    assert before_after(ratio, after, "gyro_scale_temperature") is not None
    assert before_after(before, after.with_columns(pl.lit("other").alias("run")), "x") is None


def node(title: str, parent: str | None, held_out: CrossValidation | None, selected: bool, taken: bool = True) -> Node:
    return Node(
        id=node_id("d", title, 0, parent or ""), model=title, parent=parent, chi2=300.0, dof=290.0,
        added=(EffectChoice(effect=title, channels=("gx",)),) if parent else (),
        rms=(
            ChannelRms(channel="gx", rms=2e-4 if parent else 5e-4, unit="deg/s"),
            ChannelRms(channel="ax", rms=1e-5, unit="g"),
        ),
        delta_chi2=ChiSquareDrop(predicted=90.0, observed=88.0), held_out=held_out, data_hash="d", model_hash=title,
        seed=0, taken=taken, message="" if taken else "It did not converge.", selected=selected,
    )  # fmt: skip


def tree() -> Tree:
    gain = CrossValidation(by="run", delta=40.2, se=6.1, helped=11, of=12, verdict="helps")
    useless = CrossValidation(by="run", delta=-0.4, se=0.3, helped=5, of=12, verdict="not")
    nodes = {
        "/r/a": node("first", None, None, False),
        "/r/b": node("gyro_g_sensitivity", "../a", gain, True),
        "/r/c": node("gyro_scale_quadratic", "../b", useless, False),
        "/r/d": node("gyro_warm_up", "../a", None, False, taken=False),
    }
    return Tree(nodes, {"/r/a": None, "/r/b": "/r/a", "/r/c": "/r/b", "/r/d": "/r/a"})


def test_the_tree_is_told():
    made = tree()
    assert [place for _, place in made.in_order()] == ["/r/a", "/r/b", "/r/c", "/r/d"]
    assert made.path_to("/r/c") == ("/r/a", "/r/b", "/r/c")
    assert made.together_with("/r/c") == ("/r/a", "/r/b", "/r/c", "/r/d")
    rows = [" ".join(cell.text for cell in row) for row in history_sheet(made).rows]
    assert rows[1].startswith("● └ + gyro_g_sensitivity")
    assert rows[2].startswith("○   └ + gyro_scale_quadratic")
    assert "no gain" in rows[2]
    assert rows[3].startswith("✕")
    assert json.dumps(history_json(made))
    narrow = history_sheet(made).narrow
    assert narrow is not None
    console = Console(width=80, record=True, file=io.StringIO())
    console.print(terminal(history_sheet(made)))
    lines = console.export_text().splitlines()
    assert any(line.strip().startswith("○   └ + gyro_scale_quadratic ") for line in lines), (
        "no name is broken at 80 columns"
    )


def test_a_noise_effect_is_not_punished_by_the_error_per_step():
    """Noise that was too small moves the bar to the line; the channel counts as changed though its rms did not."""
    noise_step = ChannelSteps("gx", "deg/s", [5e-4, 5e-4], [2e-4, 5e-4])
    assert noise_step.changed
    assert not ChannelSteps("gy", "deg/s", [5e-4, 5.05e-4], [5e-4, 5e-4]).changed
    drawn = error_per_step_figure(["first", "+ run_scatter"], [noise_step])
    assert drawn.png()[:4] == PNG
    bars = [each for each in drawn.axes[0].collections if isinstance(each, LineCollection)]
    heights = np.concatenate([each.get_segments() for each in bars])[:, 0, 1]
    assert heights[1] == pytest.approx(2.5 * heights[0])
    assert heights[1] == pytest.approx(np.asarray(drawn.axes[0].lines[0].get_ydata())[1])


def test_small_pictures():
    x = np.linspace(-2, 2, 40)
    assert "slope 1.00" in added_variable_figure(x, x, ["a", "b"] * 20, "effect").axes[0].get_title(loc="left")


def test_injection_names_what_was_missed(capsys):
    trial = Trial("gyro_warm_up", (), 50.0, Diagnosis(verdict="adequate", p_global=0.3))
    quiet: tuple[Verdict, ...] = ("adequate",) * 19
    nulls: tuple[Verdict, ...] = ("missing_effect", *quiet)
    trials = Trials("c", "m", Size(), 0, (trial,), {"lever_arm": "no run"}, nulls, 0.05)
    print_report(injection_report(trials))
    out = " ".join(capsys.readouterr().out.split())
    assert "Missed: gyro_warm_up." in out
    assert "1 false alarms in 20 draws" in out
    assert "lever_arm" in out
    assert injection_sheet(trials).rows[0][3].mood == "bad"
    assert injection_json(trials)["null"]["rate"] == 0.05
