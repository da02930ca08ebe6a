"""A diagnosis as it is displayed: the most probable explanation first, then what supports it."""

import io
import json
import shlex
from dataclasses import replace

import numpy as np
import polars as pl
import pytest
from matplotlib.collections import LineCollection
from rich.console import Console

from display.made_diagnoses import ASYMMETRY, diagnosis, evidence, line
from imubayes.adequacy.adequacy_record import ChannelRms, Disagreement, NoiseComparison
from imubayes.adequacy.known_noise import KnownNoise
from imubayes.criticism.diagnosis_record import (
    AskedEffect,
    ResidualFormula,
    UndetectableEffect,
    UntypicalSize,
)
from imubayes.criticism.explanation_records import (
    EffectChoice,
    FormulaTerm,
    FoundForm,
    FoundNoise,
    NeglectedUncertainty,
    ParameterBias,
    Suggestion,
    Verdict,
)
from imubayes.criticism.residual_evidence import ResidualEvidence, input_times
from imubayes.display.figures.history_steps import ChannelSteps, error_per_step_figure
from imubayes.display.figures.residual_evidence import (
    added_variable_figure,
    before_after,
    followed_covariate,
    save_evidence,
    save_recorded_noise,
)
from imubayes.display.fit_cautions import contradiction_text
from imubayes.display.layout import print_report, terminal
from imubayes.display.loop import diagnosis_report as shown
from imubayes.display.loop.change_report import injection_json, injection_report, injection_sheet
from imubayes.display.loop.diagnosis_sentences import sentence
from imubayes.display.loop.history import history_json, history_sheet
from imubayes.display.numbers_and_labels import command_line
from imubayes.foundations.errors import InputError
from imubayes.foundations.wrong_records import WrongRecord
from imubayes.loop.injection_recovery import Size, Trial, Trials
from imubayes.loop.model_history import ChiSquareDrop, CrossValidation, Node, Tree, node_id
from imubayes.responses.residual_covariates import ResidualCovariate
from imubayes.results.change_records import read_diagnosis, write_diagnosis
from imubayes.results.folder_files import RESIDUALS, SUMMARY
from kept_results import listed

PNG = b"\x89PNG"
TAILS = (FoundNoise(channels=("gx",), family="tails", scale=1.2),)
THERMAL = FoundForm(name="function of temperature", channels=("gx",), log_odds=80.0)


def test_the_answer_comes_first(capsys):
    print_report(shown.diagnosis_report(diagnosis(), verbose=True))
    out = capsys.readouterr().out
    lines = out.splitlines()
    assert lines[:6] == [
        "gyro_scale_asymmetry is missing on gx. The residual of gx depends on rate along the input axis. "
        "gyro_scale_quadratic would fit as well in place of gyro_scale_asymmetry: these runs cannot distinguish them.",
        "Probability: an effect missing 0.998 (gyro_scale_asymmetry or gyro_scale_quadratic on gx, shares 0.54, 0.46); "
        "nothing missing < 0.001.",
        "Predicted with gyro_scale_asymmetry added: Δχ² 98.4 at the noise known beforehand; residual of gx 2.80 → 1.50 "
        "deg/h rms.",
        "A run that would distinguish gyro_scale_asymmetry, gyro_scale_quadratic: rate_table on 'rate' in mounting "
        "'x-up', rates to ±300 deg/s.",
        "next: imubayes add gyro_scale_asymmetry --to R --out R-gyro_scale_asymmetry",
        "or, with every effect that fits equally well: "
        "imubayes add gyro_scale_asymmetry gyro_scale_quadratic --to R --out R-all",
    ]
    assert "93 % run offsets" in out
    assert "a run that turns (lever_arm)" in " ".join(out.split())


@pytest.mark.parametrize(
    ("verdict", "probability", "said", "command"),
    [
        ("adequate", 0.998, "The model explains the data: no effect of the catalogue is missing", "plant --result R"),
        (
            "adequate",
            0.62,
            "The model probably explains the data (probability 0.62): the most probable explanation is that nothing "
            "is missing",
            "plant --result R",
        ),
        ("missing_effect", 0.62, "gyro_scale_asymmetry is probably missing on gx (probability 0.62 for its", "add"),
        ("missing_effect", 0.42, "gyro_scale_asymmetry is possibly missing on gx (probability 0.42 for its", "add"),
        ("noise_model", 0.998, "The noise is not as modelled: heavy tails on gx. No effect explains it.", "compare R"),
        ("noise_model", 0.62, "The noise is probably not as modelled (probability 0.62): heavy tails", "compare R"),
        (
            "unexplained_structure",
            0.998,
            "A cause outside the catalogue acts: function of temperature on gx.",
            "compare",
        ),
        ("unexplained_structure", 0.62, "A cause outside the catalogue probably acts (probability 0.62)", "compare R"),
    ],
)
def test_what_is_in_doubt_is_told_with_its_probability(verdict, probability, said, command):
    form = THERMAL if verdict == "unexplained_structure" else None
    found = diagnosis(verdict, probability, form, TAILS if verdict == "noise_model" else ())
    assert sentence(found).startswith(said)
    assert shown.next_command(found).startswith(f"imubayes {command}")


def test_noise_that_the_model_lacks_is_what_to_add():
    found = diagnosis("noise_model", noise=TAILS)
    found = found.model_copy(update={"suggested": Suggestion(effects=("outliers",), channels=None)})
    assert "With the noise corrected, no effect is missing." in sentence(found)
    assert shown.next_command(found) == "imubayes add outliers --to R --out R-outliers"
    (sheet,) = shown.leading_sheets(found)
    assert [cell.text for cell in sheet.rows[0]] == ["heavy tails on gx", "1.20"]


@pytest.mark.parametrize(("row", "probability"), [(None, 0.998), (3, 0.62)])
def test_a_wrong_record_is_told_with_what_would_agree(row, probability):
    cause = WrongRecord(
        run="A", row=row, form="offset", quantity="temperature_degC", unit="degC", recorded=20.0, agreeing=(25.13,),
        sd=(0.11,), probability=0.9,
    )  # fmt: skip
    other = replace_record(cause, form="factor", quantity="table_rate_deg_s", unit="1", recorded=1.0, agreeing=(1.1,))
    wrong = Disagreement(run="A", row=row, log_odds=40.0, causes=(cause, other), instead=("B",))
    found = diagnosis("run_disagrees", probability).model_copy(update={"disagreeing": (wrong,)})
    said = sentence(found)
    if row is None:
        assert said.startswith("Run A does not agree with the other runs. It would agree given temperature_degC about")
        assert "Add +5.13 to column 'temperature_degC' of run 'A' if the record confirms it" in said
        assert said.endswith("or leave the run out; then fit again.")
    else:
        assert said.startswith(
            "Row 3 of run A probably does not agree with the other rows (probability 0.62). It would"
        )
        assert "Write 25.13 in column 'temperature_degC', row 3 of run 'A' if the record confirms it" in said
        assert said.endswith("or leave the row out; then fit again.")
    assert "It would agree as well given table_rate_deg_s times 1.10 ± 0.11" in said
    assert "Alternatively the record of B is wrong." in said


def test_a_prior_that_the_data_contradict_is_told_with_its_remedy():
    cause = WrongRecord(
        form="prior", quantity="accel_bias.bias[ax]", unit="1", recorded=0.0, agreeing=(-26.2,), sd=(0.4,),
        probability=1.0,
    )  # fmt: skip
    wrong = Disagreement(run="", row=None, log_odds=300.0, causes=(cause,))
    said = sentence(diagnosis("run_disagrees", 0.998).model_copy(update={"disagreeing": (wrong,)}))
    assert "the fitted accel_bias.bias[ax] is 26 prior standard deviations from its prior" in said
    assert "State a wider prior" in said
    assert "run" not in said


def replace_record(record: WrongRecord, **changed) -> WrongRecord:
    return record.model_copy(update=changed)


def test_a_second_missing_effect_is_told_beside_the_first():
    first = diagnosis().groups[0].model_copy(update={"candidates": diagnosis().groups[0].candidates[:1]})
    second = first.model_copy(update={"candidates": diagnosis().groups[0].candidates[1:], "probability": 0.7})
    found = diagnosis().model_copy(update={"groups": (first, second), "delta_chi2": 120.0})
    assert "gyro_scale_quadratic is probably also missing on gx (probability 0.70)." in sentence(found)
    assert (
        "Predicted with gyro_scale_asymmetry, gyro_scale_quadratic added: Δχ² 120 at the noise known beforehand; "
        "residual of gx 2.80 → 1.50 deg/h rms (with gyro_scale_asymmetry alone added)."
    ) in shown.diagnosis_lines(found)


def test_the_ranking_marks_groups_and_probabilities():
    found = diagnosis().model_copy(update={"ranking": (line(ASYMMETRY, 98.4, 0.9996), line("gyro_warm_up", 2.0, 1e-5))})
    sheet = shown.ranking_sheet(found)
    texts = [[cell.text for cell in row] for row in sheet.rows]
    assert [row[-1] for row in texts] == ["1", ""]
    assert [(row[-2].text, row[-2].mood) for row in sheet.rows] == [("> 0.999", "bad"), ("< 0.001", "dim")]
    assert "size[gx] 120 ± 12 ppm" in texts[0][2]
    assert sheet.narrow is not None


@pytest.mark.parametrize(
    ("verdict", "missing", "said"),
    [
        ("missing_effect", 0.97, "accel_quadratic, or an effect that resembles it, is missing (probability 0.97)."),
        ("missing_effect", 0.6, "accel_quadratic, or an effect that resembles it, is probably missing (probability"),
        ("adequate", 0.02, "accel_quadratic is absent down to 3.00 ppm, the size that is detected with a probability"),
        ("adequate", 0.4, "accel_quadratic may be missing (probability 0.40); 3.00 ppm would be detected with"),
        ("undetectable", 0.02, "These runs cannot show accel_quadratic: absorbed by the model, 93 % in run offsets."),
    ],
)
def test_one_effect_is_answered_in_a_sentence(verdict, missing, said):
    asked = AskedEffect(effect="accel_quadratic", smallest_detectable=3.0, unit="ppm")
    weighed = evidence({"nothing": 1 - missing, "effects": missing}, inclusion={"accel_quadratic": missing})
    found = diagnosis("adequate").model_copy(update={"verdict": verdict, "asked": asked, "explanations": weighed})
    (answer,) = shown.diagnosis_report(found).lines
    assert answer.startswith(said)
    assert shown.next_command(found) == ""


def test_what_is_said_of_a_fit_that_did_not_converge():
    lines = shown.diagnosis_lines(diagnosis("not_converged"))
    assert lines == ["It did not settle."], "nothing is weighed without a mode"
    weighed = diagnosis("not_converged").model_copy(update={"explanations": evidence({"nothing": 0.95})})
    first, *_, last = shown.diagnosis_lines(weighed)
    assert first.startswith(
        "It did not settle. At the point at which the fit stopped, nothing is missing with probability 0.95."
    )
    assert last == "All statements refer to the point at which the fit stopped, and are provisional."
    unsampled = diagnosis().model_copy(update={"message": "Too few draws."})
    assert shown.diagnosis_lines(unsampled)[-1].endswith("All statements refer to its mode.")


def formula(shape: str = "|Ω_i|", expression: str = "jnp.abs(sample.rate[0])") -> ResidualFormula:
    term = FormulaTerm(
        shape=shape, expression=expression, needs=("turning",), value=0.3, sd=0.02, unit="ppm", delta_chi2=50.0,
        log_odds=19.0,
    )  # fmt: skip
    return ResidualFormula(channel="gx", kind="gyro", shape=shape, terms=(term,), inclusion=0.9, near=("Ω_i²",))


def test_the_class_of_a_cause_outside_the_catalogue_is_given_and_none_is_refused():
    found = diagnosis("unexplained_structure", form=THERMAL)
    with pytest.raises(InputError, match="no effect class"):
        shown.effect_source(found)
    found = found.model_copy(update={"formulas": (formula(),)})
    source = shown.effect_source(found)
    compile(source, "found_shape.py", "exec")
    assert "import jax.numpy as jnp" in source
    assert 'name = "found_gyro_shape"' in source
    assert "needs = ('turning',)" in source
    assert "return signal + self.coefficient * jnp.abs(sample.rate[0])" in source
    assert shown.next_command(found).startswith("imubayes diagnose R --python > found_shape.py && imubayes add")
    sheet, _ = shown.leading_sheets(found)
    assert [cell.text for cell in sheet.rows[0]] == ["gx", "|Ω_i|", "0.300 ± 0.020 ppm", "50.0", "19.0"]


def test_a_kept_diagnosis_comes_back(tmp_path):
    for name in (SUMMARY, RESIDUALS):
        (tmp_path / name).touch()
    write_diagnosis(listed(tmp_path), diagnosis())
    kept = read_diagnosis(tmp_path)
    assert kept is not None
    assert kept.model_dump() == diagnosis().model_dump()
    best = kept.estimate("gyro_scale_quadratic")
    assert best is not None
    assert best.delta_chi2 == 95.1
    assert kept.estimate("unknown") is None
    (tmp_path / "diagnosis.json").write_text('{"format": 1}')  # of an earlier version
    assert read_diagnosis(listed(tmp_path)) is None


def test_the_json_has_the_sentence_and_the_next_command():
    facts = shown.diagnosis_json(diagnosis().model_copy(update={"formulas": (formula(),)}))
    assert facts["format"] == 2
    assert facts["sentence"].startswith("gyro_scale_asymmetry is missing")
    assert facts["next"].startswith("imubayes add gyro_scale_asymmetry")
    assert facts["explanations"]["explanations"][2] == {"kind": "effects", "probability": 0.998, "log_odds": 0.0}
    group = facts["groups"][0]
    assert group["effects"] == ["gyro_scale_asymmetry", "gyro_scale_quadratic"]
    assert group["separating_run"] == "rate_table on 'rate' in mounting 'x-up', rates to ±300 deg/s"
    assert group["discriminating_run"]["max_rate_deg_s"] == 300.0
    assert "class FoundShape" in facts["formulas"][0]["python"]
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
    assert "fitted noise of ax is 2.14 ± 0.11 times the known noise" in sentence(found)
    assert "The fitted noise of 1 other channel also differs from the known noise." in sentence(found)
    assert [row[0].text for row in shown.recorded_noise_sheet(found).rows] == ["ax", "az"]
    agreeing = found.model_copy(update={"recorded_noise": compared[1:2]})
    assert "known noise" not in sentence(agreeing)


@pytest.mark.parametrize(("in_sd", "told"), [(-663.0, True), (0.2, False)])
def test_what_an_undetectable_effect_would_do_is_told(in_sd, told):
    bias = ParameterBias("accel_bias.bias[ax]", "ug", 300.0, in_sd, "gravity_anomaly.anomaly[all]", 300.0, "ug")
    hidden = UndetectableEffect(effect="gravity_anomaly", reason="absorbed", bias=bias)
    said = sentence(diagnosis("adequate").model_copy(update={"undetectable": (hidden,)}))
    clause = (
        "No interval includes it. Worst case: gravity_anomaly.anomaly[all] at its largest typical size, 300 µg, "
        "would bias "
        "accel_bias.bias[ax] by 663 standard deviations."
    )
    assert (clause in said) == told
    assert "1 effect of the catalogue is undetectable in these runs." in said


def test_noise_that_contradicts_what_is_known_is_said_first_where_no_effect_explains_it():
    told = (comparison("ax", 53.0, 1e-300), comparison("ay", 2.14, 1e-40))
    noisy = diagnosis("noise_model", noise=TAILS).model_copy(update={"contradicted": told, "recorded_noise": told})
    said = sentence(noisy)
    assert said.startswith("white_noise.sigma[ax] is 53.0 ± 2.7 times the noise of the raw samples of the same rows")
    assert "correlation time longer than a row). The same holds for white_noise.sigma[ay]. The noise is" in said
    assert "times the known noise" not in said
    explained = sentence(diagnosis().model_copy(update={"contradicted": told}))
    assert explained.startswith("gyro_scale_asymmetry is missing")
    assert "stands in for" not in explained
    scatter = NoiseComparison(
        "gx", 7.7, 3.0, "prior", 2.6, 2.6, 0.2, False, "LSB", 0.0, "run_scatter.tau[gx]", (), True
    )
    sisters = replace(scatter, source="sisters", ratio=38.0, p=1e-6, sisters=("gy", "gz"))
    assert contradiction_text((sisters, scatter)) == (
        "run_scatter.tau[gx] is 38 times that of gy and gz by the means of their runs and 2.6 times the "
        "scale of its prior. This scatter between runs absorbs something that the model lacks"
    )
    assert contradiction_text((replace(scatter, p=1e-6),)).endswith("or the prior is too narrow for this unit")


def test_the_picture_of_the_recorded_noise(tmp_path):
    scatter, runs = np.random.default_rng(0).normal(size=60), np.repeat(["a", "b", "c"], 20)
    record = KnownNoise((comparison("ax", 2.14, 1e-40), comparison("ay", 1.0, 0.5)), np.repeat("ax", 60), runs, scatter)
    assert save_recorded_noise(tmp_path, record).read_bytes()[:4] == PNG


def test_an_effect_of_unusual_size_is_said_to_be_one():
    assert "typical" not in sentence(diagnosis())
    size = UntypicalSize(name="station_level.north[all]", value=-1456.0, largest=60.0, unit="arcsec")
    group = diagnosis().groups[0].model_copy(update={"beyond_typical": (size,)})
    said = sentence(diagnosis().model_copy(update={"groups": (group,)}))
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
    missed = Trial("gyro_warm_up", (), 50.0, diagnosis("adequate"))
    found = Trial(ASYMMETRY, (), 50.0, diagnosis().model_copy(
        update={"explanations": evidence({"effects": 0.998}, inclusion={ASYMMETRY: 0.54})}
    ))  # fmt: skip
    quiet: tuple[Verdict, ...] = ("adequate",) * 19
    nulls: tuple[Verdict, ...] = ("missing_effect", *quiet)
    trials = Trials("c", "m", Size(), 0, (missed, found), {"lever_arm": "no run"}, nulls)
    print_report(injection_report(trials))
    out = " ".join(capsys.readouterr().out.split())
    assert out.startswith("2 effects injected one by one into simulated data of 'c', at the size with Δχ² = 50.0: 1")
    assert "Missed: gyro_warm_up." in out
    assert "1 false alarm in 20 draws" in out
    assert "lever_arm" in out
    rows = injection_sheet(trials).rows
    assert [(row[3].mood, row[-1].text) for row in rows] == [("bad", "< 0.001"), ("", "0.54")]
    assert injection_json(trials)["null"]["rate"] == 0.05


def test_an_uncertainty_that_no_interval_includes_is_said_once_below_the_verdict():
    gravity = NeglectedUncertainty(
        effect="gravity_anomaly", parameter="gravity_anomaly.size", value=50.0, unit="ug", shifts="accel_bias.bias[ax]",
        in_sd=2.0,
    )  # fmt: skip
    found = diagnosis("adequate", 0.95).model_copy(update={"neglected": (gravity,)})
    first, *_, last = shown.diagnosis_lines(found)
    assert "gravity_anomaly" not in first
    assert last.startswith("No interval includes gravity_anomaly")
    assert sentence(found).endswith(last)


def test_a_path_with_blanks_is_quoted_in_every_command():
    """Each is split by a shell into the words that are meant, and names the folder as a whole."""
    folder = "results/my unit's first"
    found = diagnosis().model_copy(update={"result": folder})
    commands = [
        shown.next_command(found),
        shown.next_command(diagnosis("adequate").model_copy(update={"result": folder})),
    ]
    commands += [shown.add_command(["a_cause"], ["gx"], folder, f"{folder}-2"), command_line("compare", folder)]
    for command in commands:
        words = shlex.split(command)
        assert words[0] == "imubayes"
        assert folder in words
    assert shlex.split(commands[0])[-1] != folder
    assert command_line("compare", "results/first") == "imubayes compare results/first"
