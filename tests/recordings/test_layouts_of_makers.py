"""Layouts of makers' loggers and of apps, re-made by own simulation: each gives the readings of the unit."""

from collections.abc import Callable
from functools import reduce
from operator import xor
from pathlib import Path

import h5py
import numpy as np
import pytest
from test_public_layouts import FORCE, HZ, RATE, counted, table, turned  # noqa: F401

from imubayes.foundations.errors import InputError
from imubayes.foundations.units import to_si
from imubayes_recordings.convert import ReadRecordings, read_recordings
from imubayes_recordings.convert.mapping_file import mapping_text, read_mapping

Readings = tuple[np.ndarray, np.ndarray]
G = 9.80665


def sentence(name: str, values: np.ndarray) -> str:
    body = f"{name}," + ",".join(f"{value:+011.6f}" for value in values)
    return f"${body}*{reduce(xor, body.encode(), 0):02X}"


def magnetic(count: int) -> np.ndarray:
    return np.tile([0.2, -0.1, 0.45], (count, 1))


def lines(file: Path, rows: list[str]) -> list[Path]:
    file.write_text("\n".join(rows) + "\n")
    return [file]


def joined(values: np.ndarray, mark: str = ",", digits: int = 6) -> str:
    return mark.join(f"{value:.{digits}f}" for value in values)


def vectornav(folder: Path, force: np.ndarray, rate: np.ndarray) -> list[Path]:
    rows = np.column_stack([np.zeros_like(force), magnetic(len(force)), force, rate])
    return lines(folder / "vn.txt", [f"[12:00] {sentence('VNYMR', row)}" for row in rows])


def numbered(folder: Path, force: np.ndarray, rate: np.ndarray) -> list[Path]:
    rows = ["info;time;x;y;z;geo;lon;lat;alt;provider;accuracy"]
    for place, (forces, rates) in enumerate(zip(force, rate, strict=True)):
        rows += [f"4;{place / HZ:.2f};{joined(rates, ';')}", f"1;{place / HZ:.2f};{joined(forces, ';')}"]
    return lines(folder / "drive.csv", rows)


def receiver(folder: Path, force: np.ndarray, rate: np.ndarray) -> list[Path]:
    rows = np.column_stack([force, np.degrees(rate)])
    stamps = [f"  2053  {412300 + place // 100}  {place % 100 / HZ:.6f}  " for place in range(len(rows))]
    return lines(folder / "lord.log", [stamp + joined(row, "  ", 7) for stamp, row in zip(stamps, rows, strict=True)])


def camera(folder: Path, force: np.ndarray, rate: np.ndarray) -> list[Path]:
    steps = (250 / 32768, 4 / 32768)
    counts = np.column_stack([np.degrees(rate) / steps[0], force / G / steps[1]]).round().astype(int)
    keys = f"tscale,0.001\ngscale,{np.radians(steps[0]):.12f}\nascale,{steps[1]:.12f}"
    above = f"GYROFLOW IMU LOG\nversion,1.3\nid,own\norientation,XYZ\ntimestamp,1644159993\n{keys}\n"
    columns = [counted(len(force), 10), *(list(map(str, column)) for column in counts.T)]
    return table(folder / "camera.gcsv", "t,gx,gy,gz,ax,ay,az", columns, above=above)


def gravity_apart(folder: Path, force: np.ndarray, rate: np.ndarray) -> list[Path]:
    gravity = 9.81 * force / np.linalg.norm(force, axis=1, keepdims=True)
    times = [str(1_718_030_736_000_000_000 + 10_000_000 * place) for place in range(len(force))]
    seconds = [f"{place / HZ:.4f}" for place in range(len(force))]
    files = []
    for name, values in (("Accelerometer", force - gravity), ("Gravity", gravity), ("Gyroscope", rate)):
        columns = [times, seconds, *values[:, ::-1].T]
        files += table(folder / f"{name}.csv", "time,seconds_elapsed,z,y,x", columns)
    return files


def empty_times(folder: Path, force: np.ndarray, rate: np.ndarray) -> list[Path]:
    above = "// General information: \n//  MT Manager version: 2022.2.0 \n// Coordinate system: ENU\n"
    head = "\t".join(
        ["PacketCounter", "SampleTimeFine", *(f"{kind}_{axis}" for kind in ("Acc", "Gyr") for axis in "XYZ")]
    )
    columns = [counted(len(force)), ["NaN"] * len(force), *force.T, *rate.T]
    return table(folder / "wireless.txt", head, columns, "\t", above)


def units_below(folder: Path, force: np.ndarray, rate: np.ndarray) -> list[Path]:
    kinds = ("Accel_LN", "Gyro", "Mag")
    names = ["Timestamp_Unix", *(f"{kind}_{axis}" for kind in kinds for axis in "XYZ"), "Temperature_BMP280"]
    units = ["ms", *["m/(s^2)"] * 3, *["deg/s"] * 3, *["local_flux"] * 3, "Degrees Celsius"]
    above = "sep=\\t\n" + "\t".join(f"Body_8665_{name}_CAL" for name in names) + "\n"
    stamps = [f"{1595926562310.5 + 10 * place:.4f}" for place in range(len(force))]
    columns = [stamps, *force.T, *np.degrees(rate).T, *magnetic(len(force)).T, ["24.5"] * len(force)]
    return table(folder / "body.csv", "\t".join(units), columns, "\t", above)


def dotted_units(folder: Path, force: np.ndarray, rate: np.ndarray) -> list[Path]:
    above = "timestamp\tstatus\taccelX\taccelY\taccelZ\tgyroX\tgyroY\tgyroZ\ttemperature\n"
    units = "\t".join(["(us)", "(na)", *["(m.s^-2)"] * 3, *["(deg.s^-1)"] * 3, "(degC)"])
    warm = ["31.25"] * len(force)
    columns = [counted(len(force), 10_000), ["0x7f"] * len(force), *force.T, *np.degrees(rate).T, warm]
    return table(folder / "imu.txt", units, columns, "\t", above)


def tagged_within(folder: Path, force: np.ndarray, rate: np.ndarray) -> list[Path]:
    rows = []
    for place, (forces, rates) in enumerate(zip(force, rate, strict=True)):
        parts = (("$ACC", forces / G * 1000), ("$MAG", np.array([200, -100, 450.0])), ("$ARS", np.degrees(rates)))
        rows += [f"$TIM,{1247663638.5 + place / HZ:.3f},{tag},{joined(values, ',', 4)}" for tag, values in parts]
    return lines(folder / "pack.txt", rows)


def long_table(folder: Path, force: np.ndarray, rate: np.ndarray) -> list[Path]:
    rows = ["timestamp,sensor,x,y,z"]
    for place, (forces, rates) in enumerate(zip(force, rate, strict=True)):
        rows += [f"{10 * place},accelerometer,{joined(forces)}", f"{10 * place},gyroscope,{joined(rates)}"]
    return lines(folder / "long.csv", rows)


def listed_in_quotes(folder: Path, force: np.ndarray, rate: np.ndarray) -> list[Path]:
    rows = ["% LogFile of a phone", "%"]
    for what, tag, unit in (("Accelerometer", "ACCE", "m/s^2"), ("Gyroscope", "GYRO", "rad/s")):
        names = ";".join(["AppTimestamp(s)", "SensorTimestamp(s)", *(f"{tag[:3]}_{axis}({unit})" for axis in "XYZ")])
        rows.append(f"% {what} data: \t'{tag};{names};Accuracy(integer)'")
    for place, (forces, rates) in enumerate(zip(force, rate, strict=True)):
        times = f"{1 + place / HZ:.3f};{8902 + place / HZ:.5f}"
        rows += [f"ACCE;{times};{joined(forces, ';')};3", f"GYRO;{times};{joined(rates, ';')};3"]
    return lines(folder / "phone.txt", rows)


def linear_beside(folder: Path, force: np.ndarray, rate: np.ndarray) -> list[Path]:
    kinds = (("ACCELEROMETER", "m/s²"), ("GRAVITY", "m/s²"), ("LINEAR ACCELERATION", "m/s²"), ("GYROSCOPE", "rad/s"))
    names = [f"{kind} {axis} ({unit})" for kind, unit in kinds for axis in "XYZ"]
    gravity = 9.81 * force / np.linalg.norm(force, axis=1, keepdims=True)
    stamps = [
        f"2026-10-02 07:{place // 6000:02d}:{place // 100 % 60:02d}:{place % 100:02d}0" for place in range(len(force))
    ]
    columns = [*force.T, *gravity.T, *(force - gravity).T, *rate.T, counted(len(force), 10), stamps]
    head = ";".join([*names, "Time since start in ms ", "YYYY-MO-DD HH-MI-SS_SSS"])
    return table(folder / "sensors.csv", head, columns, ";")


def in_g_beside(folder: Path, force: np.ndarray, rate: np.ndarray) -> list[Path]:
    gravity = 9.81 * force / np.linalg.norm(force, axis=1, keepdims=True)
    columns = [np.arange(len(force)) / HZ, *(force / G).T, *(force - gravity).T, *rate.T, [""] * len(force)]
    return table(folder / "toolbox.csv", "time,gFx,gFy,gFz,ax,ay,az,wx,wy,wz,", columns)


def bare_degrees(folder: Path, force: np.ndarray, rate: np.ndarray) -> list[Path]:
    names = [f"{kind}{axis}({unit})" for kind, unit in (("a", "g"), ("w", "deg/s")) for axis in "xyz"]
    clock = [f"07:{place // 6000:02d}:{place % 6000 / HZ:06.3f}" for place in range(len(force))]
    columns = [["0x50"] * len(force), clock, *(force / G).T, *np.degrees(rate).T, ["25.1"] * len(force)]
    head = "\t".join(["address", "Time(s)", *names, "T(°)"])
    return table(folder / "motion.txt", head, columns, "\t", "StartTime: 2026-10-02 07:48:45.830\n")


def since_the_epoch(folder: Path, force: np.ndarray, rate: np.ndarray) -> list[Path]:
    names = [f"{kind}{axis}({unit})" for kind, unit in (("A", "g"), ("G", "dps")) for axis in "XYZ"]
    stamps = [str(1_700_000_000_000 + 10 * place) for place in range(len(force))]
    columns = [stamps, *(force / G).T, *np.degrees(rate).T]
    return table(folder / "edge.csv", ",".join(["Timestamp(epoch_ms)", *names]), columns)


def parted_stamps(folder: Path, force: np.ndarray, rate: np.ndarray) -> list[Path]:
    vectors = [f"{name}.{axis}" for name in ("angular_velocity", "linear_acceleration") for axis in "xyz"]
    head = ",".join(["header.seq", "header.stamp.secs", "header.stamp.nsecs", "header.frame_id", *vectors])
    seconds = [str(1_600_000_000 + place // 100) for place in range(len(force))]
    rest = [str(place % 100 * 10_000_000) for place in range(len(force))]
    columns = [counted(len(force)), seconds, rest, ["imu"] * len(force), *rate.T, *force.T]
    return table(folder / "topic.csv", head, columns)


def groups(folder: Path, force: np.ndarray, rate: np.ndarray) -> list[Path]:
    with h5py.File(folder / "monitor.h5", "w") as content:
        sensor = content.create_group("Sensors/1234")
        sensor["Accelerometer"], sensor["Gyroscope"], sensor["Magnetometer"] = force, rate, magnetic(len(force))
        sensor["Time"] = (1_600_000_000_000_000 + 10_000 * np.arange(len(force))).astype(np.uint64)
        content["Processed/1234/Orientation"] = np.tile([1.0, 0, 0, 0], (len(force), 1))
    return [folder / "monitor.h5"]


LAYOUTS = (
    vectornav, numbered, receiver, camera, gravity_apart, empty_times, units_below, dotted_units, tagged_within,
    long_table, listed_in_quotes, linear_beside, in_g_beside, bare_degrees, since_the_epoch, parted_stamps, groups,
)  # fmt: skip
# What the file does not hold: its rate, or which number is which sensor.
STATED = {
    vectornav: {"sample_rate_hz": HZ},
    empty_times: {"sample_rate_hz": HZ},
    numbered: {"topic": ["acc=1", "gyro=4"]},
    tagged_within: {"accel_unit": "mg"},  # asked for: cm/s² are near
}


def assert_readings(read: ReadRecordings, readings: Readings, tolerance: float = 2e-3) -> None:
    columns = next(iter(read.campaign.tables.values()))
    entries = {entry["name"]: entry for entry in read.campaign.document["channel"]}
    for names, values in zip((FORCE, RATE), readings, strict=True):
        for name, truth in zip(names, values.T, strict=True):
            found = np.asarray(columns[name]) / entries[name]["scale"] * to_si(entries[name]["per"])
            np.testing.assert_allclose(found, truth, atol=tolerance)
    np.testing.assert_allclose(np.diff(columns["time_s"]), 1 / HZ, atol=2e-6)


@pytest.mark.parametrize("layout", LAYOUTS, ids=lambda layout: layout.__name__)
def test_a_layout_gives_the_readings(tmp_path: Path, turned: Readings, layout: Callable) -> None:  # noqa: F811
    read = read_recordings(layout(tmp_path, *turned), latitude_deg=48, **STATED.get(layout, {}))
    assert_readings(read, turned)


def test_a_mapping_of_numbered_lines_reads_others_of_the_kind(tmp_path: Path, turned: Readings) -> None:  # noqa: F811
    files = numbered(tmp_path, *turned)
    read = read_recordings(files, latitude_deg=48, **STATED[numbered])
    (tmp_path / "mapping.toml").write_text(mapping_text(read.tables, read.campaign.options, read.campaign.guesses))
    assert read_mapping(tmp_path / "mapping.toml")["topic"] == ["acc=1", "gyro=4"]
    assert_readings(read_recordings(files, mapping=tmp_path / "mapping.toml"), turned)


def test_lines_that_a_number_distinguishes_ask_which_is_which(tmp_path: Path, turned: Readings) -> None:  # noqa: F811
    files = numbered(tmp_path, *turned)
    with pytest.raises(
        InputError, match=r"a number distinguishes: '4' \(.* at rest\), '1' \(9.* at rest: g in m/s\^2\)"
    ) as asked:
        read_recordings(files, latitude_deg=48)
    assert asked.value.issues[0].remedy == "state it: --topic acc=1 --topic gyro=4"
    with pytest.raises(InputError, match="'baro' of 'baro=1' is not a kind of sensor"):
        read_recordings(files, latitude_deg=48, topic=["baro=1"])


def test_a_sentence_with_a_wrong_checksum_is_left_out(tmp_path: Path, turned: Readings) -> None:  # noqa: F811
    [file] = vectornav(tmp_path, *turned)
    rows = file.read_text().splitlines()
    rows[40] = rows[40].replace("*", "1*", 1)
    file.write_text("\n".join(rows) + "\n")
    read = read_recordings([file], latitude_deg=48, sample_rate_hz=HZ)
    assert any("1 sentence with a wrong checksum" in note for note in read.campaign.document["notes"])
    assert len(next(iter(read.campaign.tables.values()))["ax"]) == len(rows) - 1


def test_gravity_of_other_times_is_not_added(tmp_path: Path, turned: Readings) -> None:  # noqa: F811
    files = gravity_apart(tmp_path, *turned)
    rows = files[1].read_text().splitlines()
    files[1].write_text("\n".join([rows[0], *rows[2:]]) + "\n")
    with pytest.raises(InputError, match="gravity and the acceleration without it do not have the same times"):
        read_recordings(files, latitude_deg=48)


def test_three_columns_that_follow_no_turn_are_named_and_not_read(tmp_path: Path, turned: Readings) -> None:  # noqa: F811
    force, _ = turned
    other = np.random.default_rng(4).normal(0, 1, force.shape)
    columns = [counted(len(force), 10), *force.T, *other.T]
    read = read_recordings(table(tmp_path / "log.csv", "ms,x_A,y_A,z_A,x_Q,y_Q,z_Q", columns), latitude_deg=48)
    assert "gx" not in next(iter(read.campaign.tables.values()))
    assert "x_Q, y_Q, z_Q may be gyros, which no turns show: not read" in "\n".join(read.campaign.document["notes"])


def test_words_beside_six_named_channels_are_no_sensors(tmp_path: Path, turned: Readings) -> None:  # noqa: F811
    words = [("walk", "acceleration")[place // 7 % 2] for place in range(len(turned[0]))]
    columns = [np.arange(len(words)) / HZ, words, *turned[0].T, *turned[1].T]
    assert_readings(
        read_recordings(table(tmp_path / "log.csv", f"t,activity,{','.join((*FORCE, *RATE))}", columns)), turned
    )


def test_all_sensors_that_cannot_be_chosen_are_named_at_once(tmp_path: Path, turned: Readings) -> None:  # noqa: F811
    names = [f"{state}{kind}{axis}" for state in ("UnComp", "") for kind in ("Acc", "Gyro") for axis in "XYZ"]
    columns = [np.arange(len(turned[0])) / HZ, *turned[0].T, *turned[1].T, *turned[0].T, *turned[1].T]
    with pytest.raises(InputError) as refused:
        read_recordings(table(tmp_path / "log.csv", ",".join(["Time", *names]), columns), latitude_deg=48)
    assert [issue.what for issue in refused.value.issues] == [
        "2 sets of columns may be ax ay az",
        "2 sets of columns may be gx gy gz",
    ]


def test_g_is_said_to_be_the_gravity_of_the_site(tmp_path: Path, turned: Readings) -> None:  # noqa: F811
    def notes(gravity: float) -> str:
        read = read_recordings(since_the_epoch(tmp_path, *turned), latitude_deg=48, gravity_m_s2=gravity)
        return "\n".join(read.campaign.document["notes"])

    assert "larger by 214 ppm than in its own unit" in notes(9.80875)
    assert "gravity of the site" not in notes(9.80666)
