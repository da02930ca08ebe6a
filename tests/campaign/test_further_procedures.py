"""Files of runs by direction, beside a reference, on a servo table and with rotation: read right, refused right."""

import numpy as np
import pytest

from imubayes.campaign import load_campaign
from imubayes.foundations.errors import InputError

HEAD = """
format = 1
name = "further"
[site]
latitude_deg = 34.25
[[channel]]
name = "{channel}"
kind = "{kind}"
input_axis = [1.0, 0.0, 0.0]
output_axis = [0.0, 1.0, 0.0]
output_unit = "V"
scale = 1.0
per = "{per}"
[[table]]
name = "t"
elevation_deg = 34.25
angle_uncertainty_arcsec = 2.0
[[mounting]]
name = "m"
body_to_table = [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]
[[run]]
name = "one"
procedure = "{procedure}"
file = "one.csv"
"""
ON_TABLE = 'table = "t"\nmounting = "m"\n'


@pytest.fixture
def campaign(tmp_path):
    def made(procedure, columns, on_table=True, channel="g", kind="gyro", per="deg/h"):
        head = HEAD.format(procedure=procedure, channel=channel, kind=kind, per=per)
        (tmp_path / "campaign.toml").write_text(head + (ON_TABLE if on_table else ""))
        rows = zip(*columns.values(), strict=True)
        lines = [",".join(columns), *(",".join(str(cell) for cell in row) for row in rows)]
        (tmp_path / "one.csv").write_text("\n".join(lines) + "\n")
        return load_campaign(tmp_path)

    return made


def refused(campaign, *args, **more):
    with pytest.raises(InputError) as caught:
        campaign(*args, **more)
    return [problem.what for problem in caught.value.issues]


# directions


def positions(i, o):
    return {"i_axis": list(i), "o_axis": list(o), "samples": [10] * len(i), "g": [1.0] * len(i)}


def test_directions_become_attitudes(campaign):
    run = campaign("geographic_tumble", positions("EUN", "NEU"), on_table=False).runs[0]
    assert run.attitude is not None
    # Columns are the input, output and spin axes in the local level.
    assert run.attitude[0] == pytest.approx(np.eye(3))
    assert run.attitude[1][:, 0] == pytest.approx([0, 0, 1])
    assert run.attitude[1][:, 1] == pytest.approx([1, 0, 0])
    assert run.attitude[2][:, 2] == pytest.approx(np.cross([0, 1, 0], [0, 0, 1]))
    for one in run.attitude:
        assert np.linalg.det(one) == pytest.approx(1)


def test_a_letter_that_is_no_direction(campaign):
    (what,) = refused(campaign, "geographic_tumble", positions("EX", "NN"), on_table=False)
    assert "'X' is not a direction" in what


def test_axes_along_one_line(campaign):
    (what,) = refused(campaign, "geographic_tumble", positions("EN", "NS"), on_table=False)
    assert "are parallel" in what


def test_a_raw_log_is_cut_where_the_directions_change(campaign):
    i, o = ["E"] * 40 + ["U"] * 30 + ["E"] * 30, ["N"] * 70 + ["U"] * 30
    noise = np.random.default_rng(1).normal(size=100)
    run = campaign("geographic_tumble", {"i_axis": i, "o_axis": o, "g": noise}, on_table=False).runs[0]
    assert run.samples.tolist() == [40, 30, 30]
    assert run.observed[:, 0] == pytest.approx([noise[:40].mean(), noise[40:70].mean(), noise[70:].mean()])
    assert run.attitude is not None
    assert run.attitude[1][:, 0] == pytest.approx([0, 0, 1])


# a table that a gyro drives


def test_the_angle_of_a_servo_table_is_a_channel_and_goes_on_past_a_turn(campaign):
    time = np.arange(0.0, 40.0, 1.0)
    angle = (355 + 0.5 * time) % 360
    loaded = campaign("servo_table", {"time_s": time, "table_angle_deg": angle, "samples": [1] * 40})
    assert [channel.kind for channel in loaded.channels] == ["gyro", "angle"]
    assert loaded.channels[1].noise == pytest.approx(2 / 3600)
    assert loaded.runs[0].observed[:, 1] == pytest.approx(355 + 0.5 * time)
    assert np.isnan(loaded.runs[0].observed[:, 0]).all()


def test_a_raw_log_of_a_servo_table_is_followed_past_a_turn(campaign):
    time = np.arange(0.0, 60.0, 0.1)
    angle = (359 + 0.05 * time) % 360
    loaded = campaign("servo_table", {"time_s": time, "table_angle_deg": angle})
    run = loaded.runs[0]
    assert 50 <= run.rows <= 70
    assert run.observed[:, 1] == pytest.approx(359 + 0.05 * run.covariates["time"], abs=1e-6)


def test_a_servo_table_needs_a_gyro(campaign):
    columns = {"time_s": [0.0, 1.0], "table_angle_deg": [0.0, 0.1], "samples": [1, 1]}
    whats = refused(campaign, "servo_table", columns, channel="a", kind="accelerometer", per="g")
    assert any("has no gyro" in what for what in whats)


# a reference gyro, and rotation


def test_a_raw_log_beside_a_reference_is_followed(campaign):
    time = np.arange(0.0, 20.0, 0.01)
    rate = 30 + 2 * np.sin(time)
    zero = np.zeros_like(time)
    columns = {
        "time_s": time,
        "reference_x_deg_s": rate,
        "reference_y_deg_s": zero,
        "reference_z_deg_s": zero,
        "g": rate,
    }
    run = campaign("reference_gyro", columns, per="deg/s").runs[0]
    assert 15 <= run.rows <= 25
    followed = np.degrees(run.covariates["reference_x"])
    assert followed == pytest.approx(30 + 2 * np.sin(run.covariates["time"]), abs=0.1)
    assert run.observed[:, 0] == pytest.approx(followed, rel=1e-9)


def test_a_raw_log_that_turns_is_cut_into_arcs(campaign):
    time = np.arange(0.0, 90.0, 0.02)
    angle = (10.0 * time) % 360
    columns = {
        "time_s": time,
        "table_rate_deg_s": np.full_like(time, 10.0),
        "table_angle_deg": angle,
        "g": 36000.0 + np.cos(np.radians(angle)),
    }
    run = campaign("rotation_modulation", columns).runs[0]
    span = np.degrees(run.covariates["table_angle_span"])
    assert span.max() < 16
    assert span.sum() == pytest.approx(900, abs=20)
    middle = run.covariates["table_angle"]
    # A mean over an arc is that at its middle, shortened by the arc.
    expected = 36000.0 + np.cos(middle) * np.sinc(run.covariates["table_angle_span"] / (2 * np.pi))
    assert run.observed[:, 0] == pytest.approx(expected, abs=2e-3)


@pytest.mark.parametrize("procedure", ["reference_gyro", "servo_table", "geographic_tumble", "rotation_modulation"])
def test_missing_columns_are_named(campaign, procedure):
    whats = refused(campaign, procedure, {"samples": [1, 1], "g": [0.0, 0.1]})
    assert any("needs the column" in what for what in whats)
