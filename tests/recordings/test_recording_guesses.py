"""Facts that a recording does not state are guessed from its numbers, reported, and never stored as facts."""

import tomllib
from pathlib import Path

import numpy as np
import pytest
from recording_writers import NAMES, as_matrix
from tumble_files import tumble_log

from imubayes.campaign import load_campaign
from imubayes.cli.main import run
from imubayes.foundations.errors import InputError
from imubayes_recordings.convert import convert, read_recordings
from imubayes_recordings.convert.column_names import role_of
from imubayes_recordings.convert.options import read_options

COLUMNS, _ = tumble_log(poses=12)
ROWS = as_matrix(COLUMNS)


def table(file: Path, rows: np.ndarray, header: str) -> Path:
    np.savetxt(file, rows, header=header, fmt="%.9g", comments="")
    return file


NAMED = {
    "AccX": ("ax", ""), "imu.acc.y": ("ay", ""), "accelerometer_m_s2[2]": ("az", "m/s^2"), "wx": ("gx", ""),
    "gyro_rad[0]": ("gx", "rad/s"), "X-Axis Acceleration": ("ax", ""), "w_RS_S_z [rad s^-1]": ("gz", "rad/s"),
    "gFy": ("ay", "g"), "accSmooth[1] (m/s/s)": ("ay", "m/s^2"), "ay [g]": ("ay", "g"), "gx_dps": ("gx", "deg/s"),
    "x_mean (g)": ("ax", "g"), "angular_velocity.z": ("gz", ""), "ustime": ("time_s", "us"), "a_z": ("az", ""),
    "T [°C]": ("temperature_degC", "degC"), "rotationRate.x(rad/s)": ("gx", "rad/s"), "acc_x_mg": ("ax", "mg"),
    "SampleTimeFine": ("time_s", "100us"),
    "#timestamp [ns]": ("time_s", "ns"), "TimeUS": ("time_s", "us"), "imu.temperature": ("temperature_degC", ""),
}  # fmt: skip
OTHERS = (
    "mag_x",
    "x_true (g)",
    "orientation.x",
    "FreeAcc_X",
    "userAcceleration.x(G)",
    "linear_velocity.x",
    "roll_rate",
)


@pytest.mark.parametrize("name", NAMED)
def test_names_of_many_programs(name: str) -> None:
    role = role_of(name)
    assert role is not None
    assert (role.target, role.unit) == NAMED[name]


@pytest.mark.parametrize("name", OTHERS)
def test_names_of_something_else(name: str) -> None:
    assert role_of(name) is None


@pytest.mark.parametrize(("accel", "force"), [("m/s^2", 1.0), ("g", 1 / 9.8), ("mg", 1000 / 9.8)])
@pytest.mark.parametrize(("gyro", "rate"), [("rad/s", 1.0), ("deg/s", 57.29578), ("mrad/s", 1000.0)])
def test_units_follow_from_rests_and_turns(tmp_path: Path, accel: str, force: float, gyro: str, rate: float) -> None:
    rows = np.c_[ROWS[:, 0], force * ROWS[:, 1:4], rate * ROWS[:, 4:]]
    made = read_recordings([table(tmp_path / "log", rows, " ".join(("time_s", *NAMES)))]).campaign
    assert (made.options.accel_unit, made.options.gyro_unit) == (accel, gyro)
    assert set(made.guesses) == {"accel_unit", "gyro_unit"}
    notes = "\n".join(made.document["notes"])
    assert f"guessed, accel_unit = {accel}: |f| = " in notes
    assert f"guessed, gyro_unit = {gyro}: turns between poses integrate to " in notes


def test_where_two_units_are_possible_the_option_is_asked_for(tmp_path: Path) -> None:
    still = np.c_[ROWS[:900, 0], ROWS[:900, 1:4] / 9.8, ROWS[:900, 4:]]
    file = table(tmp_path / "log", still, " ".join(("time_s", *NAMES)))
    with pytest.raises(InputError, match="the unit of the gyros is not known") as refused:
        read_recordings([file])
    assert "--gyro-unit" in refused.value.issues[0].remedy
    made = read_recordings([file], gyro_unit="rad/s").campaign
    assert made.document["run"][0]["procedure"] == "static_record"
    with pytest.raises(InputError, match="the unit of the accelerometers is not known"):
        read_recordings([table(tmp_path / "log", 0.37 * ROWS + 0.01, " ".join(("time_s", *NAMES)))])


def test_two_sensors_of_one_recording_are_asked_for(tmp_path: Path) -> None:
    rows = np.c_[ROWS, ROWS[:, 1:4]]
    names = "time_s acc1_x acc1_y acc1_z gx gy gz acc2_x acc2_y acc2_z"
    with pytest.raises(InputError, match="2 sets of columns may be ax ay az") as refused:
        read_recordings([table(tmp_path / "log", rows, names)])
    assert "--column ax='acc1_x'" in refused.value.issues[0].remedy


def test_a_mapping_is_written_and_read_for_others_of_its_kind(tmp_path: Path) -> None:
    rows = np.c_[1e3 * ROWS[:, 0], ROWS[:, [2, 1]], -ROWS[:, 3], np.degrees(ROWS[:, 4:]), ROWS[:, 0]]
    first = table(tmp_path / "first.log", rows, "clock_ms f1 f2 f3 rate_x rate_y rate_z other")
    columns = {"time_s": "clock_ms", "ax": "f2", "ay": "f1", "az": "-f3"}
    one = convert([first], tmp_path / "one", columns=columns, time_unit="ms", gravity_m_s2=9.8, serial="A-7")
    text = (one / "mapping.toml").read_text()
    stated = tomllib.loads(text)
    assert stated["columns"] == columns | {"gx": "rate_x", "gy": "rate_y", "gz": "rate_z"}
    assert stated["time_unit"] == "ms"
    # A guess is a comment with its evidence, and what belongs to one unit is not there.
    assert '# gyro_unit = "deg/s"  # turns between poses integrate to' in text
    assert not {"gyro_unit", "accel_unit", "serial", "name"} & set(stated)
    second = table(
        tmp_path / "second.log", rows[:, [7, 3, 2, 1, 6, 5, 4, 0]], "other f3 f2 f1 rate_z rate_y rate_x clock_ms"
    )
    two = convert([second], tmp_path / "two", mapping=one / "mapping.toml")
    np.testing.assert_allclose(load_campaign(two).runs[0].observed, load_campaign(one).runs[0].observed, rtol=1e-12)
    np.testing.assert_allclose(load_campaign(one).runs[0].observed[0, 2], COLUMNS["az"][:900].mean(), atol=0.01)
    # What is stated on the command line goes before it.
    given = read_recordings([second], mapping=one / "mapping.toml", gravity_m_s2=9.7).campaign
    assert given.document["site"]["gravity_m_s2"] == 9.7
    unnamed = tmp_path / "unnamed.log"
    np.savetxt(unnamed, ROWS, fmt="%.9g")
    text = (convert([unnamed], tmp_path / "three") / "mapping.toml").read_text()
    assert "columns" not in tomllib.loads(text)
    assert "# ax = 2" in text


def test_without_out_nothing_is_written(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    file = table(tmp_path / "log", ROWS, " ".join(("time_s", *NAMES)))
    assert run(["convert", str(file)]) == 0
    shown = capsys.readouterr().out
    assert f"ax ← column 2 'ax' ({ROWS[0, 1]:.6g}, {ROWS[1, 1]:.6g}, {ROWS[2, 1]:.6g} …)" in shown
    assert "nothing was written; add --out FOLDER" in shown
    assert [path.name for path in tmp_path.iterdir()] == ["log"]


def test_parts_of_a_record_are_joined_and_others_are_runs_of_their_own(tmp_path: Path) -> None:
    names = " ".join(("time_s", *NAMES))
    files = [table(tmp_path / f"part{place}", part, names) for place, part in enumerate(np.array_split(ROWS, 3))]
    whole = read_recordings(files).campaign
    assert list(whole.tables) == ["runs/recording.csv"]
    np.testing.assert_allclose(whole.tables["runs/recording.csv"]["time_s"], ROWS[:, 0], atol=1e-9)
    again = table(tmp_path / "again", ROWS, names)
    both = read_recordings([again, table(tmp_path / "other", ROWS, names)]).campaign
    assert [entry["name"] for entry in both.document["run"]] == ["recording-1", "recording-2"]


def test_a_record_at_rest_is_told_by_its_attitude(tmp_path: Path) -> None:
    time = np.arange(0, 900, 0.1)
    warm = 40 * np.sin(np.pi * time / 900)
    noise = np.random.default_rng(9).normal(0, 0.01, (len(time), 6))
    force = np.c_[np.full(len(time), 0.1), 0.002 * warm, 9.8 + 0.012 * warm]
    rows = np.c_[time, force + noise[:, :3], noise[:, 3:], 20 + warm]
    for columns, procedure in ((rows, "thermal_ramp"), (rows[:, :7], "static_record")):
        names = " ".join(("time_s", *NAMES, "temp")[: columns.shape[1]])
        made = read_recordings([table(tmp_path / "log", columns, names)]).campaign
        assert made.document["run"][0]["procedure"] == procedure
        assert "s in one attitude" in made.guesses["procedure"]


def test_a_temperature_of_a_lower_rate_and_an_empty_cell_change_no_procedure(tmp_path: Path) -> None:
    """A unit at rest over 30 K: the temperature in every third row, one cell of an accelerometer empty."""
    force = np.array([0.1, -0.2, 9.81]) + 1e-3 * np.random.default_rng(1).normal(size=(6000, 3))
    warmth = np.linspace(20.0, 50.0, len(force))
    lines = ["time_s,ax,ay,az,temperature_degC"]
    for n, (x, y, z) in enumerate(force):
        lines.append(f"{0.01 * n:.2f},{x:.5f},{'' if n == 17 else f'{y:.5f}'},{z:.5f},{'' if n % 3 else warmth[n]}")
    (tmp_path / "log.csv").write_text("\n".join(lines) + "\n")
    read = read_recordings([tmp_path / "log.csv"], accel_unit="m/s^2")
    assert [run["procedure"] for run in read.campaign.document["run"]] == ["thermal_ramp"]


def test_a_unit_of_an_option_is_spelled_as_in_a_header():
    given = read_options({"accel_unit": "m/s²", "gyro_unit": "dps", "time_unit": "msec"})
    assert (given.accel_unit, given.gyro_unit, given.time_unit) == ("m/s^2", "deg/s", "ms")
    with pytest.raises(InputError, match="'furlong' is not known"):
        read_options({"accel_unit": "furlong"})


@pytest.mark.parametrize(("axis", "sense"), [(0, 1), (1, -1), (2, -1), (2, 1)])
def test_a_ramp_rests_on_the_face_that_its_accelerometers_show(tmp_path: Path, axis: int, sense: int) -> None:
    rng, count = np.random.default_rng(3), 3000
    force = rng.normal(0, 0.01, (count, 3))
    force[:, axis] += 9.81 * sense
    rows = np.column_stack([np.arange(count) / 2, force, np.linspace(-10, 50, count)])
    names = "time_s,ax (m/s^2),ay (m/s^2),az (m/s^2),temperature_degC"
    np.savetxt(tmp_path / "log.csv", rows, delimiter=",", header=names, comments="", fmt="%.6g")
    campaign = load_campaign(convert([tmp_path / "log.csv"], tmp_path / "c", gravity_m_s2=9.81))
    [mounting] = campaign.mountings.values()
    np.testing.assert_allclose(mounting.body_to_table @ np.eye(3)[axis] * sense, [0, 0, 1], atol=1e-12)
    assert (axis == 2 and sense == 1) != any("the unit rests with its" in note for note in campaign.notes)
