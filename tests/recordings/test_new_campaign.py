"""`imubayes new`: from a recording, a campaign or nothing to a campaign and a model that are read, bound and right."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from test_convert import write_log
from tumble_files import tumble_log
from tumble_recordings import random_attitudes

import imubayes
from imubayes.cli.main import run
from imubayes.model.model_file import read_model
from imubayes_recordings.convert import convert

DATA = Path(__file__).parents[2] / "data"


def effects_of(folder: Path) -> list[str]:
    return [each.name for each in read_model(folder / "model.toml").effects]


@pytest.fixture(scope="module")
def by_hand(tmp_path_factory) -> tuple[Path, str]:
    """Return a campaign folder begun from a recording of a unit turned by hand, and what was printed."""
    import contextlib
    import io

    folder, said = tmp_path_factory.mktemp("new") / "desk", io.StringIO()
    columns, _ = tumble_log()
    log = write_log(folder.parent / "unit.log", columns)
    with contextlib.redirect_stdout(said):
        assert run(["new", str(folder), str(log), "--sample-rate-hz", "100", "--gravity-m-s2", "9.8"]) == 0
    return folder, said.getvalue()


def test_a_recording_in_place_of_the_folder_is_named(tmp_path, capsys):
    log = tmp_path / "unit.csv"
    log.write_text("time_s,ax,ay,az\n")
    assert run(["new", str(log), str(tmp_path / "desk")]) == 2
    assert f"do:      imubayes new FOLDER {log}" in capsys.readouterr().err
    assert not (tmp_path / "desk").exists()


def test_a_recording_becomes_campaign_and_model(by_hand):
    folder, said = by_hand
    campaign = imubayes.load_campaign(folder)
    assert campaign.site.gravity == 9.8
    text = (folder / "campaign.toml").read_text()
    assert "# measured or assumed" in text
    assert "gravity_m_s2 = 9.8" in text
    assert "next: imubayes check" in said
    assert "written:" in said
    effects = effects_of(folder)
    assert {"accel_bias", "accel_scale_factor", "gyro_bias", "gyro_scale_factor", "gyro_misalignment"} <= set(effects)
    assert not {"mounting_error", "accel_bias_temperature", "lever_arm"} & set(effects)
    assert "accel_bias_temperature:" in (folder / "model.toml").read_text()


def test_the_model_binds_and_holds_the_frame_once(by_hand):
    folder, _ = by_hand
    model = imubayes.bind(imubayes.load_model(folder / "model.toml"), imubayes.load_campaign(folder))
    tilts = [each for each in model.layout.parameters if each.effect == "accel_misalignment"]
    held = {each.name for each in tilts if each.prior.sd() < 1e-8}
    assert len(tilts) == 6
    # The three rotations of the frame, each held at one axis.
    assert len(held) == 3
    assert {"accel_misalignment.toward_o[ax]", "accel_misalignment.toward_p[ax]"} < held


@pytest.mark.slow
def test_what_the_runs_do_not_determine_is_a_comment(tmp_path, capsys):
    shutil.copytree(DATA / "static-record", tmp_path / "still")
    assert run(["new", str(tmp_path / "still")]) == 0
    said = capsys.readouterr().out
    effects = effects_of(tmp_path / "still")
    # At rest in one attitude: a bias, and a scale factor that is not determined, but on which the bias depends.
    assert {"gyro_bias", "accel_bias", "accel_scale_factor", "mounting_error", "white_noise"} <= set(effects)
    assert not {"gyro_misalignment", "gyro_g_sensitivity", "accel_quadratic"} & set(effects)
    assert "gyro_misalignment" in said
    assert run(["new", str(tmp_path / "still")]) == 2  # there is a model already


@pytest.mark.parametrize(("poses", "told"), [(6, False), (60, True)])
@pytest.mark.slow
def test_what_six_faces_cannot_tell_from_a_bias_is_no_effect_of_the_model(tmp_path, poses, told):
    """|f| = g at unknown attitudes: six values determine six biases and scale factors, and no K2 beside them."""
    rng = np.random.default_rng(2)
    faces = np.repeat(np.eye(3), 2, axis=0) * np.tile([1.0, -1.0], 3)[:, None] + 0.03 * rng.normal(size=(6, 3))
    directions = faces if poses == 6 else rng.normal(size=(poses, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    means = [0.03, 0.004, -0.03] + [1.005, 1.001, 1.009] * directions + 1e-4 * rng.normal(size=(poses, 3))
    lines = ["ax,ay,az,samples", *(",".join(f"{value:.7f}" for value in row) + ",1000" for row in means)]
    (tmp_path / "means.csv").write_text("\n".join(lines))
    stated = ["--accel-unit", "g", "--latitude-deg", "31"]
    assert run(["new", str(tmp_path / "unit"), str(tmp_path / "means.csv"), *stated]) == 0
    assert ("accel_quadratic" in effects_of(tmp_path / "unit")) == told
    assert {"accel_bias", "accel_scale_factor"} < set(effects_of(tmp_path / "unit"))


def fill_in(campaign: Path) -> None:
    """State what the template leaves open."""
    stated = {"gravity_m_s2": "9.81", "scale": "1.0", "temperature_degC": "23.0", "preset": '"aligned"'}
    stated |= {
        "azimuth_deg": "0.0",
        "elevation_deg": "90.0",
        "axis_uncertainty_arcsec": "30.0",
        "uncertainty_arcmin": "5.0",
    }
    kind, lines = "", []
    for line in campaign.read_text().splitlines():
        kind = line.split('"')[1] if line.startswith("kind") else kind
        unit = '"m/s^2"' if kind == "accelerometer" else '"rad/s"'
        key = line.partition(" = ")[0]
        lines.append(line.replace('"?"', {"output_unit": unit, "per": unit, **stated}.get(key, '"?"')))
    campaign.write_text("\n".join(lines))


def test_from_nothing_to_a_campaign_to_fill_in(tmp_path, capsys):
    folder = tmp_path / "rates"
    assert run(["new", str(folder)]) == 2
    assert "--procedure" in capsys.readouterr().err
    assert run(["new", str(folder), "--procedure", "rate_table", "--latitude-deg", "50", "--serial", "U1"]) == 0
    # Nothing that nobody stated stands there as a fact.
    assert run(["check", str(folder), "--model", str(folder / "model.toml")]) == 2
    refused = capsys.readouterr().err
    for key in ("gravity_m_s2", "channel[5].scale", "per", "elevation_deg", "axis_uncertainty_arcsec", "preset"):
        assert key in refused
    assert "latitude_deg" not in refused
    fill_in(folder / "campaign.toml")
    columns = (folder / "runs" / "first.csv").read_text().strip().split(",")
    assert columns[:2] == ["time_s", "table_rate_deg_s"]
    rates = np.array([-100, -50, -10, 10, 50, 100.0])
    rows = np.zeros((6, len(columns)))
    rows[:, columns.index("time_s")] = 60.0 * np.arange(6)
    rows[:, columns.index("table_rate_deg_s")] = rates
    rows[:, columns.index("az")] = 9.81
    rows[:, columns.index("gz")] = np.radians(rates)
    rows = np.column_stack([rows, np.full(6, 1000)])
    np.savetxt(folder / "runs" / "first.csv", rows, delimiter=",", header=",".join([*columns, "samples"]), comments="")
    campaign = imubayes.load_campaign(folder)
    assert campaign.serial == "U1"
    assert campaign.runs[0].rows == 6
    assert imubayes.bind(imubayes.load_model(folder / "model.toml"), campaign).layout.names


def test_options_without_a_recording_are_refused(tmp_path, capsys):
    shutil.copytree(DATA / "static-record", tmp_path / "still")
    assert run(["new", str(tmp_path / "still"), "--gyro-unit", "deg/s"]) == 2
    assert "no recording is named" in capsys.readouterr().err


def test_more_parameters_than_values_are_told_with_what_to_leave_out(tmp_path, capsys):
    means = np.array([[0.05, -0.03, 10.01], [9.86, -0.03, 0.2], [0.05, 9.75, 0.2], [-9.7, 0.0, 0.2]])
    np.savetxt(tmp_path / "m.csv", means, delimiter=",", header="ax,ay,az", comments="")
    campaign = convert([tmp_path / "m.csv"], tmp_path / "unit", rows="means", samples=100, gravity_m_s2=9.81)
    model = Path(__file__).parents[2] / "models" / "free-tumble.toml"
    assert run(["check", str(campaign), "--model", str(model)]) == 0
    said = capsys.readouterr().out
    assert "24 parameters and 3 of the noise, 12 measured values" in said
    assert "these runs supply less than 10 % of the information on accel_misalignment" in said
    assert run(["check", str(campaign), "--model", str(model), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["model"]["untold"] == ["accel_misalignment"]


def test_a_warm_up_gets_the_terms_of_an_autopilot_s_temperature_calibration(tmp_path, capsys):
    rng, count = np.random.default_rng(5), 3000
    temperature = 50 - 60 * np.exp(-np.arange(count) / 600)
    columns = [np.arange(count), temperature, *rng.normal(0, 0.01, (2, count)), rng.normal(9.81, 0.01, count)]
    header = "time_s,temperature_degC,ax,ay,az"
    np.savetxt(tmp_path / "log.csv", np.stack(columns, axis=1), delimiter=",", header=header, comments="")
    stated = ["--latitude-deg", "48", "--accel-unit", "m/s^2"]
    assert run(["new", str(tmp_path / "unit"), str(tmp_path / "log.csv"), *stated]) == 0
    ends = ("", "_quadratic", "_cubic")
    assert {f"accel_bias_temperature{end}" for end in ends} < set(effects_of(tmp_path / "unit"))


MEMS, TACTICAL = (0.02, 0.03), (0.0005, 0.003)  # scale factor errors, and biases in g


def _six_faces(errors: tuple[float, float]) -> np.ndarray:
    """Return means of six faces in g, without their scatter."""
    scale, bias = errors
    force = np.vstack([np.eye(3), -np.eye(3)]) * (1 + scale * np.array([1.0, -0.7, 0.4]))
    return force + bias * np.array([0.8, -1.0, 0.3])


@pytest.mark.parametrize(("errors", "grade"), [(MEMS, "consumer"), (TACTICAL, None)])
def test_errors_of_a_unit_tell_its_grade_where_no_noise_does(tmp_path: Path, errors, grade):
    file = tmp_path / "faces.csv"
    np.savetxt(file, np.c_[_six_faces(errors), np.full(6, 500)], header="ax,ay,az,samples", delimiter=",", comments="")
    made = imubayes.new(tmp_path / "faces", [file], accel_unit="g", gravity_m_s2=9.81)
    assert imubayes.load_campaign(made.folder).grade == grade
    assert any("grade = consumer" in note for note in made.notes) == (grade is not None)


@pytest.mark.slow
def test_one_axis_with_a_large_bias_tells_the_grade_of_all(tmp_path: Path):
    """As in published poses of a consumer unit: 80 mg in z, next to nothing in x and y."""
    rng = np.random.default_rng(3)
    down = np.vstack([np.eye(3), -np.eye(3), rng.normal(size=(12, 3))])
    down /= np.linalg.norm(down, axis=1)[:, None]
    force = 9.81 * (down * [1.002, 0.999, 1.006] + [0.002, -0.003, 0.08]) + rng.normal(0, 0.004, down.shape)
    np.savetxt(tmp_path / "poses.csv", force, header="ax,ay,az", delimiter=",", comments="")
    made = imubayes.new(tmp_path / "unit", [tmp_path / "poses.csv"], rows="means", samples=100, gravity_m_s2=9.81)
    assert imubayes.load_campaign(made.folder).grade == "consumer"
    assert any("accel_bias.bias[az] is 4 sd from the default prior of a tactical unit" in note for note in made.notes)


@pytest.mark.parametrize(
    ("errors", "grade"), [pytest.param(MEMS, "consumer", marks=pytest.mark.slow), (TACTICAL, None)]
)
def test_errors_of_a_unit_tell_its_grade_where_a_filter_hides_its_noise(tmp_path: Path, errors, grade):
    made = random_attitudes(11, 14)
    columns, (scale, bias) = made.columns(noise=(1e-3, 1e-4), errors=False), errors
    for name, part in zip(("ax", "ay", "az"), (1.0, -0.7, 0.4), strict=True):
        columns[name] = (1 + scale * part) * columns[name] + 9.81 * bias * part
    campaign = imubayes.new(
        tmp_path / "log", [write_log(tmp_path / "unit.log", columns)], sample_rate_hz=100.0, gravity_m_s2=9.80875
    )
    assert imubayes.load_campaign(campaign.folder).grade == grade
