"""The command line as a user meets it: exit statuses, four-part errors, JSON, no traceback, nothing half-written."""

import json
import re
import shutil
import tomllib
from functools import partial
from pathlib import Path

import pytest

import imubayes.api
from imubayes.cli.main import app, run
from imubayes.foundations.units import BIAS_CONVENTION

ROOT = Path(__file__).parents[2]
PARTS = ("error: ", "  where:   ", "  do:      ")


def said(capsys, *words: str | Path) -> tuple[int, str, str]:
    status = run([str(word) for word in words])
    captured = capsys.readouterr()
    # Lines of progress, "fitting: mode · 3 s", come as slowly as the machine is.
    return status, captured.out, re.sub(r"^.* · \d+ s\n", "", captured.err, flags=re.MULTILINE)


def refused(capsys, *words: str) -> str:
    """Run a command that must be refused; return what it says."""
    status, out, err = said(capsys, *words)
    assert status == 2, err or out
    assert all(part in err for part in PARTS), err
    assert "Traceback" not in err + out
    return err


@pytest.fixture
def copy(tmp_path):
    """A copy of the smallest campaign and its model, to be spoiled."""
    campaign = tmp_path / "campaign"
    shutil.copytree(ROOT / "data" / "accel-channel", campaign)
    model = tmp_path / "model.toml"
    shutil.copyfile(ROOT / "models" / "accel-channel.toml", model)
    return campaign, model


def replaced(file: Path, old: str, new: str) -> None:
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new, 1))


@pytest.mark.parametrize(
    ("words", "what"),
    [
        (("check",), "the argument CAMPAIGN of 'check' is missing"),
        (("add", "gyro_bias"), "the option --to of 'add' is missing"),
        (("fit", "data", "--modle", "start", "--out", "r"), "'fit' has no option --modle\n"),
        (("fit", "data", "--modle=start", "--out", "r"), "'fit' has no option --modle\n"),
    ],
)
def test_what_a_command_line_lacks_is_named_with_its_command(capsys, words, what):
    told = refused(capsys, *words)
    assert f"error: {what}" in told
    assert f"imubayes {words[0]} --help" in told


CAMPAIGN_FAULTS = {
    "missing run file": ('file = "runs/ramp-1g.csv"', 'file = "runs/none.csv"', "none.csv"),
    "unknown procedure": ('procedure = "thermal_ramp"', 'procedure = "thermal_ram"', "thermal_ramp"),
    "procedure not fitted yet": ('procedure = "thermal_ramp"', 'procedure = "servo_table"', "servo_table"),
    "unknown kind": ('kind = "accelerometer"', 'kind = "accelerometr"', "accelerometer"),
    "unknown unit": ('per = "g"', 'per = "gg"', "gg"),
    "unknown key": ("latitude_deg", "lattitude_deg", "latitude_deg"),
}
MODEL_FAULTS = {
    "unknown effect": ('name = "accel_bias"', 'name = "accel_bais"', "accel_bias"),
    "unknown parameter": ("prior = { slope", "prior = { slop", "slope"),
    "unknown prior": ("lognormal(1 noise", "lognormall(1 noise", "lognormal"),
    "wrong unit": ("scale/degC)", "ppm/degC)", "output/degC"),
    "negative width": ("lognormal(1 noise, 0.5)", "lognormal(-1 noise, 0.5)", "above 0"),
    "normal noise": ("lognormal(1 noise, 0.5)", "normal(1, 0.2 noise)", "may not be negative"),
    "effect for gyros": ('name = "accel_bias"', 'name = "gyro_bias"', "gyro"),
    "no run shows it": ('name = "accel_bias"', 'name = "accel_bias_temperature"', "parameter"),
    "no noise": ('name = "white_noise"', 'name = "accel_quadratic"', "parameter"),
}


@pytest.mark.parametrize("fault", CAMPAIGN_FAULTS)
def test_spoilt_campaigns_are_refused(copy, capsys, tmp_path, fault):
    campaign, model = copy
    old, new, named = CAMPAIGN_FAULTS[fault]
    replaced(campaign / "campaign.toml", old, new)
    out = tmp_path / "result"
    assert named in refused(capsys, "fit", campaign, "--model", model, "--out", out)
    assert not out.exists()
    refused(capsys, "check", campaign, "--model", model)


@pytest.mark.parametrize("fault", MODEL_FAULTS)
def test_spoilt_models_are_refused(copy, capsys, tmp_path, fault):
    campaign, model = copy
    old, new, named = MODEL_FAULTS[fault]
    replaced(model, old, new)
    out = tmp_path / "result"
    assert named in refused(capsys, "fit", campaign, "--model", model, "--out", out)
    assert not out.exists()


def test_several_faults_are_reported_at_once(copy, capsys, tmp_path):
    campaign, model = copy
    replaced(model, 'name = "accel_bias"', 'name = "accel_bais"')
    replaced(model, 'name = "mounting_error"', 'name = "mounting_eror"')
    err = refused(capsys, "fit", campaign, "--model", model, "--out", tmp_path / "result")
    assert err.count("error: ") == 2
    assert "2 problems found" in err


@pytest.mark.parametrize(
    "words",
    [
        ["fti", "data"],
        ["fit"],
        ["fit", "data/none", "--model", "models/none.toml", "--out", "nowhere"],
        ["fit", "data/accel-channel", "--modle", "x"],
        ["check", "data/none"],
        ["compare", "data/accel-channel"],
        ["effects", "gyro_bais"],
        ["convert", "imu-kt", "a", "--out", "b"],
        ["convert", "none.log", "--out", "b"],
        ["simulate", "none.toml", "--out", "b"],
        ["schema", "modell"],
    ],
    ids=" ".join,
)
def test_unusable_command_lines(capsys, tmp_path, monkeypatch, words):
    for name in ("data", "models"):
        (tmp_path / name).symlink_to(ROOT / name)
    monkeypatch.chdir(tmp_path)
    refused(capsys, *words)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["data", "models"]


def test_resume_without_a_checkpoint(copy, capsys, tmp_path):
    campaign, model = copy
    err = refused(capsys, "fit", campaign, "--model", model, "--out", tmp_path / "result", "--resume")
    assert "nothing to resume" in err
    assert not (tmp_path / "result").exists()


@pytest.mark.slow
def test_a_fit_that_no_working_unit_explains_has_failed(copy, capsys, tmp_path):
    """The campaign accepts that its channel is reversed; whichever parameter takes that up, the fit says so."""
    campaign, model = copy
    text = (campaign / "campaign.toml").read_text().replace("scale = 20000.0", "scale = -20000.0")
    (campaign / "campaign.toml").write_text('accepted = ["channel_unit"]\n' + text)
    out = tmp_path / "result"
    status, text, _ = said(capsys, "fit", campaign, "--model", model, "--out", out, "--no-sample")
    assert status == 1
    assert text.startswith("FIT FAILED. The outputs of ax differ from the model by ")
    summary = json.loads((out / "summary.json").read_text())
    assert not summary["converged"]
    assert summary["unexplained"][0]["residual"] > 0.5  # g
    assert all(parameter["mean"] is None for parameter in summary["parameters"])
    status, text, _ = said(capsys, "diagnose", out)
    assert status == 1
    assert "gravity_anomaly" not in text


def test_check_says_what_is_there(capsys):
    status, out, err = said(capsys, "check", ROOT / "data" / "accel-channel", "--json-output")
    assert (status, err) == (0, "")
    found = json.loads(out)
    assert found["channels"] == ["ax"]
    assert [run_["procedure"] for run_ in found["runs"]].count("current_injection") == 1


@pytest.mark.parametrize("kind", ["campaign", "model", "plan", "specification", "summary"])
def test_schema_is_json(capsys, kind):
    status, out, _ = said(capsys, "schema", kind)
    assert status == 0
    schema = json.loads(out)
    assert schema["$schema"].startswith("https://json-schema.org")
    assert schema["type"] == "object"


@pytest.mark.parametrize("kind", ["campaign", "model", "plan", "specification"])
def test_an_editor_explains_every_key_of_an_input_file(capsys, kind):
    _, out, _ = said(capsys, "schema", kind)
    schema = json.loads(out)
    records = [(kind, schema), *schema["$defs"].items()]
    keys = [(f"{name}.{key}", entry) for name, record in records for key, entry in record.get("properties", {}).items()]
    assert len(keys) > 10
    assert [key for key, entry in keys if not entry.get("description")] == []


def test_effects_explains(capsys):
    status, out, _ = said(capsys, "effects", "gyro_g_sensitivity")
    assert status == 0
    assert "deg/h/g" in out
    assert "IEEE Std 517" in out
    assert "accel_quadratic" in said(capsys, "effects")[1]
    for bias in ("gyro_bias", "accel_bias"):
        assert BIAS_CONVENTION in " ".join(said(capsys, "effects", bias)[1].split())
    assert BIAS_CONVENTION not in " ".join(said(capsys, "effects", "gyro_scale_factor")[1].split())


def test_effects_says_what_a_campaign_could_show(capsys):
    status, out, _ = said(capsys, "effects", "--for", "data/accel-channel")
    assert status == 0
    shown, lacking = out.split("Needed for the other effects")
    assert "converter_leakage" in shown
    assert "accel_warm_up" in lacking
    assert "power_on_s" in lacking
    assert "a run that names a [[thermometer]]" in lacking
    assert "gyro_bias" not in shown


def test_fit_writes_the_contract(tmp_path, capsys, monkeypatch):
    """`summary.json` has every key of the interface, alone on standard output with --json-output."""
    # Enough for convergence, and not what the sampler would take by itself.
    monkeypatch.setattr(imubayes.api, "fit", partial(imubayes.api.fit, settings=imubayes.api.Settings(most_steps=200)))
    out = tmp_path / "result"
    campaign, model = ROOT / "data" / "accel-channel", ROOT / "models" / "accel-channel.toml"
    status, said_out, _ = said(capsys, "fit", campaign, "--model", model, "--out", out, "--json-output")
    assert status == 0
    summary = json.loads(said_out)
    assert summary == json.loads((out / "summary.json").read_text())
    top = {"format", "campaign", "model", "converged", "message", "parameters", "derived", "runs", "chi2", "dof"}
    assert top | {"log_evidence", "weak_directions", "seconds"} <= set(summary)
    line = {"name", "unit", "mean", "sd", "q025", "q975", "map", "prior_sd", "from_data", "r_hat", "ess_bulk"}
    assert all(line | {"ess_tail"} <= set(one) for one in summary["parameters"])
    assert all({"name", "unit", "mean", "sd", "q025", "q975", "from_data"} <= set(one) for one in summary["derived"])
    assert all({"name", "channel", "n", "chi2", "rms", "unit"} <= set(one) for one in summary["runs"])
    names = {
        "summary.json",
        "manifest.json",
        "fit.json",
        "history.json",
        "budgets.json",
        "posterior.nc",
        "residuals.parquet",
        "model.toml",
        "checkpoint.h5",
    }
    assert {path.name for path in out.iterdir()} == names
    by_name = {one["name"]: one for one in (*summary["parameters"], *summary["derived"])}
    truth = tomllib.loads((ROOT / "data" / "accel-channel" / "truth.toml").read_text())
    for name in ("converter_gain_drift.slope[ax]", "converter_offset_drift.slope[ax]"):
        assert by_name[name]["from_data"] > 0.9
        assert abs(by_name[name]["mean"] - truth["parameters"][name]) < 4 * by_name[name]["sd"]


@pytest.mark.slow
def test_without_injected_current_gain_and_offset_are_not_separated(copy, tmp_path, capsys):
    campaign, model = copy
    text = (campaign / "campaign.toml").read_text()
    head, *runs = text.split("[[run]]")
    kept = [one for one in runs if "current_injection" not in one]
    assert len(kept) == len(runs) - 1
    (campaign / "campaign.toml").write_text("[[run]]".join([head, *kept]))
    out = tmp_path / "out"
    status, said_out, _ = said(capsys, "fit", campaign, "--model", model, "--out", out, "--no-sample", "--json-output")
    assert status == 0
    summary = json.loads(said_out)
    weak = [one for one in summary["weak_directions"] if "converter_gain_drift" in one["combination"]]
    assert weak
    assert weak[0]["from_data"] < 0.2
    best = [one for one in summary["next_runs"] if one["quantity"] == "converter_gain_drift.slope[ax]"]
    assert best[0]["run"]["procedure"] == "current_injection"


def test_every_command_stands_in_a_group_and_has_an_example(capsys):
    status, out, _ = said(capsys, "--help")
    assert status == 0
    # Each group of the overview is a frame with its name on top; a command begins its line, its text is indented.
    frames = dict(re.findall(r"╭─ ([A-Z][a-z ]+) ─+╮\n(.*?)╰", out, re.DOTALL))
    assert list(frames) == ["Commands", "The loop", "Data", "Results", "Many units"]
    named = [name for title in list(frames)[1:] for name in re.findall(r"^│ ([a-z]+) ", frames[title], re.MULTILINE)]
    assert len(named) == len(set(named)) == 29
    assert not re.findall(r"^│ ([a-z]+) ", frames["Commands"], re.MULTILINE)
    own = [f"{name} {each}" for name in ("archive", "batch") for each in app[name] if not each.startswith("-")]
    assert len(own) == 8
    for words in (*named, *own):
        status, out, _ = said(capsys, *words.split(), "--help")
        assert status == 0
        assert f"Example: imubayes {words} " in out.replace("\n", " "), words
