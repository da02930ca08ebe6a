"""Kinds of recordings that were read wrongly without a word, or refused without a remedy: each is read, or reported."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from recording_writers import NAMES, as_matrix
from tumble_files import tumble_log

from imubayes.foundations.errors import InputError
from imubayes_recordings.convert import ReadRecordings, read_recordings
from imubayes_recordings.convert.column_names import role_of
from imubayes_recordings.convert.formats.cell_values import seconds_of_clock, seconds_of_stamp

COLUMNS, _ = tumble_log(poses=9)
ROWS = as_matrix(COLUMNS)
HEAD = "time," + ",".join(NAMES)


def text(rows: np.ndarray, head: str = HEAD, sign: str = ",") -> str:
    return "\n".join([head, *(sign.join(f"{value:.9g}" for value in row) for row in rows)]) + "\n"


def notes(read: ReadRecordings) -> str:
    return "\n".join(read.campaign.document["notes"])


def channels(read: ReadRecordings) -> np.ndarray:
    return np.stack([read.campaign.tables["runs/recording.csv"][name] for name in NAMES], axis=1)


def comma(value: float) -> str:
    return f"{value:.5f}".replace(".", ",")


def arduino(row: np.ndarray) -> str:
    return " ".join(f"{name.upper()}: {value:.6f}" for name, value in zip(("t", *NAMES), row, strict=True))


def record(row: np.ndarray) -> str:
    return json.dumps({"t": round(row[0], 4), "acc": list(row[1:4].round(6)), "gyro": list(row[4:].round(6))})


def monitor(row: np.ndarray) -> str:
    return f"10:{int(row[0] // 60):02d}:{row[0] % 60:06.3f} -> {','.join(f'{value:.6f}' for value in row[1:])}"


def phone(row: np.ndarray) -> str:
    stamp = f"2026-03-01 10:{int(row[0] // 60):02d}:{row[0] % 60:06.3f} +0100"
    return ",".join([stamp, *(f"{value:.6f}" for value in row[1:])])


LINES: dict[str, tuple[str, Callable[[np.ndarray], str]]] = {
    "labels": ("sensor found", arduino),
    "JSON": ("", record),
    "serial monitor": ("", monitor),
    "date, time and zone": (HEAD, phone),
    "decimal commas in quotes": (HEAD, lambda row: ",".join(f'"{comma(value)}"' for value in row)),
    "sentence": ("connection successful", lambda row: ",".join(f"{value:.6f}" for value in row)),
    "p q r": ("t,ax,ay,az,p [rad/s],q [rad/s],r [rad/s]", lambda row: ",".join(f"{value:.6f}" for value in row)),
    "text beside": (f"{HEAD},temp", lambda row: ",".join([*(f"{value:.6f}" for value in row), "cold"])),
    "missing words": (f"{HEAD},temp", lambda row: ",".join([*(f"{value:.6f}" for value in row), "#N/A"])),
    "units with brackets": (
        "sep=\t\nt\tax\tay\taz\tgx\tgy\tgz\ns\tm/(s^2)\tm/(s^2)\tm/(s^2)\trad/s\trad/s\trad/s",
        lambda row: "\t".join(f"{value:.6f}" for value in row),
    ),
    "LabVIEW": (
        "LabVIEW Measurement\t\nWriter_Version\t2\nReader_Version\t2\nDate\t2026/03/01\n***End_of_Header***\t\n"
        + "".join(
            f"{name}{chr(9)}{chr(9).join(['1.0E+0'] * 6)}\t\n" for name in ("Channels", "Samples", "X0", "Delta_X")
        )
        + "***End_of_Header***\t\t\t\t\t\t\t\nX_Value\tAccX\tAccY\tAccZ\tGyroX\tGyroY\tGyroZ\tComment",
        lambda row: "\t".join(f"{value:.6f}" for value in row),
    ),
}


@pytest.mark.parametrize("kind", LINES)
def test_lines_as_programs_write_them(kind: str, tmp_path: Path) -> None:
    head, line = LINES[kind]
    file = tmp_path / "log.txt"
    file.write_text("\n".join([*filter(None, [head]), *map(line, ROWS)]) + "\n")
    np.testing.assert_allclose(channels(read_recordings([file])), ROWS[:, 1:], atol=2e-5)


def test_header_that_comes_again(tmp_path: Path) -> None:
    (file := tmp_path / "log.csv").write_text("".join(text(part) for part in np.array_split(ROWS, 4)))
    assert len(channels(read_recordings([file]))) == len(ROWS)


def test_pauses_are_no_packets(tmp_path: Path) -> None:
    paused = ROWS.copy()
    paused[1500:, 0] += 600
    (file := tmp_path / "log.csv").write_text(text(paused))
    read = read_recordings([file])
    np.testing.assert_allclose(np.diff(read.campaign.tables["runs/recording.csv"]["time_s"])[:1499], 0.01, atol=1e-6)
    assert "1 gap," in notes(read)


def test_time_that_starts_again_with_the_week(tmp_path: Path) -> None:
    week = ROWS.copy()
    week[:, 0] = (604780 + week[:, 0]) % 604800
    (file := tmp_path / "log.csv").write_text(text(week, HEAD.replace("time", "GPS TOW")))
    time = read_recordings([file]).campaign.tables["runs/recording.csv"]["time_s"]
    np.testing.assert_allclose(np.diff(time), 0.01, atol=2e-3)


def test_fine_time_of_another_program(tmp_path: Path) -> None:
    ticks = ROWS.copy()
    ticks[:, 0] = (ticks[:, 0] * 1e6).round()
    (file := tmp_path / "log.csv").write_text(text(ticks, HEAD.replace("time", "SampleTimeFine")))
    read = read_recordings([file])
    assert read.campaign.tables["runs/recording.csv"]["time_s"][-1] == pytest.approx(ROWS[-1, 0] - ROWS[0, 0], abs=1e-3)
    assert "guessed, time_unit = us" in notes(read)


def test_unit_of_the_gyros_that_turns_contradict(tmp_path: Path) -> None:
    degrees = ROWS.copy()
    degrees[:, 4:] = np.degrees(degrees[:, 4:])
    head = "time,ax,ay,az,gx [rad/s],gy [rad/s],gz [rad/s]"
    (file := tmp_path / "log.csv").write_text(text(degrees, head))
    with pytest.raises(InputError, match="--gyro-unit deg/s"):
        read_recordings([file])
    read_recordings([file], gyro_unit="deg/s")  # the remedy is one


def test_unit_of_the_accelerometers_that_gravity_contradicts(tmp_path: Path) -> None:
    in_g = ROWS.copy()
    in_g[:, 1:4] /= 9.80665
    (file := tmp_path / "log.csv").write_text(text(in_g, "time,ax [m/s^2],ay [m/s^2],az [m/s^2],gx,gy,gz"))
    with pytest.raises(InputError, match="accel-unit"):
        read_recordings([file])
    assert read_recordings([file], accel_unit="g").campaign.options.accel_unit == "g"


def test_counts_without_names_are_no_increments(tmp_path: Path) -> None:
    rates = np.degrees(ROWS[:, 4:]) * 131
    # At rest the rates, over the step of the time, happen to be g.
    rates += np.array([80, -50, 27]) - np.median(rates, axis=0)
    counts = np.column_stack([np.arange(len(ROWS)) * 10, ROWS[:, 1:4] * 1670, rates]).round()
    (file := tmp_path / "log.txt").write_text("\n".join(",".join(f"{v:.0f}" for v in row) for row in counts))
    np.testing.assert_array_equal(channels(read_recordings([file])), counts[:, 1:])


@pytest.mark.parametrize("void", [0.0, -999.0])
def test_rows_without_a_reading(void: float, tmp_path: Path) -> None:
    rows = ROWS.copy()
    rows[::500, 1:] = void
    (file := tmp_path / "log.csv").write_text(text(rows))
    read = read_recordings([file])
    assert len(channels(read)) == len(ROWS) - len(ROWS[::500])
    assert f"all six channels read the same ({void:g})" in notes(read)


@pytest.mark.parametrize("usual", [298.0, -3000.0, 2500.0])
def test_temperature_that_is_none_in_celsius(usual: float, tmp_path: Path) -> None:
    warm = np.column_stack([ROWS, np.linspace(usual, usual + 5, len(ROWS))])
    (file := tmp_path / "log.csv").write_text(text(warm, f"{HEAD},temp"))
    read = read_recordings([file])
    assert "temperature_degC" not in read.campaign.tables["runs/recording.csv"]
    assert "is not in degC" in notes(read)


def test_temperature_in_rows_of_its_own(tmp_path: Path) -> None:
    lines = [f"{HEAD},temperature"]
    for k, row in enumerate(ROWS):
        lines.append(",".join([*(f"{value:.9g}" for value in row), "NaN"]))
        if k % 10 == 0:
            lines.append(f"{row[0] + 0.001:.6f},,,,,,,{20 + row[0]:.3f}")
    (file := tmp_path / "log.csv").write_text("\n".join(lines) + "\n")
    read = read_recordings([file])
    warmth = read.campaign.tables["runs/recording.csv"]["temperature_degC"]
    np.testing.assert_allclose(warmth, 20 + ROWS[:, 0], atol=0.11)
    assert "separate rows: interpolated" in notes(read)


def test_forces_and_rates_in_rows_of_their_own(tmp_path: Path) -> None:
    lines = [HEAD]
    for row in ROWS:
        force, rate = (",".join(f"{value:.9g}" for value in part) for part in (row[1:4], row[4:]))
        lines += [f"{row[0]:.4f},{force},,,", f"{row[0] + 0.004:.4f},,,,{rate}"]
    (file := tmp_path / "log.csv").write_text("\n".join(lines) + "\n")
    read = read_recordings([file])
    found = channels(read)
    assert np.isfinite(found).all()
    np.testing.assert_allclose(found[:, :3], ROWS[1:, 1:4], atol=1e-6)
    assert "turns between poses" in notes(read)


def test_fields_of_several_elements(tmp_path: Path) -> None:
    table = np.zeros(len(ROWS), dtype=[("t", "f8"), ("acc", "f8", 3), ("gyr", "f8", 3)])
    table["t"], table["acc"], table["gyr"] = ROWS[:, 0], ROWS[:, 1:4], ROWS[:, 4:]
    np.save(file := tmp_path / "log.npy", table)
    np.testing.assert_array_equal(channels(read_recordings([file])), ROWS[:, 1:])


def test_unit_with_one_axis(tmp_path: Path) -> None:
    (file := tmp_path / "log.csv").write_text(text(ROWS[:, [0, 6]], "time,gz_rad_s"))
    with pytest.raises(InputError, match="--column gz='gz_rad_s'"):
        read_recordings([file])
    made = read_recordings([file], columns={"gz": "gz_rad_s"}, procedure="rate_table").campaign
    assert [each["name"] for each in made.document["channel"]] == ["gz"]


def test_times_in_words() -> None:
    day = seconds_of_stamp("2026-03-01T00:00:00")
    assert seconds_of_stamp("01.03.2026 10:00:00,250") == day + 36000.25
    assert seconds_of_stamp("03/13/2026 1:00:05.5 PM") == day + 12 * 86400 + 46805.5
    assert seconds_of_stamp("2026-03-01 10:00:00.5 -0130") == day + 36000.5 + 5400
    assert seconds_of_clock("1 days 00:00:00.010000") == 86400.01


def test_names_that_were_taken_for_others() -> None:
    units = {"UncompAccel.c[0]": ("ax", ""), "X Accel [x8004]": ("ax", ""), "X_ACCL_OUT": ("ax", "")}
    times = {
        "GPSSeconds": ("time_s", "s"),
        "GPS TOW": ("time_s", ""),
        "Zeit": ("time_s", ""),
        "datenum": ("time_s", ""),
    }
    for name, expected in (units | times).items():
        role = role_of(name)
        assert role is not None
        assert (role.target, role.unit, role.unknown) == (*expected, "")
    assert role_of("GPS TFlags") is None


def test_one_tag_in_every_line_is_the_sensor(tmp_path: Path) -> None:
    rest = np.random.default_rng(2).normal([0.05, -0.002, 0.98], 0.005, (300, 3))
    lines = [f"acc {2061 + 12 * place} " + " ".join(f"{value:.6f}" for value in row) for place, row in enumerate(rest)]
    (tmp_path / "face.txt").write_text("\n".join(lines) + "\n")
    read = read_recordings([tmp_path / "face.txt"], gravity_m_s2=9.81, latitude_deg=50)
    columns = next(iter(read.campaign.tables.values()))
    np.testing.assert_allclose(np.stack([columns[name] for name in ("ax", "ay", "az")], axis=1), rest, atol=1e-6)
    np.testing.assert_allclose(columns["time_s"], 0.012 * np.arange(300), atol=1e-9)
    # A word that names no sensor is a label, if it stands in every line.
    (tmp_path / "other.txt").write_text("\n".join(line.replace("acc", "row") for line in lines) + "\n")
    labelled = read_recordings([tmp_path / "other.txt"], gravity_m_s2=9.81, latitude_deg=50)
    np.testing.assert_array_equal(next(iter(labelled.campaign.tables.values()))["ax"], columns["ax"])
    mixed = [line.replace("acc", "row" if place % 3 else "line") for place, line in enumerate(lines)]
    (tmp_path / "mixed.txt").write_text("\n".join(mixed) + "\n")
    with pytest.raises(InputError, match=r"no column has the name|there is text before or between its numbers"):
        read_recordings([tmp_path / "mixed.txt"], gravity_m_s2=9.81, latitude_deg=50)
