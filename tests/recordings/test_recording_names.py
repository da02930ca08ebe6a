"""Which column of a foreign text table is which channel: by its name, or refused."""

import itertools
from pathlib import Path

import numpy as np
import pytest
from tumble_files import NAMES, tumble_log

from imubayes.campaign import load_campaign
from imubayes.cli.main import run
from imubayes.foundations.errors import InputError
from imubayes_recordings.convert import convert, read_recordings
from imubayes_recordings.convert.column_names import role_of
from imubayes_recordings.convert.formats import open_recording
from imubayes_recordings.convert.options import read_options
from imubayes_recordings.convert.recorded_runs import recorded_runs
from imubayes_recordings.convert.table_choice import choose_tables

SIGNS = ("", "# ", "#", "% ", "%%", "// ", "; ", "\ufeff", "\ufeff# ")
DELIMITERS = (",", ";", "\t", " ", ", ")
TIMES = 0.01 * np.arange(5.0)
VALUES = np.random.default_rng(3).normal(size=(5, 9))


def table(file: Path, heading: str, values: np.ndarray, delimiter: str = " ") -> Path:
    rows = [delimiter.join(f"{value:.6f}" for value in row) for row in values]
    file.write_text("\n".join([*([heading] if heading else []), *rows, ""]))
    return file


def read(*files: Path, **options) -> tuple[dict[str, np.ndarray], str]:
    chosen = read_options({"sample_rate_hz": 10.0} | options)
    [run] = recorded_runs(choose_tables([open_recording(file) for file in files], chosen), chosen)
    return run.columns, "\n".join(run.notes)


@pytest.mark.parametrize(("sign", "delimiter", "quote"), list(itertools.product(SIGNS, DELIMITERS, ("", '"', "'"))))
def test_each_channel_has_the_column_of_its_name(tmp_path: Path, sign: str, delimiter: str, quote: str) -> None:
    names = list(np.random.default_rng(len(sign)).permutation([*NAMES, "temperature_degC", "mag", "n"]))
    file = table(tmp_path / "log", sign + delimiter.join(f"{quote}{name}{quote}" for name in names), VALUES, delimiter)
    columns, note = read(file)
    for name in (*NAMES, "temperature_degC"):
        np.testing.assert_allclose(columns[name], VALUES[:, names.index(name)], atol=1e-6)
        assert f"{name} ← column {names.index(name) + 1} '{name}' ({columns[name][0]:.6g}, " in note
    assert "not read" in note


@pytest.mark.parametrize(("sign", "delimiter"), list(itertools.product(SIGNS, DELIMITERS)))
@pytest.mark.parametrize("lost", ["name", "field", "channel"])
def test_names_that_do_not_fit_the_fields_are_refused(tmp_path: Path, sign: str, delimiter: str, lost: str) -> None:
    names = [*NAMES, "temp"]
    heading = sign + delimiter.join(names[: 6 if lost == "name" else 7])
    if lost == "channel":
        heading = heading.replace("az", "foo_z")
    file = table(tmp_path / "log", heading, VALUES[:, : 6 if lost == "field" else 7], delimiter)
    with pytest.raises(InputError) as refused:
        read(file)
    [issue] = refused.value.issues
    assert all((issue.what, issue.where, issue.allowed, issue.remedy))
    assert ("there is no az" if lost == "channel" else "the header has") in issue.what
    columns, _ = read(file, columns={name: place for place, name in enumerate(NAMES, 1)})
    np.testing.assert_allclose(columns["gz"], VALUES[:, 5], atol=1e-6)


def test_names_among_other_lines_and_with_another_delimiter(tmp_path: Path) -> None:
    heading = "# recorded by hand\n#\n# ax,ay,az,gx,gy,gz"
    np.testing.assert_allclose(read(table(tmp_path / "a", heading, VALUES[:, :6]))[0]["gz"], VALUES[:, 5], atol=1e-6)
    # The index of a table that pandas wrote has no name, or is called #.
    for first in ("", "#"):
        file = table(tmp_path / "b", ",".join((first, *NAMES)), VALUES[:, :7], ",")
        np.testing.assert_allclose(read(file)[0]["ax"], VALUES[:, 1], atol=1e-6)
    # A delimiter at the end of each line, and a first line of text and numbers.
    file = table(tmp_path / "c", ",".join(NAMES), VALUES[:, :6], ",")
    file.write_text("\n".join(f"{line}," if n else line for n, line in enumerate(file.read_text().splitlines())))
    np.testing.assert_allclose(read(file)[0]["gz"], VALUES[:, 5], atol=1e-6)
    stated = {name: f"{place}" for place, name in enumerate(NAMES, 1)}
    file = table(tmp_path / "d", "time,1,2,3,4,5,6", np.c_[TIMES, VALUES[:, 1:7]], ",")
    assert len(read(file, columns=stated | {"time_s": "time"}, sample_rate_hz=None)[0]["ax"]) == len(VALUES)


@pytest.mark.parametrize("width", [3, 5, 7, 9])
def test_a_table_of_another_width_without_names_is_refused(tmp_path: Path, width: int) -> None:
    file = table(tmp_path / "log", "", VALUES[:, :width])
    for columns in ({}, {"time_s": 1}):
        with pytest.raises(InputError, match=f"{width} columns and no names"):
            read(file, columns=columns)
    if width > 6:
        columns, note = read(file, columns={name: place for place, name in enumerate(NAMES, 2)})
        np.testing.assert_allclose(columns["ax"], VALUES[:, 1], atol=1e-6)
        assert "no names, numbers from line 1" in note
    assert "ax ← column 1" in read(table(tmp_path / "six", "", VALUES[:, :6]))[1]


def test_a_stated_time_hides_no_named_channel(tmp_path: Path) -> None:
    file = table(tmp_path / "log", " ".join(("ustime", *NAMES)), np.c_[1000 * np.arange(5.0), VALUES[:, :6]])
    columns, _ = read(file, columns={"time_s": "ustime"}, time_unit="us", sample_rate_hz=None)
    assert set(columns) == {"time_s", *NAMES}
    np.testing.assert_allclose(columns["time_s"], 1e-3 * np.arange(5))
    renamed = table(tmp_path / "other", " ".join(("first", *NAMES[1:])), VALUES[:, :6])
    assert set(read(renamed, columns={"ax": "first"})[0]) == {"time_s", *NAMES}
    # Channels that are stated and no others: a unit with fewer.
    alone = table(tmp_path / "alone", "rate temp", VALUES[:, :2])
    assert set(read(alone, columns={"gx": "rate"})[0]) == {"time_s", "gx", "temperature_degC"}


def test_two_columns_of_one_name_are_refused(tmp_path: Path) -> None:
    file = table(tmp_path / "log", " ".join((*NAMES, "ax")), VALUES[:, :7])
    with pytest.raises(InputError, match="2 columns are named 'ax'"):
        read(file)


def test_accelerometers_and_gyros_in_two_files(tmp_path: Path) -> None:
    values = np.c_[TIMES, VALUES[:, 1:4]]
    gyro = table(tmp_path / "gyro", "", values)
    columns, note = read(table(tmp_path / "acc", "# x y z time", values[:, [1, 2, 3, 0]]), gyro)
    np.testing.assert_allclose(columns["ax"], values[:, 1], atol=1e-6)
    np.testing.assert_allclose(columns["gz"], values[:, 3], atol=1e-6)
    assert len(note.splitlines()) == 2
    for heading, width in (("# a b c d", 4), ("# time x y", 4), ("", 5)):
        with pytest.raises(InputError):
            read(table(tmp_path / "bad", heading, VALUES[:, :width]), gyro)


@pytest.mark.parametrize("delimiter", [" ", ","])
def test_savetxt_is_converted_and_told(tmp_path: Path, capsys: pytest.CaptureFixture, delimiter: str) -> None:
    columns, _ = tumble_log(poses=6)
    values = np.stack([*(columns[name] for name in NAMES), 0 * columns["ax"] + 30], axis=1)
    np.savetxt(tmp_path / "log", values, fmt="%.7g", delimiter=delimiter, header=delimiter.join((*NAMES, "temp")))
    command = ["convert", tmp_path / "log", "--sample-rate-hz", 100, "--gravity-m-s2", 9.8]
    assert run([*map(str, command), "--latitude-deg", "48", "--out", str(tmp_path / "c")]) == 0
    assert "gz ← column 6 'gz'" in capsys.readouterr().out
    read_back = load_campaign(tmp_path / "c").runs[0]
    assert read_back.observed[0, 2] == pytest.approx(columns["az"][:1000].mean(), abs=0.01)
    values = values[:, [6, 0, 1, 2, 3, 4, 5]]
    np.savetxt(tmp_path / "log", values, header=" ".join(NAMES))
    assert run([*map(str, command), "--out", str(tmp_path / "d")]) == 2
    assert not (tmp_path / "d").exists()


UNITS = ["[m/s^2]", "[m/s^2]", "[m/s^2]", "[rad/s]", "[rad/s]", "[rad/s]"]
STATED = [f"{name} {unit}" for name, unit in zip(NAMES, UNITS, strict=True)]


@pytest.mark.parametrize(
    ("heading", "options", "text"),
    [
        ([*STATED[:3], "gx (rpm)", "gy (rpm)", "gz (rpm)"], {}, "unit 'rpm' of gx is not known"),
        (["time [0.1 ms]", *STATED], {"sample_rate_hz": None}, r"unit '0\.1 ms' of time_s is not known"),
        (STATED, {"columns": {"ay": "az [m/s^2]"}}, "would be ay and az"),
    ],
)
def test_what_names_and_units_leave_open_is_refused(tmp_path: Path, heading: list[str], options: dict, text: str):
    rows = VALUES[:, :6] if len(heading) == 6 else np.c_[1e4 * TIMES, VALUES[:, :6]]
    with pytest.raises(InputError, match=text):
        read(table(tmp_path / "log", ",".join(heading), rows, ","), **options)


@pytest.mark.parametrize(
    ("heading", "options", "text"),
    [
        (STATED, {"accel_unit": "g"}, r"are in m/s\^2, but g is requested"),
        (["ax [g]", "ay [g]", "az [g]", *STATED[3:]], {}, "g, which is 9.8"),
    ],
)
def test_units_that_option_or_gravity_contradict_are_refused(
    tmp_path: Path, heading: list[str], options: dict, text: str
):
    rows = np.tile([0.1, -0.2, 9.81, 0.001, 0.002, 0.003], (600, 1)) + 1e-4 * np.random.default_rng(1).normal(
        size=(600, 6)
    )
    file = table(tmp_path / "log.csv", ",".join(heading), rows, ",")
    given = {"sample_rate_hz": 10.0, "procedure": "static_record", "latitude_deg": 48.0} | options
    with pytest.raises(InputError, match=text):
        convert([file], tmp_path / "out", **given)


def test_velocities_and_angles_are_no_channels(tmp_path: Path) -> None:
    velocity = table(
        tmp_path / "v", ",".join([f"velocity_{axis} [m/s]" for axis in "xyz"] + STATED[3:]), VALUES[:, :6], ","
    )
    assert not {"ax", "ay", "az"} & set(read(velocity)[0])
    angle = table(tmp_path / "a", ",".join(STATED[:3] + [f"angle_{axis} [deg]" for axis in "xyz"]), VALUES[:, :6], ",")
    assert not {"gx", "gy", "gz"} & set(read(angle)[0])


def test_an_empty_last_cell_of_the_first_row_shifts_no_name(tmp_path: Path) -> None:
    """A table with row names that have no heading: one name less than fields, and the first row ends with nothing."""
    rows = np.c_[np.arange(len(VALUES)), VALUES[:, :7]]
    file = table(tmp_path / "log", ",".join([*STATED, "temperature [degC]"]), rows, ",")
    lines = file.read_text().splitlines()
    lines[1] = ",".join([*lines[1].split(",")[:7], ""])
    file.write_text("\n".join(lines))
    with pytest.raises(InputError, match="the header has 7 names, the rows have 8 fields"):
        read(file)


@pytest.mark.parametrize(
    ("name", "unit"),
    [("temp_F", "degF"), ("temperature_K", "K"), ("temp [raw]", None), ("temps", None), ("accel_f", "")],
)
def test_units_at_the_end_of_a_name(name: str, unit: str | None) -> None:
    role = role_of(name)
    if name == "accel_f":
        assert role is None  # an accelerometer without an axis
    else:
        assert (role and role.unit) == unit


def test_accelerations_without_gravity_alone_are_refused(tmp_path: Path) -> None:
    names = [f"{kind}.{axis}" for kind in ("userAcceleration", "rotationRate") for axis in "xyz"]
    rows = np.column_stack([np.arange(600) / 50, 0.01 * np.random.default_rng(1).normal(size=(600, 6))])
    np.savetxt(tmp_path / "phone.csv", rows, delimiter=",", header=",".join(["time_s", *names]), comments="")
    with pytest.raises(InputError, match="gravity was subtracted from userAcceleration"):
        read_recordings([tmp_path / "phone.csv"])
    gyros = {f"g{axis}": f"rotationRate.{axis}" for axis in "xyz"}
    made = read_recordings([tmp_path / "phone.csv"], gyro_unit="rad/s", columns=gyros).campaign
    assert [each["name"] for each in made.document["channel"]] == ["gx", "gy", "gz"]
